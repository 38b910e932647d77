"""Pictures and masks: full depth, upright, whole or refused."""

import numpy as np
import pytest
from PIL import Image

from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb
from sira_assets.scene.image import MAX_PIXELS, image_size, orient, read_image, read_mask, write_exr, write_png
from sira_assets.scene.png16 import ADAM7, read_png16, write_png16


def picture(shape=(7, 11, 3), seed=0):
    return np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)


def test_8_bit_png_is_decoded_exactly(tmp_path):
    pixels = picture()
    write_png(tmp_path / "a.png", pixels)
    image = read_image(tmp_path / "a.png")
    assert image.encoding == "srgb8"
    assert np.array_equal(image.linear, linear_from_srgb(pixels / 255.0).astype(np.float32))
    assert np.array_equal(image.saturated, (pixels == 255).any(-1))


def test_grey_palette_and_alpha_files(tmp_path):
    grey = picture((5, 6))
    Image.fromarray(grey).save(tmp_path / "grey.png")
    image = read_image(tmp_path / "grey.png")
    assert image.linear.shape == (5, 6, 3)
    assert np.array_equal(image.linear[..., 0], image.linear[..., 2])
    Image.fromarray(picture((5, 6, 4))).save(tmp_path / "rgba.png")
    assert np.array_equal(read_image(tmp_path / "rgba.png").alpha * 255, picture((5, 6, 4))[..., 3])
    Image.fromarray(picture()).convert("P").save(tmp_path / "palette.png")
    assert read_image(tmp_path / "palette.png").linear.shape == (7, 11, 3)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_16_bit_png_keeps_every_bit(tmp_path, channels):
    samples = np.random.default_rng(1).integers(0, 65536, (9, 13, channels)).astype(np.uint16)
    write_png16(tmp_path / "a.png", samples)
    assert np.array_equal(read_png16(tmp_path / "a.png"), samples)
    image = read_image(tmp_path / "a.png")
    assert image.encoding == "srgb16"
    # Two codes that 8 bits would merge differ in linear light.
    write_png16(tmp_path / "b.png", np.array([[[1000] * 3, [1001] * 3]], np.uint16))
    near = read_image(tmp_path / "b.png").linear
    assert near[0, 1, 0] > near[0, 0, 0]


def test_16_bit_grey_png_of_another_writer(tmp_path):
    samples = np.random.default_rng(2).integers(0, 65536, (33, 17)).astype(np.uint16)
    Image.fromarray(samples).save(tmp_path / "pillow.png")  # uses the adaptive filters, Paeth included
    assert np.array_equal(read_png16(tmp_path / "pillow.png")[..., 0], samples)


def filtered(rows, kind, bpp):
    """Encode rows with one filter type, by the specification's formulas, byte by byte: the reader's oracle."""
    height, width = rows.shape
    out = np.zeros((height, width + 1), np.uint8)
    padded = np.zeros((height + 1, width + bpp), int)
    padded[1:, bpp:] = rows
    for r in range(height):
        out[r, 0] = kind
        for i in range(width):
            a, b, c = padded[r + 1, i], padded[r, i + bpp], padded[r, i]
            p = a + b - c
            nearest = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            guess = (0, a, b, (a + b) // 2, nearest)[kind]
            out[r, i + 1] = (int(rows[r, i]) - guess) & 255
    return out


def png_bytes(width, height, colour, raw, interlaced=0):
    import struct
    import zlib

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">2I5B", width, height, 16, colour, 0, 0, interlaced)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")


@pytest.mark.parametrize("kind", [0, 1, 2, 3, 4])
def test_every_png_filter(tmp_path, kind):
    samples = np.random.default_rng(3).integers(0, 65536, (5, 4, 3)).astype(np.uint16)
    rows = samples.astype(">u2").view(np.uint8).reshape(5, -1)
    (tmp_path / "f.png").write_bytes(png_bytes(4, 5, 2, filtered(rows, kind, 6).tobytes()))
    assert np.array_equal(read_png16(tmp_path / "f.png"), samples)


@pytest.mark.parametrize("size", [(9, 10), (1, 1), (3, 2)])
def test_interlaced_16_bit_png(tmp_path, size):
    height, width = size
    samples = np.random.default_rng(4).integers(0, 65536, (height, width, 3)).astype(np.uint16)
    raw = b""
    for x, y, dx, dy in ADAM7:
        part = samples[y::dy, x::dx]
        if part.size:
            raw += filtered(part.astype(">u2").view(np.uint8).reshape(part.shape[0], -1), 1, 6).tobytes()
    (tmp_path / "i.png").write_bytes(png_bytes(width, height, 2, raw, 1))
    assert np.array_equal(read_png16(tmp_path / "i.png"), samples)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_undone_as_pillow_does(tmp_path, orientation):
    from PIL import ImageOps

    pixels = np.repeat(np.repeat(picture((3, 5, 3)), 16, 0), 16, 1)
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(pixels).save(tmp_path / "a.jpg", exif=exif, quality=95)
    upright = np.array(ImageOps.exif_transpose(Image.open(tmp_path / "a.jpg")))
    image = read_image(tmp_path / "a.jpg")
    assert np.array_equal(image.linear, linear_from_srgb(upright / 255.0).astype(np.float32))
    assert image_size(tmp_path / "a.jpg") == upright.shape[1::-1]
    assert np.array_equal(orient(np.array(Image.open(tmp_path / "a.jpg")), orientation), upright)


