"""What a panorama sends to surfaces: irradiance and blurred radiance, by quadrature over cells.

Notation: the map is constant within each pixel. A cell is a block of whole pixels with its flux int L dw (3,) and its
vector moments int L w dw (3 channels, xyz), both exact; K cells. n normals, w directions, unit, in the map's frame.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.scene.envmap import EnvironmentMap

# Rows of cells. A cell is then 1.4 degrees high, and only the cells that a horizon cuts contribute an error to
# irradiance: of second order in their size, 1e-5 of the mean for a sun that fills one. Maps of fewer than half as many
# rows have their pixels split.
ROWS = 128
# Floats of one block of a (directions, cells) matrix: 64 MB.
_BLOCK = 1 << 23


@dataclass(frozen=True)
class Cells:
    """A panorama in cells; dark cells are left out.

    Parameters
    ----------
    flux : (K, 3) float64, int L dw
    moment : (K, 3, 3) float64, int L w dw by channel and coordinate
    centre : (K, 3) float64 unit, the mean direction of what arrives, all channels together
    place : (K, 2) int, row and column on the grid
    grid : rows and columns of the grid
    """

    flux: np.ndarray
    moment: np.ndarray
    centre: np.ndarray
    place: np.ndarray
    grid: tuple[int, int]


def _pixel_integrals(height: int, width: int) -> tuple[np.ndarray, ...]:
    """Integrals over rows of sin, sin^2 and sin cos of theta, over columns of 1, sin and -cos of phi: all exact."""
    theta = np.pi * (np.arange(height) + 0.5) / height
    phi = 2.0 * np.pi * (np.arange(width) + 0.5) / width
    a, b = 0.5 * np.pi / height, np.pi / width
    solid = 2.0 * np.sin(theta) * np.sin(a)
    square = a - 0.5 * np.cos(2.0 * theta) * np.sin(2.0 * a)
    mixed = 0.5 * np.sin(2.0 * theta) * np.sin(2.0 * a)
    ones = np.full(width, 2.0 * b)
    return solid, square, mixed, ones, 2.0 * np.sin(phi) * np.sin(b), -2.0 * np.cos(phi) * np.sin(b)


def panorama_cells(envmap: EnvironmentMap, rows: int = ROWS) -> Cells:
    """Sum a panorama of any size into at most `rows` x 2 `rows` cells, in one pass; radiance below 0 counts as 0."""
    radiance = envmap.radiance
    split = -(-rows // (2 * radiance.shape[0]))
    if split > 1:
        radiance = radiance.repeat(split, 0).repeat(split, 1)
    height, width = radiance.shape[:2]
    rows = min(rows, height)
    columns = 2 * rows
    tops = np.arange(rows) * height // rows
    lefts = np.arange(columns) * width // columns
    solid, square, mixed, ones, sines, cosines = _pixel_integrals(height, width)
    sums = np.empty((rows, columns, 4, 3))  # flux, then the moments' x, y, z
    for row, (top, end) in enumerate(zip(tops, [*tops[1:], height], strict=True)):
        block = np.maximum(radiance[top:end], 0.0).astype(np.float64)
        factors = ((solid, ones), (square, sines), (mixed, ones), (square, cosines))
        for k, (down, across) in enumerate(factors):
            line = np.einsum("hwc,h->wc", block, down[top:end]) * across[:, None]
            sums[row, :, k] = np.add.reduceat(line, lefts, axis=0)
    place = np.argwhere(sums[:, :, 0].sum(-1) > 0)
    lit = sums[place[:, 0], place[:, 1]]
    mean = lit[:, 1:].sum(-1)
    centre = mean / np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-300)
    return Cells(lit[:, 0], np.swapaxes(lit[:, 1:], 1, 2), centre, place, (rows, columns))


def cells_irradiance(cells: Cells, normals: np.ndarray) -> np.ndarray:
    """Irradiance (n, 3) of surfaces with unit normals (n, 3): exact but for the cells that their horizons cut."""
    out = np.zeros((len(normals), 3))
    step = max(1, _BLOCK // max(len(cells.flux), 1))
    for first in range(0, len(normals), step):
        part = slice(first, first + step)
        for channel in range(3):
            out[part, channel] = np.maximum(normals[part] @ cells.moment[:, channel].T, 0.0).sum(-1)
    return out


def cells_blurred(cells: Cells, directions: np.ndarray, sharpness: float) -> np.ndarray:
    """Radiance (n, 3) in unit directions (n, 3), blurred by a normalised spherical gaussian of that sharpness."""
    out = np.zeros((len(directions), 3))
    gain = sharpness / (-2.0 * np.pi * np.expm1(-2.0 * sharpness))
    step = max(1, _BLOCK // max(len(cells.flux), 1))
    for first in range(0, len(directions), step):
        part = slice(first, first + step)
        cosine = directions[part] @ cells.centre.T
        out[part] = gain * np.exp(sharpness * (np.minimum(cosine, 1.0) - 1.0)) @ cells.flux
    return out


def fibonacci_sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors, on the golden-angle spiral about +Y, each with 4 pi / count of the sphere."""
    i = np.arange(count) + 0.5
    y = 1.0 - 2.0 * i / count
    turn = np.pi * (1.0 + 5.0**0.5) * i
    radius = np.sqrt(1.0 - y * y)
    return np.stack([radius * np.cos(turn), y, radius * np.sin(turn)], -1)


def gathered_lobe(flux: float, moment: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit axis and sharpness of the spherical gaussian with this flux and vector moment.

    |moment| / flux is the mean cosine coth(lambda) - 1 / lambda; solved by Newton's method from the approximation of
    Banerjee et al. 2005 (J. Mach. Learn. Res. 6, eq. 4.4).
    """
    length = float(np.linalg.norm(moment))
    mean = min(length / flux, 1.0 - 1e-12)
    if mean < 1e-6:
        return np.array([0.0, 1.0, 0.0]), 3e-6
    sharpness = mean * (3.0 - mean**2) / (1.0 - mean**2)
    for _ in range(20):
        if sharpness > 300.0:  # coth is 1: the exact answer
            sharpness = 1.0 / (1.0 - mean)
            break
        if sharpness < 1e-2:  # coth(x) - 1/x = x / 3
            sharpness = 3.0 * mean
            break
        slope = 1.0 / sharpness**2 - 1.0 / np.sinh(sharpness) ** 2
        sharpness -= (1.0 / np.tanh(sharpness) - 1.0 / sharpness - mean) / slope
    return moment / length, float(sharpness)
