"""Which part of which face lies at each texel: scan conversion of an atlas.

Notation: S texels and k S samples a side; x right and y down, in texels; row 0 on top. A sample belongs to the face
that holds its centre (edges half-open, so neighbours neither gap nor overlap); a texel that is touched by a face but
holds no sample takes the point of that face nearest to its centre. So each texel that a face touches gets a value of
its own surface: the conservative coverage that bilinear reading at a chart's border needs.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class AtlasSamples:
    """N surface samples of a band of texel rows.

    Parameters
    ----------
    face : (N,) int64
    barycentric : (N, 3) weights of the face's corners, >= 0, sum 1
    texel : (N,) int64, row * S + column
    """

    face: np.ndarray
    barycentric: np.ndarray
    texel: np.ndarray


def rasterise(
    uv: np.ndarray, faces_uv: np.ndarray, size: int, *, samples: int, first_row: int, last_row: int
) -> AtlasSamples:
    """Samples of texel rows `first_row` to `last_row` (exclusive); where faces overlap, the lowest numbered wins.

    Parameters
    ----------
    uv : (T, 2) in [0, 1], origin bottom-left
    faces_uv : (F, 3)
    size : S
    samples : k; each texel has k x k samples

    Notes
    -----
    What a row gets does not depend on the other rows asked for, so the picture may be made in bands of any height.
    """
    number, corners = _near_band(uv, faces_uv, size, first_row, last_row)
    fine = corners * samples
    face, row, low, high = _centre_spans(fine, first_row * samples, last_row * samples)
    # A centre at c + 0.5 lies in [low, high) exactly when ceil(low - 0.5) <= c < ceil(high - 0.5).
    start, stop = np.ceil(low - 0.5), np.ceil(high - 0.5)
    which, column = _expand(np.clip(start, 0, size * samples), np.clip(stop, 0, size * samples))
    owner = np.full(((last_row - first_row) * samples, size * samples), -1, np.int64)
    # Written last to first, so that the lowest numbered face stays.
    owner[(row[which] - first_row * samples)[::-1], column[::-1]] = face[which][::-1]
    row, column = np.nonzero(owner >= 0)
    face = owner[row, column]
    centre = np.stack([(column + 0.5) / samples, (row + 0.5) / samples + first_row], 1)
    weights = _barycentric(centre, corners[face])
    texel = (row // samples + first_row) * size + column // samples
    touched = _touched(corners, size, first_row, last_row, texel)
    return AtlasSamples(
        number[np.concatenate([face, touched.face])],
        np.concatenate([weights, touched.barycentric]),
        np.concatenate([texel, touched.texel]),
    )


def border_texels(
    uv: np.ndarray,
    faces_uv: np.ndarray,
    size: int,
    *,
    samples: int,
    first_row: int,
    last_row: int,
    inner: np.ndarray,
    reach: int,
) -> tuple[AtlasSamples, np.ndarray]:
    """Samples of the texels at charts' borders, in the plane of the face nearest to each, also beyond its edges.

    Bilinear reading at a border looks up to a texel beyond it. What stands there should be the surface's own
    continuation: a mean over the covered part alone is up to half a texel off, a neighbour's copy a whole one.

    Parameters
    ----------
    samples : k; each such texel gets k x k samples
    inner : (rows, S) bool, texels of the band that are wholly covered and need none
    reach : texels beyond a face that are filled

    Returns
    -------
    AtlasSamples : weights of the plane (negative, or above 1, beyond the face), texel after texel
    (N, 3) float64 : weights of the face's point nearest to the texel's centre, the same for all samples of a texel
    """
    number, corners = _near_band(uv, faces_uv, size, first_row - reach, last_row + reach)
    solid = np.abs(_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])) > 1e-9
    number, corners = number[solid], corners[solid]
    face, row, low, high = _band_spans(corners, first_row, last_row, reach)
    which, column = _expand(np.clip(np.floor(low), 0, size - 1), np.clip(np.floor(high), 0, size - 1) + 1)
    open_ = ~inner[row[which] - first_row, column]
    which, column = which[open_], column[open_]
    face, texel = face[which], row[which] * size + column
    centre = np.stack([texel % size + 0.5, texel // size + 0.5], 1)
    weights, distance = _nearest_in_triangle(centre, corners[face])
    order = np.lexsort((face, distance, texel))
    _, first = np.unique(texel[order], return_index=True)
    chosen = np.repeat(order[first], samples**2)
    step = (np.arange(samples) + 0.5) / samples - 0.5
    offset = np.tile(np.stack(np.meshgrid(step, step), -1).reshape(-1, 2), (len(first), 1))
    plane = plane_weights(centre[chosen] + offset, corners[face[chosen]])
    return AtlasSamples(number[face[chosen]], plane, texel[chosen]), weights[chosen]


def plane_weights(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N, 3) weights of points (N, 2), which may lie outside, in the planes of triangles (N, 3, 2); sum 1."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    area = _cross(b - a, c - a)
    safe = np.where(np.abs(area) > 0, area, 1.0)
    wb, wc = _cross(points - a, c - a) / safe, _cross(b - a, points - a) / safe
    return np.stack([1.0 - wb - wc, wb, wc], 1)


def _near_band(uv: np.ndarray, faces_uv: np.ndarray, size: int, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the faces that reach into rows `first` to `last`, and their corners (N, 3, 2) in texels."""
    y = ((1.0 - uv[:, 1]) * size)[faces_uv]
    number = np.flatnonzero((y.min(1) <= last) & (y.max(1) >= first))
    return number, np.stack([uv[:, 0] * size, (1.0 - uv[:, 1]) * size], 1)[faces_uv[number]]


