"""Environment maps at another size, and turned.

Notation: a map is constant within each of its pixels, L_ij over [theta_i, theta_i+1] x [phi_j, phi_j+1], for sizes;
for turning it is bilinear between the pixel centres, over the poles too.
"""

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.envmap import EnvironmentMap

# Rows turned at a time: bounds the index arrays of a 4096 x 2048 map to some 50 MB.
_ROWS = 64


def _overlaps(source: np.ndarray, target: np.ndarray):
    """Sparse (T, S) mean of S source intervals within each of T target ones, by rising edges."""
    from scipy.sparse import csr_matrix

    edges = np.unique(np.concatenate([source, target]))
    middle = 0.5 * (edges[1:] + edges[:-1])
    row = np.clip(np.searchsorted(target, middle) - 1, 0, len(target) - 2)
    column = np.clip(np.searchsorted(source, middle) - 1, 0, len(source) - 2)
    weight = np.diff(edges) / np.diff(target)[row]
    return csr_matrix((weight, (row, column)), shape=(len(target) - 1, len(source) - 1))


def envmap_resized(envmap: EnvironmentMap, height: int) -> EnvironmentMap:
    """The map on `height` rows: each new pixel is the mean of the old ones over its solid angle.

    Exact for a map constant within its pixels, at any ratio: energy is kept to float32's rounding, and a sun of one
    pixel is kept whole.

    Raises
    ------
    InputError : height below 1.
    """
    if height < 1:
        raise InputError(expected="a height of at least 1 row", received=f"{height}", remedy="use 128")
    old = envmap.radiance.shape[0]
    if height == old:
        return envmap
    # Solid angle is dphi d(-cos theta); the edges' ends are made equal so that no sliver is left between them.
    rows = [-np.cos(np.pi * np.arange(n + 1) / n) for n in (old, height)]
    columns = [np.arange(2 * n + 1) / (2 * n) for n in (old, height)]
    across = _overlaps(*columns) @ np.swapaxes(envmap.radiance, 0, 1).reshape(2 * old, -1).astype(np.float64)
    across = np.swapaxes(across.reshape(2 * height, old, 3), 0, 1)
    return EnvironmentMap((_overlaps(*rows) @ across.reshape(old, -1)).reshape(height, 2 * height, 3))


def envmap_yawed(envmap: EnvironmentMap, degrees: float) -> EnvironmentMap:
    """The map turned about +Y, right-handed: what stood at +Z stands at +X after 90 degrees.

    A whole number of pixels (360 / W degrees each) moves columns and is exact; between them two columns are mixed,
    which keeps the energy of each row.

    Raises
    ------
    InputError : degrees not finite.
    """
    if not np.isfinite(degrees):
        raise InputError(expected="a finite angle", received=f"{degrees}", remedy="give degrees")
    width = envmap.radiance.shape[1]
    shift = (degrees / 360.0 * width) % width
    whole = round(shift)
    if abs(shift - whole) < 1e-9 * width:  # the rounding of degrees / 360 * width
        return EnvironmentMap(np.roll(envmap.radiance, -whole, 1))
    whole = int(np.floor(shift))
    share = np.float32(shift - whole)
    near, far = (np.roll(envmap.radiance, -whole - k, 1) for k in (0, 1))
    return EnvironmentMap((1 - share) * near + share * far)


def envmap_sampled(envmap: EnvironmentMap, directions: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) float32 in unit directions (..., 3), bilinear between pixel centres, across the poles too."""
    height = envmap.radiance.shape[0]
    width = 2 * height
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    # atan2 keeps its digits at the poles, where arccos(y) loses half of them.
    row = np.arctan2(np.hypot(x, z), y) * (height / np.pi) - 0.5
    column = np.arctan2(x, -z) * (height / np.pi) - 0.5
    top, left = np.floor(row).astype(int), np.floor(column).astype(int)
    down, right = (row - top)[..., None], (column - left)[..., None]

    def pixel(i, j):
        beyond = (i < 0) | (i >= height)  # over a pole the same row goes on, half the way round
        return envmap.radiance[np.clip(i, 0, height - 1), (j + np.where(beyond, height, 0)) % width]

    upper = (1 - right) * pixel(top, left) + right * pixel(top, left + 1)
    lower = (1 - right) * pixel(top + 1, left) + right * pixel(top + 1, left + 1)
    return ((1 - down) * upper + down * lower).astype(np.float32)


def envmap_rotated(envmap: EnvironmentMap, rotation: np.ndarray, *, samples: int = 2) -> EnvironmentMap:
    """The map turned by a (3, 3) rotation, as `SGLight.rotated` turns lobes, by bilinear resampling.

    Energy is not kept exactly: within 1 % for sources four pixels wide and more, 3 % RMS (at worst 15 %) for a sun of
    one pixel; `samples=3` leaves a quarter of that. To turn light exactly, fit lobes and turn those.

    Parameters
    ----------
    samples : each new pixel is the mean of `samples`^2 points within it

    Raises
    ------
    InputError : not a rotation (3, 3) to 1e-4, or samples below 1.
    """
    turn = np.asarray(rotation, np.float64)
    if turn.shape != (3, 3) or not (np.abs(turn @ turn.T - np.eye(3)).max() < 1e-4) or np.linalg.det(turn) < 0:
        raise InputError(
            expected="a rotation matrix (3, 3)", received=f"{turn.tolist()}"[:200], remedy="leave scale and mirror out"
        )
    if samples < 1:
        raise InputError(expected="at least 1 sample", received=f"{samples}", remedy="use 2")
    height = envmap.radiance.shape[0]
    out = np.empty_like(envmap.radiance)
    at = (np.arange(samples) + 0.5) / samples
    for first in range(0, height, _ROWS):
        rows = np.arange(first, min(first + _ROWS, height))
        total = np.zeros((len(rows), 2 * height, 3))
        for down in at:
            theta = (np.pi / height * (rows + down))[:, None]
            for right in at:
                phi = (np.pi / height * (np.arange(2 * height) + right))[None]
                y = np.broadcast_to(np.cos(theta), (len(rows), 2 * height))
                w = np.stack([np.sin(theta) * np.sin(phi), y, -np.sin(theta) * np.cos(phi)], -1)
                total += envmap_sampled(envmap, w @ turn)
        out[rows] = total / samples**2
    return EnvironmentMap(out)
