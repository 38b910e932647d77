"""The unwrap that always ends: faces grouped by the side of a box they look to, flattened onto it, packed on shelves.

Notation: side 0 to 5 is +x +y +z -x -y -z. Every face is within 55 degrees of its side's axis, so it keeps at least
0.577 of its area and never turns over. Faces of one chart that hide each other (a fold) are given charts of their own.
"""

import numpy as np

from sira_assets.texture.raster import overlapping_faces

# The two axes that span each side, first x second = the side's outward axis; a minus turns the first around.
_SPAN = np.array([(1, 2), (2, 0), (0, 1)])
_ROUNDS = 6  # layers of folds peeled off as charts; what is left is cut to single faces


def box_atlas(vertices: np.ndarray, faces: np.ndarray, size: int, padding: int) -> tuple[np.ndarray, np.ndarray]:
    """Atlas without overlap of any triangles of some area.

    Parameters
    ----------
    vertices : (V, 3) in the unit box; faces : (F, 3), each of positive area
    size, padding : texels

    Returns
    -------
    uv (T, 2) in [0, 1], faces_uv (F, 3)
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    side = np.concatenate([normal, -normal], 1).argmax(1)
    layer = side.copy()
    for step in range(_ROUNDS + 1):
        uv, faces_uv = _lay_out(vertices, faces, side, layer, size, padding)
        losers = overlapping_faces(uv, faces_uv, 2 * size)
        if not len(losers):
            break
        if step < _ROUNDS:
            layer[losers] += 6
        else:
            layer[losers] = 6 * (_ROUNDS + 2) + np.arange(len(losers))
            uv, faces_uv = _lay_out(vertices, faces, side, layer, size, padding)
    return uv, faces_uv


def _lay_out(
    vertices: np.ndarray, faces: np.ndarray, side: np.ndarray, layer: np.ndarray, size: int, padding: int
) -> tuple[np.ndarray, np.ndarray]:
    """Flatten the faces of each connected group of one layer and pack the groups."""
    span = _SPAN[side % 3]
    corners = vertices[faces]
    flat = np.stack([np.take_along_axis(corners, span[:, None, k : k + 1], 2)[..., 0] for k in range(2)], 2)
    flat[..., 0] *= np.where(side < 3, 1.0, -1.0)[:, None]
    # One atlas vertex for each mesh vertex in each chart.
    chart = _charts(faces, layer)
    key = np.stack([np.repeat(chart, 3), faces.reshape(-1)], 1)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    points, chart_of = flat.reshape(-1, 2)[first], key[first, 0]
    count = chart.max() + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart_of, points)
    np.maximum.at(high, chart_of, points)
    scale, corner, square = _pack(high - low, size, padding)
    uv = ((points - low[chart_of]) * scale + corner[chart_of]) / square
    return np.clip(uv, 0.0, 1.0), inverse.reshape(-1, 3)


def _charts(faces: np.ndarray, layer: np.ndarray) -> np.ndarray:
    """(F,) number of the group of faces of one layer that hang together through edges."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edge = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
    key = np.column_stack([np.repeat(layer, 3), edge])
    _, name = np.unique(key, axis=0, return_inverse=True)
    name, face = name.reshape(-1), np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(name, kind="stable")
    same = name[order][1:] == name[order][:-1]
    a, b = face[order][1:][same], face[order][:-1][same]
    return connected_components(coo_matrix((np.ones(len(a), bool), (a, b)), shape=(len(faces),) * 2), directed=False)[1]


def _pack(extent: np.ndarray, size: int, padding: int) -> tuple[float, np.ndarray, int]:
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


def _shelves(extent: np.ndarray, scale: float, size: int, padding: int) -> np.ndarray | None:
    """Low corners of boxes sorted by falling height, set side by side on shelves; None if they do not fit."""
    boxes = np.ceil(extent * scale).astype(np.int64) + 1 + padding
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