def test_exif_focal_length_is_read(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 26
    Image.fromarray(picture((8, 8, 3))).save(tmp_path / "a.jpg", exif=exif)
    assert read_image(tmp_path / "a.jpg").focal_35mm == 26.0


def test_display_p3_is_converted(tmp_path):
    from PIL import ImageCms

    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    Image.fromarray(picture()).save(tmp_path / "odd.png", icc_profile=profile)
    # A profile that cannot apply to RGB is not fatal, and is said.
    assert "profile" in read_image(tmp_path / "odd.png").warnings[0]
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(picture()).save(tmp_path / "srgb.png", icc_profile=srgb)
    assert read_image(tmp_path / "srgb.png").warnings == ()


@pytest.mark.parametrize("shape", [(6, 5, 3), (6, 5)])
def test_exr_round_trip_is_exact_also_for_strided_arrays(tmp_path, shape):
    base = np.random.default_rng(5).normal(size=(*shape[:2], 3)).astype(np.float32) * 1e5
    view = base[::-1, :, ::-1] if len(shape) == 3 else base[:, ::-1, 1]
    write_exr(tmp_path / "a.exr", view)
    image = read_image(tmp_path / "a.exr")
    expected = view if view.ndim == 3 else np.repeat(view[..., None], 3, -1)
    assert image.encoding == "linear"
    assert not image.saturated.any()
    assert np.array_equal(image.linear, expected)


@pytest.mark.parametrize("keep", [0, 3, 20, 200, 0.5, -1])
@pytest.mark.parametrize("suffix", [".exr", ".png", ".jpg"])
def test_truncated_files_are_refused_in_silence(tmp_path, capfd, suffix, keep):
    whole = tmp_path / f"whole{suffix}"
    if suffix == ".exr":
        write_exr(whole, np.random.default_rng(6).normal(size=(64, 64, 3)).astype(np.float32))
    else:
        Image.fromarray(picture((64, 64, 3))).save(whole)
    data = whole.read_bytes()
    # A JPEG may lose its end marker without losing a pixel, so its shortest cut takes more.
    cut = (
        int(len(data) * keep)
        if isinstance(keep, float)
        else keep
        if keep >= 0
        else len(data) - (200, 1)[suffix == ".exr"]
    )
    (tmp_path / f"cut{suffix}").write_bytes(data[:cut])
    with pytest.raises(InputError) as error:
        read_image(tmp_path / f"cut{suffix}")
    assert "\n" not in str(error.value)
    out = capfd.readouterr()
    assert out.out == ""
    assert out.err == ""


def test_truncated_16_bit_png_is_refused(tmp_path):
    write_png(tmp_path / "a.png", np.random.default_rng(7).integers(0, 65536, (20, 20, 3)).astype(np.uint16))
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="whole PNG"):
        read_image(tmp_path / "a.png")


def test_a_16_bit_png_that_unpacks_to_more_than_it_says_is_cut_short(tmp_path):
    (tmp_path / "bomb.png").write_bytes(png_bytes(2, 2, 2, bytes(50_000_000)))
    assert read_png16(tmp_path / "bomb.png").shape == (2, 2, 3)


def test_huge_header_is_refused_before_pixels(tmp_path):
    side = int(MAX_PIXELS**0.5) + 1
    (tmp_path / "huge16.png").write_bytes(png_bytes(side, side, 2, b""))
    with pytest.raises(InputError, match="megapixels"):
        read_image(tmp_path / "huge16.png")
    for n in (side, 40_000):  # the second is beyond where Pillow itself raises
        data = bytearray(png_bytes(n, n, 2, b""))
        data[24] = 8
        import struct
        import zlib

        data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
        (tmp_path / "huge8.png").write_bytes(data)
        with pytest.raises(InputError, match="megapixels"):
            read_image(tmp_path / "huge8.png")


def test_unknown_format_and_missing_file(tmp_path):
    (tmp_path / "a.png").write_text("not a picture at all, but long enough to look at")
    with pytest.raises(InputError, match="EXR, PNG or JPEG"):
        read_image(tmp_path / "a.png")
    with pytest.raises(InputError, match="no such file"):
        read_image(tmp_path / "b.png")


def test_masks_of_every_kind(tmp_path):
    mask = np.random.default_rng(8).random((12, 9)) > 0.5
    write_png(tmp_path / "bool.png", mask)
    Image.fromarray(mask.astype(np.uint8)).save(tmp_path / "zero_one.png")
    Image.fromarray(mask).save(tmp_path / "one_bit.png")
    Image.fromarray(np.repeat(mask[..., None] * np.uint8(255), 3, -1)).save(tmp_path / "rgb.png")
    cut_out = np.dstack([picture((12, 9, 3)), mask * np.uint8(255)])
    Image.fromarray(cut_out).save(tmp_path / "cut_out.png")
    write_png(tmp_path / "deep.png", mask * np.uint16(65535))
    write_exr(tmp_path / "alpha.exr", mask.astype(np.float32))
    for path in sorted(tmp_path.iterdir()):
        assert np.array_equal(read_mask(path), mask), path.name


def test_float_pngs_are_rounded_and_nan_is_refused(tmp_path):
    write_png(tmp_path / "a.png", np.array([[0.0, 0.5, 1.0, 2.0, -1.0, 0.9999]]))
    assert np.array(Image.open(tmp_path / "a.png")).tolist() == [[0, 128, 255, 255, 0, 255]]
    with pytest.raises(InputError, match="NaN"):
        write_png(tmp_path / "b.png", np.full((2, 2), np.nan))
    with pytest.raises(InputError, match="shape"):
        write_exr(tmp_path / "b.exr", np.zeros((2, 2, 5), np.float32))
    assert not (tmp_path / "b.png").exists()
    assert not (tmp_path / "b.exr").exists()
