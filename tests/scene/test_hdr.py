"""Radiance pictures: RGBE's precision, every form of line and orientation, damage."""

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.scene.hdr import read_hdr, write_hdr


def picture(height, width, seed=0):
    """Ten decades of radiance, with black, grey runs and one channel at a time."""
    rng = np.random.default_rng(seed)
    pixels = np.exp(rng.normal(0.0, 6.0, (height, width, 3))).astype(np.float32)
    pixels[:, ::5] = 0.25
    pixels[0] = 0.0
    pixels[-1, :, 1:] = 0.0
    pixels[height // 2, width // 3 :] = 3.0
    return pixels


def file_of(resolution, body, header=b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n"):
    return header + b"\n" + resolution + b"\n" + body


# Widths below 8 and above 32767 are written plain; 8, 128, 129 and 400 stand about the lengths of runs and literals.
@pytest.mark.parametrize("width", [1, 7, 8, 128, 129, 400, 32768])
def test_round_trip_within_rgbe(tmp_path, width):
    pixels = picture(3 if width > 1000 else 70, width)
    write_hdr(tmp_path / "a.hdr", pixels)
    back = read_hdr(tmp_path / "a.hdr")
    assert back.dtype == np.float32
    # A mantissa of 128 to 255 truncated and read at its middle: half a step of at most 1/128. Float32 adds 1e-7.
    assert (np.abs(back - pixels) <= pixels.max(-1, keepdims=True) / 256 * (1 + 1e-6)).all()
    assert not back[pixels.max(-1) == 0].any()
    # What was read is written to the same bytes.
    write_hdr(tmp_path / "b.hdr", back)
    assert (tmp_path / "a.hdr").read_bytes() == (tmp_path / "b.hdr").read_bytes()


def test_the_ends_of_the_range(tmp_path):
    pixels = np.array([[[1.6e38, 1.0, 0.0], [1e-36, 0.0, 1e-38], [1e-45, 0, 0]]], np.float32)
    write_hdr(tmp_path / "a.hdr", pixels)
    back = read_hdr(tmp_path / "a.hdr")
    assert back[0, 0, 0] == pytest.approx(1.6e38, rel=1 / 256)
    assert back[0, 1, 0] == pytest.approx(1e-36, rel=1 / 256)
    assert not back[0, 2].any()  # below 2^-127 there is no exponent


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, 2.0**127])
def test_what_rgbe_cannot_hold_is_refused(tmp_path, value):
    with pytest.raises(InputError, match="exr"):
        write_hdr(tmp_path / "a.hdr", np.full((2, 4, 3), value))
    assert not list(tmp_path.iterdir())


def test_all_eight_orientations(tmp_path):
    upright = np.arange(6, dtype=np.uint8).reshape(2, 3) + 128
    for text, stored in {
        b"-Y 2 +X 3": upright,
        b"+Y 2 +X 3": upright[::-1],
        b"-Y 2 -X 3": upright[:, ::-1],
        b"+Y 2 -X 3": upright[::-1, ::-1],
        b"+X 3 -Y 2": upright.T,
        b"-X 3 -Y 2": upright[:, ::-1].T,
        b"+X 3 +Y 2": upright[::-1].T,
        b"-X 3 +Y 2": upright[::-1, ::-1].T,
    }.items():
        body = np.stack([stored] * 3 + [np.full_like(stored, 136)], -1).tobytes()
        (tmp_path / "a.hdr").write_bytes(file_of(text, body))
        assert np.array_equal(read_hdr(tmp_path / "a.hdr"), (upright + 0.5)[..., None].repeat(3, -1).astype(np.float32))


def test_old_runs_are_read(tmp_path):
    a, b = bytes([200, 100, 50, 130]), bytes([10, 20, 130, 129])
    # a, 3 more of it; b, then 2 + 1 * 256 more of it: runs that follow each other count in steps of 8 bits.
    body = a + b"\1\1\1\3" + b + b"\1\1\1\2" + b"\1\1\1\1"
    (tmp_path / "a.hdr").write_bytes(file_of(b"-Y 1 +X 263", body))
    back = read_hdr(tmp_path / "a.hdr")
    assert np.array_equal(back[0, :4], np.tile((np.array([200.5, 100.5, 50.5]) / 64).astype(np.float32), (4, 1)))
    assert np.array_equal(back[0, 4:], np.tile((np.array([10.5, 20.5, 130.5]) / 128).astype(np.float32), (259, 1)))


