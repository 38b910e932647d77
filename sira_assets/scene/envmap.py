"""A lat-long environment map in the scene's world.

Notation: pixel (i, j) of H x 2H has its centre at theta = pi (i + 1/2) / H from +Y and phi = 2 pi (j + 1/2) / W, and
looks along w = (sin theta sin phi, cos theta, -sin theta cos phi): +Z at the centre of the picture, +X a quarter of
the width from its left edge, as OpenEXR's latitude-longitude maps have it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.exr import exr_size, read_exr, write_exr
from sira_assets.scene.hdr import MAX_PIXELS, read_hdr, write_hdr
from sira_assets.scene.sg_light import SGLight

EXR_MAGIC = b"\x76\x2f\x31\x01"
HDR_SUFFIXES = (".hdr", ".pic")


@dataclass(frozen=True)
class EnvironmentMap:
    """Radiance that arrives from all around.

    Parameters
    ----------
    radiance : (H, 2H, 3) float32, linear Rec. 709, finite
    """

    radiance: np.ndarray

    def __post_init__(self):
        radiance = np.ascontiguousarray(self.radiance, np.float32)
        shape = radiance.shape
        if radiance.ndim != 3 or shape[2] != 3 or shape[0] < 1 or shape[1] != 2 * shape[0]:
            raise InputError(
                expected="a lat-long map (H, 2H, 3)",
                received=f"shape {shape}",
                remedy="resample it to twice as wide as high",
            )
        if not np.isfinite(radiance).all():
            raise InputError(
                expected="finite radiance",
                received=f"{int((~np.isfinite(radiance)).any(-1).sum())} pixel(s) with NaN or inf",
                remedy="repair the map",
            )
        object.__setattr__(self, "radiance", radiance)

    def directions(self) -> np.ndarray:
        """(H, 2H, 3) float64 unit vectors through the pixel centres, in the world."""
        return lat_long_directions(self.radiance.shape[0])

    def solid_angles(self) -> np.ndarray:
        """(H, 2H) float64 steradians, exact for each pixel; they sum to 4 pi."""
        height, width = self.radiance.shape[:2]
        # cos a - cos b = 2 sin((a+b)/2) sin((b-a)/2) does not cancel at the poles.
        theta = np.pi * (np.arange(height) + 0.5) / height
        rows = 2.0 * np.sin(theta) * np.sin(np.pi / (2 * height)) * (2.0 * np.pi / width)
        return np.repeat(rows[:, None], width, axis=1)


def lat_long_directions(height: int) -> np.ndarray:
    """(H, 2H, 3) float64 unit vectors through the pixel centres of a lat-long map, in the world."""
    theta = (np.pi * (np.arange(height) + 0.5) / height)[:, None]
    phi = (np.pi * (np.arange(2 * height) + 0.5) / height)[None, :]
    y = np.broadcast_to(np.cos(theta), (height, 2 * height))
    return np.stack([np.sin(theta) * np.sin(phi), y, -np.sin(theta) * np.cos(phi)], -1)


def envmap_from_sg(light: SGLight, height: int = 256) -> EnvironmentMap:
    """Sample spherical gaussians on a lat-long map.

    Each lobe's samples are scaled so that the map holds its exact energy `2 pi mu (1 - e^{-2 lambda}) / lambda`: a lobe
    narrower than a pixel, which point samples would miss, lands in the pixel nearest to its axis. For lobes that span
    several pixels that factor is 1 to better than 1 %.

    Parameters
    ----------
    light : M lobes; any sharpness > 0
    height : rows H, >= 1; columns are 2H

    Returns
    -------
    EnvironmentMap, in the light's frame
    """
    if height < 1:
        raise InputError(expected="a height of at least 1 row", received=f"{height}", remedy="use 256")
    total = np.zeros((height, 2 * height, 3))
    blank = EnvironmentMap(np.zeros((height, 2 * height, 3), np.float32))
    directions, omega = blank.directions(), blank.solid_angles()
    for axis, sharpness, amplitude in zip(light.axis, light.sharpness, light.amplitude, strict=True):
        # w.xi - 1 = -|w - xi|^2 / 2 keeps its digits near the axis, where sharp lobes live.
        exponent = -0.5 * sharpness * ((directions - axis) ** 2).sum(-1)
        # Lobes far narrower than a pixel underflow everywhere; relative to the peak they do not.
        lobe = np.exp(exponent - exponent.max())
        energy = -2.0 * np.pi * np.expm1(-2.0 * sharpness) / sharpness
        total += (lobe * (energy / (lobe * omega).sum()))[..., None] * amplitude
    return EnvironmentMap(np.minimum(total, np.finfo(np.float32).max).astype(np.float32))


def write_envmap(path: str | Path, envmap: EnvironmentMap) -> None:
    """Write a lat-long map whole or not at all: Radiance RGBE where `path` ends in .hdr, else OpenEXR float32.

    Raises
    ------
    InputError : RGBE cannot hold the radiance (negative, or beyond 1.7e38).
    """
    if Path(path).suffix.lower() in HDR_SUFFIXES:
        write_hdr(path, envmap.radiance)
        return
    import OpenEXR

    write_exr(path, envmap.radiance, header={"envmap": OpenEXR.ENVMAP_LATLONG})


def read_envmap(path: str | Path) -> EnvironmentMap:
    """Read an OpenEXR or Radiance (.hdr) lat-long map, told apart by their content.

    Raises
    ------
    InputError : no file, another kind of file, damaged, too large, not twice as wide as high, or not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(
            expected=f"a panorama at {path}",
            received="a folder" if path.is_dir() else "no such file",
            remedy="give an OpenEXR or Radiance (.hdr) file",
        )
    with open(path, "rb") as file:
        head = file.read(4)
    if head[:2] == b"#?":
        pixels = read_hdr(path)
    elif head == EXR_MAGIC:
        width, height = exr_size(path)
        if width * height > MAX_PIXELS:
            raise InputError(
                expected=f"a panorama of at most {MAX_PIXELS >> 20} megapixels at {path}",
                received=f"{width}x{height}",
                remedy="make it smaller",
            )
        pixels = read_exr(path)
    else:
        raise InputError(
            expected=f"an OpenEXR or Radiance (.hdr) panorama at {path}",
            received="another kind of file" if head else "an empty file",
            remedy="convert it; 8-bit pictures clip the lamps that matter most",
        )
    height, width = pixels.shape[:2]
    if width != 2 * height:
        raise InputError(
            expected=f"a lat-long panorama, twice as wide as high, at {path}",
            received=f"{width}x{height}",
            remedy="export it as an equirectangular map of the whole sphere",
        )
    return EnvironmentMap(pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, -1))
