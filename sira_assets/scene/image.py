"""Pictures and masks on disk: EXR, PNG of 8 and 16 bits, JPEG with EXIF.

Everything read is linear Rec. 709 float32, upright as the picture is meant to be seen. Sizes are read from headers and
capped before any pixel is decoded.
"""

import contextlib
import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.atomic import replacing
from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb
from sira_assets.scene.exr import exr_size, read_exr, write_exr
from sira_assets.scene.png16 import is_png16, png_size, read_png16, write_png16

__all__ = ["ImageFile", "image_size", "orient", "read_image", "read_mask", "to_srgb", "write_exr", "write_png"]

# 8192 x 8192: more than any phone takes at its main setting; some 4 GB once a fit holds its few float copies.
MAX_PIXELS = 1 << 26
EXR_MAGIC = b"\x76\x2f\x31\x01"
EXIF_ORIENTATION, EXIF_IFD, EXIF_FOCAL_35MM = 0x0112, 0x8769, 0xA405


@dataclass(frozen=True)
class ImageFile:
    """A picture as read.

    Parameters
    ----------
    linear : (H, W, 3) float32, linear Rec. 709; not clipped and not checked for NaN, since maps use EXR too
    saturated : (H, W) bool, True where a channel holds the largest value its integer encoding has; False in EXR
    encoding : "linear", "srgb8", "srgb16" or "jpeg"
    alpha : (H, W) float32 in [0, 1], or None where the file has none (EXR alpha is not read)
    orientation : EXIF orientation 1 to 8 that was undone (1: none)
    focal_35mm : EXIF FocalLengthIn35mmFilm, millimetres, or None
    warnings : what was assumed or converted, one line each
    """

    linear: np.ndarray
    saturated: np.ndarray
    encoding: str
    alpha: np.ndarray | None = None
    orientation: int = 1
    focal_35mm: float | None = None
    warnings: tuple[str, ...] = ()