def _touched(corners: np.ndarray, size: int, first_row: int, last_row: int, filled: np.ndarray) -> AtlasSamples:
    """Texels that faces touch and no sample fills, each with the nearest point of the nearest such face."""
    face, row, low, high = _band_spans(corners, first_row, last_row)
    start, stop = np.clip(np.floor(low), 0, size - 1), np.clip(np.floor(high), 0, size - 1) + 1
    which, column = _expand(start, stop)
    texel = row[which] * size + column
    empty = np.ones((last_row - first_row) * size, bool)
    empty[filled - first_row * size] = False
    open_ = empty[texel - first_row * size]
    face, texel = face[which][open_], texel[open_]
    centre = np.stack([texel % size + 0.5, texel // size + 0.5], 1)
    weights, distance = _nearest_in_triangle(centre, corners[face])
    order = np.lexsort((face, distance, texel))
    _, first = np.unique(texel[order], return_index=True)
    chosen = order[first]
    return AtlasSamples(face[chosen], weights[chosen], texel[chosen])


def _expand(start: np.ndarray, stop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every (index, value) with start[index] <= value < stop[index], in order of the index."""
    start = np.asarray(start).astype(np.int64)
    count = np.maximum(np.asarray(stop).astype(np.int64) - start, 0)
    which = np.repeat(np.arange(len(count)), count)
    offset = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    return which, start[which] + offset


def _edges(corners: np.ndarray, face: np.ndarray):
    """The three edges of each face, ends ordered by (y, x): an edge that two faces share is the same to the bit."""
    for k in range(3):
        a, b = corners[face, k], corners[face, (k + 1) % 3]
        swap = (a[:, 1] > b[:, 1]) | ((a[:, 1] == b[:, 1]) & (a[:, 0] > b[:, 0]))
        yield np.where(swap[:, None], b, a), np.where(swap[:, None], a, b)


def _x_at(a: np.ndarray, b: np.ndarray, y: np.ndarray) -> np.ndarray:
    """x of the edge a-b at height y."""
    rise = b[:, 1] - a[:, 1]
    return a[:, 0] + (y - a[:, 1]) * ((b[:, 0] - a[:, 0]) / np.where(rise > 0, rise, 1.0))


def _centre_spans(corners: np.ndarray, first: int, last: int):
    """For each face and each row whose centre line it crosses: the interval [low, high) of x."""
    y = corners[..., 1]
    face, row = _expand(np.clip(np.ceil(y.min(1) - 0.5), first, last), np.clip(np.ceil(y.max(1) - 0.5), first, last))
    height = row + 0.5
    low, high = np.full(len(face), np.inf), np.full(len(face), -np.inf)
    for a, b in _edges(corners, face):
        crossed = (a[:, 1] <= height) & (height < b[:, 1])
        x = _x_at(a, b, height)
        low, high = np.where(crossed, np.minimum(low, x), low), np.where(crossed, np.maximum(high, x), high)
    crossed = high >= low
    return face[crossed], row[crossed], low[crossed], high[crossed]


def _band_spans(corners: np.ndarray, first: int, last: int, reach: int = 0):
    """For each face and each row within `reach` rows of it: the extent [low, high] of its part there, `reach` wider."""
    y = corners[..., 1]
    start, stop = np.floor(y.min(1)) - reach, np.floor(y.max(1)) + 1 + reach
    face, row = _expand(np.clip(start, first, last), np.clip(stop, first, last))
    low, high = np.full(len(face), np.inf), np.full(len(face), -np.inf)
    for a, b in _edges(corners, face):
        top, bottom = np.maximum(a[:, 1], row - reach), np.minimum(b[:, 1], row + 1.0 + reach)
        inside = top <= bottom
        flat = a[:, 1] == b[:, 1]
        for x in (np.where(flat, a[:, 0], _x_at(a, b, top)), np.where(flat, b[:, 0], _x_at(a, b, bottom))):
            low, high = np.where(inside, np.minimum(low, x), low), np.where(inside, np.maximum(high, x), high)
    touched = high >= low
    return face[touched], row[touched], low[touched] - reach, high[touched] + reach


def _barycentric(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N, 3) weights of points (N, 2) inside triangles (N, 3, 2)."""
    weights = np.clip(plane_weights(points, triangles), 0.0, 1.0)
    return weights / weights.sum(1, keepdims=True)


def _nearest_in_triangle(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (N, 3) of the point of each triangle nearest to each point, and the squared distance (N,)."""
    area = _cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    weights, best = np.zeros((len(points), 3)), np.full(len(points), np.inf)
    sides = []
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        sides.append(_cross(b - a, points - a) * np.sign(area))
        edge = b - a
        t = np.clip(((points - a) * edge).sum(1) / np.maximum((edge**2).sum(1), 1e-300), 0.0, 1.0)
        distance = ((a + t[:, None] * edge - points) ** 2).sum(1)
        closer = distance < best
        best = np.where(closer, distance, best)
        weights[closer] = 0.0
        weights[closer, k], weights[closer, (k + 1) % 3] = 1.0 - t[closer], t[closer]
    inside = (np.min(sides, axis=0) >= 0) & (area != 0)
    if inside.any():
        weights[inside], best[inside] = _barycentric(points[inside], triangles[inside]), 0.0
    return weights, best


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
