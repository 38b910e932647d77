"""Colour of a scan at any point of its surface.

Notation: a scan is made of parts, each with a picture or without. A material coordinate is (part, u, v, r, g, b),
constant in its first number over a triangle: the part's picture at (u, v), or white, times linear r, g, b. u, v have
their origin at the bottom left and repeat beyond [0, 1].
"""

from dataclasses import dataclass

import numpy as np

from data_synth.render_light import F0_DIELECTRIC
from sira_assets.numerics.colour import linear_from_srgb

# ks of the forehead and cheeks of rendered real heads lies between 0.6 and 0.9; a scan seldom brings its own.
DEFAULT_KS = 0.72
NEUTRAL_ALBEDO = (0.35, 0.35, 0.35)  # mid grey; as bright as light skin
_LINEAR = linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)


@dataclass(frozen=True)
class ScanMaterial:
    """A material for `data_synth.render.Surface`: one picture (H, W, 3) uint8 sRGB, or None, a part."""

    pictures: tuple[np.ndarray | None, ...]

    def __call__(self, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linear albedo (N, 3) and specular F0 (N,) at material coordinates (N, 6)."""
        albedo = np.clip(coordinates[:, 3:], 0.0, 1.0)
        part = np.round(coordinates[:, 0]).astype(np.int64)
        for k, picture in enumerate(self.pictures):
            own = np.flatnonzero(part == k)
            if picture is not None and len(own):
                albedo[own] *= sample_bilinear(picture, coordinates[own, 1:3])
        return albedo, np.full(len(coordinates), F0_DIELECTRIC * DEFAULT_KS)


def sample_bilinear(picture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Linear colour (N, 3) of an sRGB picture (H, W, 3) uint8 at uv (N, 2), between texel centres, repeating."""
    height, width = picture.shape[:2]
    x = uv[:, 0] * width - 0.5
    y = (1.0 - uv[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    wx, wy = (x - left)[:, None], (y - top)[:, None]
    (x0, x1), (y0, y1) = ((a % size, (a + 1) % size) for a, size in ((left, width), (top, height)))
    upper = _LINEAR[picture[y0, x0]] * (1 - wx) + _LINEAR[picture[y0, x1]] * wx
    lower = _LINEAR[picture[y1, x0]] * (1 - wx) + _LINEAR[picture[y1, x1]] * wx
    return upper * (1 - wy) + lower * wy