def test_exposure_and_colour_correction_are_undone(tmp_path):
    header = b"#?RGBE\r\n# made by hand\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2.0\nEXPOSURE= 4\nCOLORCORR=1 2 4\n"
    (tmp_path / "a.hdr").write_bytes(file_of(b"-Y 1 +X 1", bytes([128, 128, 128, 136]), header))
    assert np.allclose(read_hdr(tmp_path / "a.hdr")[0, 0], 128.5 / 8 / np.array([1, 2, 4]), rtol=1e-7)


def test_every_truncation_is_refused(tmp_path):
    write_hdr(tmp_path / "a.hdr", picture(4, 40))
    data = (tmp_path / "a.hdr").read_bytes()
    for length in range(len(data)):
        (tmp_path / "b.hdr").write_bytes(data[:length])
        with pytest.raises(InputError, match="whole Radiance"):
            read_hdr(tmp_path / "b.hdr")
    (tmp_path / "b.hdr").write_bytes(data + b"more")  # as some programs append
    assert np.array_equal(read_hdr(tmp_path / "b.hdr"), read_hdr(tmp_path / "a.hdr"))


def test_damage_is_refused_or_read_but_never_crashes(tmp_path):
    write_hdr(tmp_path / "a.hdr", picture(4, 40))
    data = np.frombuffer((tmp_path / "a.hdr").read_bytes(), np.uint8)
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(300):
        spoiled = data.copy()
        spoiled[rng.integers(0, len(data), 3)] = rng.integers(0, 256, 3)
        (tmp_path / "b.hdr").write_bytes(spoiled.tobytes())
        try:
            assert np.isfinite(read_hdr(tmp_path / "b.hdr")).all()
        except InputError:
            refused += 1
    assert refused > 30  # most bytes are mantissas, whose damage cannot be seen


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(99), "another kind"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n-Y 1 +X 1\n" + bytes(4), "header"),
        (file_of(b"-Y 1 +Y 1", bytes(4)), "header"),
        (file_of(b"-Y 0 +X 4", bytes(4)), "megapixels"),
        (file_of(b"-Y 999999 +X 999999", bytes(4)), "megapixels"),
        (file_of(b"-Y 8192 +X 16384", bytes(4)), "before the last line"),
        (file_of(b"-Y 1 +X 1", bytes(4), b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n"), "xyze"),
        (file_of(b"-Y 1 +X 1", bytes(4), b"#?RADIANCE\nEXPOSURE=0\n"), "EXPOSURE"),
        (file_of(b"-Y 1 +X 8", bytes([2, 2, 0, 8, 0])), "no length"),
        (file_of(b"-Y 1 +X 8", bytes([2, 2, 0, 8, 200, 1])), "beyond the end"),
        (file_of(b"-Y 1 +X 2", bytes([1, 1, 1, 2])), "repetition"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path, data, message):
    (tmp_path / "a.hdr").write_bytes(data)
    with pytest.raises(InputError, match=message):
        read_hdr(tmp_path / "a.hdr")


def test_agrees_with_mitsuba_both_ways(tmp_path):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    pixels = picture(16, 64)
    write_hdr(tmp_path / "ours.hdr", pixels)
    theirs = np.array(mi.Bitmap(str(tmp_path / "ours.hdr")).convert(component_format=mi.Struct.Type.Float32))
    peak = np.maximum(pixels.max(-1, keepdims=True), 1e-30)
    lower = (read_hdr(tmp_path / "ours.hdr") - theirs) / peak
    # mitsuba leaves the half step out.
    assert lower.min() >= 0
    assert lower.max() <= 1 / 256
    mi.Bitmap(pixels).write(str(tmp_path / "theirs.hdr"))
    assert (np.abs(read_hdr(tmp_path / "theirs.hdr") - pixels) / peak).max() <= 1 / 256 * (1 + 1e-6)
