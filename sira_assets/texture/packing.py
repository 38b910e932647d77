"""Placing charts in the square: as large as fits, a given number of texels apart.

Notation: S texels a side, p texels of padding, s texels per unit of the charts; a grid of G x G cells over the square.
A chart's mask is every cell within p/2 of it, so charts whose masks do not share a cell are p apart. Large charts look
for a place by correlating their mask with what is taken (all places at once, by FFT, in four quarter turns); small ones
are boxes and fill what is left. Places are taken lowest first (bottom-left; Baker, Coffman and Rivest 1980, DOI
10.1137/0209064), and s is found by bisection.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sira_assets.texture.atlas import border_edges

# Masks are correlated for the largest charts; the others, few cells wide, lose little by being boxes.
_MASKED = 64
_LEAST_CELLS = 6
_BISECTIONS = 7
# Above this many charts even boxes on a grid take long; they are set on shelves.
_MOST_ON_GRID = 4000


@dataclass(frozen=True)
class Packing:
    """Charts in the square.

    Parameters
    ----------
    uv : (T, 2) in [0, 1]
    padding : texels kept between charts and, half of it, to the border; less than asked where they are too many
    """

    uv: np.ndarray
    padding: float


def pack_charts(uv: np.ndarray, faces_uv: np.ndarray, chart: np.ndarray, size: int, padding: float) -> Packing:
    """Turn, scale alike and place charts.

    Parameters
    ----------
    uv : (T, 2) charts in one common unit, each where it fell
    faces_uv : (F, 3)
    chart : (T,) int, 0 up without gaps
    size, padding : texels
    """
    points = upright(uv, chart)
    low, extent = _boxes(points, chart)
    points = points - low[chart]
    if len(extent) <= _MOST_ON_GRID:
        # Which order is best is a matter of luck; where charts are few, trying all three costs less than a second.
        sizes = (extent.prod(1), extent.max(1), extent.sum(1))[: 3 if len(extent) <= _MASKED else 1]
        orders = [np.argsort(-key, kind="stable") for key in sizes]
        # Cells of four texels, so that half the padding is about half a cell.
        grid = int(np.clip(size // 4, min(size, 128), 512))
        outline = _outlines(points, faces_uv, chart, grid)
        for share in (1.0, 0.5, 0.25):
            placed = None
            for order in orders:
                placed = _fit(outline, extent, order, grid, share * padding * grid / size, placed)
            if placed is not None:
                scale, corner, turns = placed
                turned = _turned(points, turns[chart], extent[chart])
                return Packing(np.clip((turned * scale + corner[chart]) / grid, 0.0, 1.0), share * padding)
    scale, corner, square = _shelf_fit(extent, size, padding)
    return Packing(np.clip((points * scale + corner[chart]) / square, 0.0, 1.0), padding * size / square)


def upright(uv: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """(T, 2) each chart turned so that its principal axes are the picture's, the long one along v.

    A chart's bounding box is then near its least; turning keeps the winding.
    """
    count = int(chart.max()) + 1
    number = np.bincount(chart, minlength=count)
    mean = np.stack([np.bincount(chart, uv[:, k], count) for k in range(2)], 1) / number[:, None]
    d = uv - mean[chart]
    xx, xy, yy = (np.bincount(chart, d[:, i] * d[:, j], count) for i, j in ((0, 0), (0, 1), (1, 1)))
    angle = 0.5 * np.pi - 0.5 * np.arctan2(2 * xy, xx - yy)
    cosine, sine = np.cos(angle)[chart], np.sin(angle)[chart]
    return np.stack([cosine * d[:, 0] - sine * d[:, 1], sine * d[:, 0] + cosine * d[:, 1]], 1)


def _boxes(points: np.ndarray, chart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = int(chart.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart, points)
    np.maximum.at(high, chart, points)
    return low, high - low


def _outlines(points: np.ndarray, faces_uv: np.ndarray, chart: np.ndarray, grid: int) -> list[np.ndarray]:
    """For each chart, points along its border no further apart than a third of a cell at the largest scale."""
    edge = border_edges(faces_uv)
    border = faces_uv[edge // 3, edge % 3]
    a, b = points[border], points[faces_uv[edge // 3, (edge + 1) % 3]]
    area = _area(points, faces_uv)
    step = np.sqrt(max(area, 1e-300)) / grid / 3.0
    count = np.maximum(np.ceil(np.linalg.norm(b - a, axis=1) / step).astype(np.int64), 1)
    which = np.repeat(np.arange(len(border)), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    along = a[which] + share[:, None] * (b - a)[which]
    name = chart[border[which]]
    order = np.argsort(name, kind="stable")
    ends = np.searchsorted(name[order], np.arange(int(chart.max()) + 2))
    return [along[order[i:j]] for i, j in pairwise(ends)]


def _area(points: np.ndarray, faces_uv: np.ndarray) -> float:
    a, b, c = (points[faces_uv[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    return float(0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum())


def _turned(points: np.ndarray, turns: np.ndarray | int, extent: np.ndarray) -> np.ndarray:
    """Points (N, 2) of boxes with a corner at 0 after `turns` quarter turns, again with a corner at 0."""
    x, y, w, h = points[:, 0], points[:, 1], extent[..., 0], extent[..., 1]
    across = np.choose(turns, (x, h - y, w - x, y))
    up = np.choose(turns, (y, x, h - y, w - x))
    return np.stack([across, up], 1)


def _fit(outline: list[np.ndarray], extent: np.ndarray, order: np.ndarray, grid: int, padding: float, best):
    """Largest scale (cells per unit) found, low corners in cells and quarter turns; None if even a small one fails.

    `best` is what another order reached; this one must fit at a scale a hundredth larger to be tried at all.
    """
    area = max(sum(float(extent[k].prod()) for k in range(len(extent))), 1e-300)
    high = grid / max(float(extent.min(1).max()), 1e-300)
    high = min(high, 1.35 * grid / np.sqrt(area))  # boxes a third emptier than the charts in them, filled to the brim
    low, middle = (0.0, 0.75 * high) if best is None else (best[0], 1.01 * best[0])
    for _ in range(_BISECTIONS):
        placed = _place(outline, extent, order, grid, padding, middle)
        if placed is None:
            if best is not None and middle == 1.01 * best[0]:
                break
            high = middle
        else:
            low, best = middle, (middle, *placed)
        middle = 0.5 * (low + high) if low > 0 else 0.8 * high
    return best


def _place(outline, extent, order, grid: int, padding: float, scale: float):
    """Low corners (N, 2) in cells and quarter turns (N,) at one scale, or None where some chart finds no place."""
    from scipy import fft

    corner, turns = np.zeros((len(order), 2)), np.zeros(len(order), np.int64)
    taken = np.zeros((grid, grid), np.float32)
    margin = 0.5 * padding
    # What is taken only grows: a box of one size never finds a place below where the last of its size did.
    lowest: dict[tuple[int, int], int] = {}
    for rank, number in enumerate(order.tolist()):
        cells = np.ceil(extent[number] * scale + 2 * margin).astype(int) + 1
        found = None
        if rank < _MASKED and cells.max() >= _LEAST_CELLS:
            spectrum = fft.rfft2(taken, workers=1) if rank else None
            for turn in range(4 if rank else 1):
                mask = _mask(_turned(outline[number], turn, extent[number]) * scale + margin, margin)
                spot = _lowest(taken, spectrum, mask)
                if spot is not None and (found is None or spot[0] + mask.shape[0] < found[0] + found[2].shape[0]):
                    found = (*spot, mask, turn)
        else:
            for turn in (0, 1):
                w, h = (cells if turn == 0 else cells[::-1]).tolist()
                mask = np.ones((h, w), bool)
                spot = _lowest_box(taken, w, h, lowest.get((w, h), 0))
                lowest[w, h] = spot[0] if spot else grid
                if spot is not None and (found is None or spot[0] + h < found[0] + found[2].shape[0]):
                    found = (*spot, mask, turn)
        if found is None:
            return None
        row, column, mask, turn = found
        taken[row : row + mask.shape[0], column : column + mask.shape[1]][mask] = 1.0
        corner[number], turns[number] = (column + margin, row + margin), turn
    return corner, turns


def _mask(outline: np.ndarray, margin: float) -> np.ndarray:
    """Cells within `margin` (at most one cell) of a chart whose outline is given in cells, its inside filled."""
    from scipy.ndimage import binary_fill_holes

    reach = margin + 0.17  # and half the distance between two points of the outline
    shape = np.floor(outline.max(0) + reach).astype(int) + 1
    mask = np.zeros(shape[::-1], bool)
    steps = max(1, int(np.ceil(reach)))
    for dx in np.linspace(-reach, reach, 2 * steps + 1):
        for dy in np.linspace(-reach, reach, 2 * steps + 1):
            cell = np.clip(np.floor(outline + np.array([dx, dy])).astype(int), 0, shape - 1)
            mask[cell[:, 1], cell[:, 0]] = True
    return binary_fill_holes(mask)


def _lowest(taken: np.ndarray, spectrum: np.ndarray | None, mask: np.ndarray) -> tuple[int, int] | None:
    """Lowest row, then column, at which `mask` meets no taken cell."""
    from scipy import fft

    grid = len(taken)
    h, w = mask.shape
    if h > grid or w > grid:
        return None
    if spectrum is None:
        return 0, 0
    # Circular correlation wraps only where the mask would stand over the border, which is left out.
    flipped = fft.rfft2(mask[::-1, ::-1].astype(np.float32), taken.shape, workers=1)
    meets = fft.irfft2(spectrum * flipped, taken.shape, workers=1)[h - 1 :, w - 1 :]
    free = np.flatnonzero(meets.reshape(-1) < 0.5)
    return divmod(int(free[0]), meets.shape[1]) if len(free) else None


def _lowest_box(taken: np.ndarray, w: int, h: int, first_row: int) -> tuple[int, int] | None:
    """As `_lowest` for a full box, by sums over rectangles; bands of rows at a time from the first with a free cell."""
    grid = len(taken)
    if w > grid or h > grid:
        return None
    band = max(32, 2 * h)
    for low in range(first_row, grid - h + 1, band):
        part = taken[low : low + band + h - 1]
        total = np.zeros((part.shape[0] + 1, grid + 1), np.float32)
        total[1:, 1:] = part.cumsum(0).cumsum(1)
        inside = total[h:, w:] - total[:-h, w:] - total[h:, :-w] + total[:-h, :-w]
        free = np.flatnonzero(inside.reshape(-1) < 0.5)
        if len(free):
            row, column = divmod(int(free[0]), inside.shape[1])
            return low + row, column
    return None


def _shelf_fit(extent: np.ndarray, size: int, padding: float) -> tuple[float, np.ndarray, int]:
    """Texels per unit, low corners (N, 2) in texels, and the side of the square they lie in (>= size)."""
    order = np.argsort(-extent[:, 1], kind="stable")
    square = size
    while True:
        # The least box of every chart must fit before there is anything to scale.
        if _shelves(extent[order], 1e-9, square, padding) is not None:
            break
        square *= 2
    low, high = 1e-9, square / max(float(extent.max()), 1e-12)
    for _ in range(14):
        middle = np.sqrt(low * high) if high / low > 4 else 0.5 * (low + high)
        if _shelves(extent[order], middle, square, padding) is None:
            high = middle
        else:
            low = middle
    corner = np.empty_like(extent)
    corner[order] = _shelves(extent[order], low, square, padding)
    return low, corner, square


def _shelves(extent: np.ndarray, scale: float, size: int, padding: float) -> np.ndarray | None:
    """Low corners of boxes sorted by falling height, set side by side on shelves; None if they do not fit."""
    boxes = np.ceil(extent * scale + padding).astype(np.int64) + 1
    corners = np.empty((len(boxes), 2))
    x = y = height = 0
    for number, (w, h) in enumerate(boxes.tolist()):
        if x + w > size:
            x, y, height = 0, y + height, 0
        height = max(height, h)
        if w > size or y + height > size:
            return None
        corners[number] = x, y
        x += w
    return corners + 0.5 * padding
