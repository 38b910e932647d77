"""Which faces of an atlas lie over each other, exactly and not by samples.

Notation: two triangles are apart when all of one lies beyond an edge line of the other (separating axes; for convex
shapes in the plane the edges' normals are enough). Candidates come from a hierarchy of grids: a face is listed in the
grid whose cells are just larger than it, and asks its own and all coarser grids, so that one large face among a million
small ones costs no more than the rest.
"""

import numpy as np

# Candidate pairs looked at together: some 200 MB of numbers.
_PAIRS_AT_ONCE = 1 << 19


def overlapping_pairs(
    uv: np.ndarray, faces_uv: np.ndarray, chart: np.ndarray | None = None, *, tolerance: float = 1e-6
) -> np.ndarray:
    """Pairs of faces whose interiors meet by more than `tolerance`.

    Parameters
    ----------
    uv : (T, 2) any unit
    faces_uv : (F, 3); faces that are turned over or of no area are left out
    chart : (F,) int; only faces of the same number are compared. All are if None
    tolerance : depth in `uv`'s unit that is still called touching; single precision in [0, 1] leaves 1e-7

    Returns
    -------
    (P, 2) int64, lower number first, sorted.
    """
    corners = np.asarray(uv, np.float64)[faces_uv]
    area = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    number = np.flatnonzero(area > 0.0)
    corners, ring = corners[number], np.asarray(faces_uv)[number]
    group = np.zeros(len(number), np.int64) if chart is None else np.asarray(chart, np.int64)[number]
    if len(number) < 2:
        return np.zeros((0, 2), np.int64)
    low, high = corners.min(1), corners.max(1)
    normals, offsets = _edge_lines(corners)
    found = []
    for first, second in _candidates(low, high, group):
        near = ((low[first] < high[second] - tolerance) & (low[second] < high[first] - tolerance)).all(1)
        first, second = first[near], second[near]
        # Faces of the right way round that share an edge lie on its two sides.
        shared = sum((ring[first, k][:, None] == ring[second]).any(1).astype(int) for k in range(3))
        first, second = first[shared < 2], second[shared < 2]
        apart = _beyond(normals[first], offsets[first], corners[second], tolerance)
        first, second = first[~apart], second[~apart]
        apart = _beyond(normals[second], offsets[second], corners[first], tolerance)
        found.append(np.stack([first[~apart], second[~apart]], 1))
    pairs = np.sort(number[np.concatenate(found)] if found else np.zeros((0, 2), np.int64), 1)
    return np.unique(pairs, axis=0)


def losers(pairs: np.ndarray, faces: int) -> np.ndarray:
    """(F,) bool: faces without which no pair is left; of each pair the one that meets more others, else the later."""
    degree = np.bincount(pairs.reshape(-1), minlength=faces)
    out = np.zeros(faces, bool)
    if len(pairs):
        first_worse = degree[pairs[:, 0]] > degree[pairs[:, 1]]
        out[np.where(first_worse, pairs[:, 0], pairs[:, 1])] = True
    return out


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _edge_lines(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals (F, 3, 2) of the edges and their offsets (F, 3): n . x > offset is outside."""
    edge = np.roll(corners, -1, 1) - corners
    normal = np.stack([edge[..., 1], -edge[..., 0]], -1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    return normal, (normal * corners).sum(-1)


def _beyond(normals: np.ndarray, offsets: np.ndarray, corners: np.ndarray, tolerance: float) -> np.ndarray:
    """(N,) bool: whether all corners (N, 3, 2) lie beyond one of the three lines, but for `tolerance`."""
    depth = offsets[:, :, None] - np.einsum("nec,nkc->nek", normals, corners)
    return (depth.max(2) <= tolerance).any(1)


def _candidates(low: np.ndarray, high: np.ndarray, group: np.ndarray):
    """Yield (first, second) index arrays of faces of one group that come near each other, each pair at least once."""
    size = np.maximum((high - low).max(1), 1e-300)
    level = np.ceil(np.log2(size)).astype(np.int64)
    origin = low.min(0)
    for grid in np.unique(level):
        cell = 2.0**grid
        # A grid of more than 2^20 cells a side only arises for faces too small to see; they share the finest such.
        cell = max(cell, float((high - origin).max()) / (1 << 20))
        listed = np.flatnonzero(level == grid)
        asking = np.flatnonzero(level <= grid)
        key, owner = _cells(low[listed], high[listed], origin, cell, group[listed])
        order = np.argsort(key, kind="stable")
        key, owner = key[order], listed[owner[order]]
        asked, asker = _cells(low[asking], high[asking], origin, cell, group[asking])
        begin, end = np.searchsorted(key, asked, "left"), np.searchsorted(key, asked, "right")
        count = end - begin
        bounds = np.searchsorted(
            np.cumsum(count), np.arange(_PAIRS_AT_ONCE, count.sum() + _PAIRS_AT_ONCE, _PAIRS_AT_ONCE)
        )
        start = 0
        for stop in (bounds + 1).tolist():
            some = slice(start, stop)
            which = np.repeat(np.arange(len(count[some])), count[some])
            step = np.arange(len(which)) - np.repeat(np.cumsum(count[some]) - count[some], count[some])
            first, second = asking[asker[some][which]], owner[begin[some][which] + step]
            # Within one grid each pair comes twice.
            once = (first < second) | (level[first] < grid)
            yield first[once], second[once]
            start = stop


def _cells(low: np.ndarray, high: np.ndarray, origin: np.ndarray, cell: float, group: np.ndarray):
    """Keys of all cells each box touches, and whose they are."""
    a, b = np.floor((low - origin) / cell).astype(np.int64), np.floor((high - origin) / cell).astype(np.int64)
    span = b - a + 1
    count = span.prod(1)
    owner = np.repeat(np.arange(len(low)), count)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    column, row = a[owner, 0] + step % span[owner, 0], a[owner, 1] + step // span[owner, 0]
    return (group[owner] << 42) + (row << 21) + column, owner