def orient(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Bring stored pixels (H, W, ...) upright by an EXIF orientation of 1 to 8 (EXIF 2.32, tag 0x0112)."""
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def _check_size(path: Path, width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise InputError(
            expected=f"an image of at most {MAX_PIXELS >> 20} megapixels at {path}",
            received=f"{width}x{height} in its header",
            remedy="make it smaller",
        )


def _head(path: Path) -> bytes:
    if not path.is_file():
        raise InputError(expected=f"an image at {path}", received="no such file", remedy="check the path")
    with open(path, "rb") as file:
        return file.read(32)


def _read_samples(path: Path) -> tuple[np.ndarray, str, int, float | None, tuple[str, ...]]:
    """Upright samples (H, W, C), encoding, orientation, focal length and warnings of any supported file."""
    head = _head(path)
    if head[:4] == EXR_MAGIC:
        _check_size(path, *exr_size(path))
        pixels = read_exr(path)
        return pixels.reshape(*pixels.shape[:2], -1), "linear", 1, None, ()
    if is_png16(head):
        _check_size(path, *png_size(head))
        return read_png16(path), "srgb16", 1, None, ()
    with _pillow(path) as file:
        _check_size(path, *file.size)
        exif = file.getexif()
        focal = exif.get_ifd(EXIF_IFD).get(EXIF_FOCAL_35MM)
        orientation = exif.get(EXIF_ORIENTATION, 1)
        file.load()
        encoding = "jpeg" if file.format in ("JPEG", "MPO") else "srgb8"
        has_alpha = file.mode in ("RGBA", "LA", "PA") or "transparency" in file.info
        picture, said = to_srgb(file, path.name)
        grey = file.mode in ("1", "L") and not has_alpha
        pixels = np.array(picture.convert("L" if grey else "RGBA" if has_alpha else "RGB"))
    orientation = orientation if orientation in range(1, 9) else 1
    pixels = orient(pixels.reshape(*pixels.shape[:2], -1), orientation)
    return pixels, encoding, orientation, float(focal) if focal else None, said


@contextlib.contextmanager
def _pillow(path: Path):
    """Open a picture with Pillow; whatever it makes of a bad one becomes an `InputError`."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of sizes; our cap decides
            with Image.open(path) as file:
                yield file
    except InputError:
        raise
    except Image.DecompressionBombError:
        raise InputError(
            expected=f"an image of at most {MAX_PIXELS >> 20} megapixels at {path}",
            received="a header that claims several times that",
            remedy="make it smaller",
        ) from None
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise InputError(
            expected=f"a whole EXR, PNG or JPEG image at {path}",
            received=" ".join(str(error).split())[:120],
            remedy="copy or export it again",
        ) from None


def to_srgb(picture, name: str):
    """A Pillow picture in sRGB, converted if it carries another colour profile (phones: Display P3), and lines that say
    so by `name`."""
    profile = picture.info.get("icc_profile")
    if not profile or picture.mode not in ("RGB", "RGBA", "CMYK"):
        return picture, ()
    from PIL import ImageCms

    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        profiled = ImageCms.getProfileDescription(source).strip()
        if "srgb" in profiled.lower():
            return picture, ()
        mode = "RGBA" if picture.mode == "RGBA" else "RGB"
        picture = ImageCms.profileToProfile(picture, source, ImageCms.createProfile("sRGB"), outputMode=mode)
        return picture, (f"{name}: converted from colour profile '{profiled}' to sRGB",)
    except (ImageCms.PyCMSError, OSError, ValueError):
        return picture, (f"{name}: unreadable colour profile, taken as sRGB",)


def image_size(path: str | Path) -> tuple[int, int]:
    """Width and height of a picture as seen (EXIF orientation applied), from its header.

    Raises
    ------
    InputError : missing, of an unknown format, truncated within the header, or larger than `MAX_PIXELS`.
    """
    path = Path(path)
    head = _head(path)
    if head[:4] == EXR_MAGIC:
        size = exr_size(path)
    elif is_png16(head):
        size = png_size(head)
    else:
        with _pillow(path) as file:
            size = file.size if file.getexif().get(EXIF_ORIENTATION, 1) < 5 else file.size[::-1]
    _check_size(path, *size)
    return size


def read_image(path: str | Path) -> ImageFile:
    """Read a picture as linear light.

    Parameters
    ----------
    path : EXR (linear), PNG of 8 or 16 bits, JPEG (sRGB; EXIF orientation is applied; other colour profiles converted)

    Returns
    -------
    ImageFile

    Raises
    ------
    InputError : missing, damaged, truncated, of an unknown format, or larger than `MAX_PIXELS`.
    """
    path = Path(path)
    samples, encoding, orientation, focal, said = _read_samples(path)
    channels = samples.shape[2]
    colour = samples[..., :3] if channels >= 3 else np.repeat(samples[..., :1], 3, -1)
    if encoding == "linear":
        return ImageFile(np.ascontiguousarray(colour, np.float32), np.zeros(colour.shape[:2], bool), encoding)
    largest = np.iinfo(samples.dtype).max
    # One table entry per code: exact, and faster than a power per pixel.
    table = linear_from_srgb(np.arange(largest + 1) / largest).astype(np.float32)
    alpha = samples[..., -1].astype(np.float32) / largest if channels in (2, 4) else None
    return ImageFile(table[colour], (colour == largest).any(-1), encoding, alpha, orientation, focal, said)


def read_mask(path: str | Path) -> np.ndarray:
    """Read a mask as (H, W) bool, upright by its own EXIF.

    White is the head. Values are split at half of the encoding's range; a mask of zeros and ones, which that would
    empty, is split at one half. A cut-out with transparency is split by its alpha. An EXR is split at 0.5.

    Raises
    ------
    InputError : as `read_image`.
    """
    samples, encoding, *_ = _read_samples(Path(path))
    channels = samples.shape[2]
    values = samples[..., : 3 if channels >= 3 else 1].astype(np.float64).mean(-1)
    if encoding == "linear":
        return values > 0.5
    largest = np.iinfo(samples.dtype).max
    if channels in (2, 4) and (samples[..., -1] < largest).any():
        values = samples[..., -1].astype(np.float64)
    return values > (0.5 if values.max() <= 1 else largest / 2)


def write_png(path: str | Path, encoded: np.ndarray) -> None:
    """Write an encoded picture, whole or not at all.

    Parameters
    ----------
    path : ends in .png
    encoded : (H, W), (H, W, 3) or, but for uint16, (H, W, 4) with straight alpha; floats in [0, 1] (clipped, rounded
        to 8 bits), uint8 as they are, bool as 0 and 255, uint16 as a 16-bit file

    Raises
    ------
    InputError : another shape, or NaN.
    """
    encoded = np.asarray(encoded)
    colour = (3,) if encoded.dtype == np.uint16 else (3, 4)
    if encoded.size == 0 or not (encoded.ndim == 2 or (encoded.ndim == 3 and encoded.shape[2] in colour)):
        raise InputError(
            expected="a picture (H, W) or (H, W, 3)", received=f"shape {encoded.shape}", remedy="drop other channels"
        )
    if encoded.dtype == np.uint16:
        write_png16(path, encoded)
        return
    if encoded.dtype == bool:
        encoded = encoded.astype(np.uint8) * np.uint8(255)
    elif encoded.dtype != np.uint8:
        if np.isnan(encoded).any():
            raise InputError(
                expected="a picture without NaN",
                received=f"{int(np.isnan(encoded).sum())} NaN value(s)",
                remedy="mask them out before writing",
            )
        encoded = np.round(np.clip(encoded, 0.0, 1.0) * 255.0).astype(np.uint8)
    from PIL import Image

    with replacing(path) as temporary:
        Image.fromarray(np.ascontiguousarray(encoded)).save(temporary, format="PNG")
