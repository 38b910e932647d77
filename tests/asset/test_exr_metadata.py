"""Our EXR files, read by programs that are not ours."""

import numpy as np
import pytest

from sira_assets.asset.write_avatar import write_avatar

# ITU-R BT.709: red, green, blue and D65 white.
REC709 = [0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290]
COLOURS = ("envmap.exr", "textures/irradiance.exr")
DATA = ("textures/normal.exr", "textures/specular.exr")


@pytest.fixture(scope="module")
def folder(avatar, tmp_path_factory):
    folder = tmp_path_factory.mktemp("asset")
    write_avatar(avatar, folder)
    return folder


@pytest.mark.parametrize("name", COLOURS + DATA)
def test_mitsuba_reads_pixels_and_metadata(folder, name):
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    bitmap = mitsuba.Bitmap(str(folder / name))
    said = dict(bitmap.metadata())
    assert bitmap.component_format() == mitsuba.Struct.Type.Float32
    assert said["comments"]
    assert said["colorInteropID"] == ("lin_rec709_scene" if name in COLOURS else "data")
    pixels = np.array(bitmap)
    assert np.isfinite(pixels).all()
    assert pixels.shape[2:] == (() if "specular" in name else (3,))


@pytest.mark.parametrize("name", COLOURS + DATA)
def test_the_header_says_colour_space_and_compression(folder, name):
    OpenEXR = pytest.importorskip("OpenEXR")
    with OpenEXR.File(str(folder / name)) as file:
        header = dict(file.header())
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    if name in COLOURS:
        assert np.ravel(header["chromaticities"]).tolist() == pytest.approx(REC709, abs=1e-6)
    else:
        assert "chromaticities" not in header
    assert ("envmap" in header) == (name == "envmap.exr")
    # A date or a host would make the same avatar another file.
    assert not {"capDate", "utcOffset", "owner"} & set(header)


def test_mitsuba_reads_the_radiance_file_as_the_same_map(folder):
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    exact, shared = (np.array(mitsuba.Bitmap(str(folder / f"envmap.{kind}"))) for kind in ("exr", "hdr"))
    assert shared.shape == exact.shape
    # RGBE's mantissa has eight bits of the brightest channel.
    assert (np.abs(shared - exact) <= exact.max(-1, keepdims=True) / 128 + 1e-30).all()
