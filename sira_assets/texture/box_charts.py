"""Charts that always come about: faces grouped by the side of a box they look to, flattened onto it.

Notation: side 0 to 5 is +x +y +z -x -y -z. Every face is within 55 degrees of its side's axis, so it keeps at least
0.577 of its area and never turns over. Faces of one chart that hide each other (a fold) are given charts of their own.
Charts are not placed yet: each lies where it fell, in the mesh's own unit.
"""

import numpy as np

from sira_assets.texture.overlap import losers, overlapping_pairs

# The two axes that span each side, first x second = the side's outward axis; a minus turns the first around.
_SPAN = np.array([(1, 2), (2, 0), (0, 1)])
_ROUNDS = 6  # layers of folds peeled off as charts; what is left is cut to single faces


def box_charts(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flatten faces without any overlap within a chart.

    Parameters
    ----------
    vertices : (V, 3) in the unit box; faces : (F, 3), each of positive area

    Returns
    -------
    uv (T, 2), faces_uv (F, 3); charts are the connected pieces of `faces_uv`
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    side = np.concatenate([normal, -normal], 1).argmax(1)
    span = _SPAN[side % 3]
    corners = vertices[faces]
    flat = np.stack([np.take_along_axis(corners, span[:, None, k : k + 1], 2)[..., 0] for k in range(2)], 2)
    flat[..., 0] *= np.where(side < 3, 1.0, -1.0)[:, None]
    layer = side.astype(np.int64)
    open_ = np.arange(len(faces))  # faces whose charts may still hold folds
    for step in range(_ROUNDS + 1):
        chart = edge_charts(faces[open_], layer[open_])
        pairs = overlapping_pairs(flat[open_].reshape(-1, 2), np.arange(3 * len(open_)).reshape(-1, 3), chart)
        if not len(pairs):
            break
        folded = losers(pairs, len(open_))
        # Only charts that lost faces, and the faces they lost, can hold more of them.
        touched = np.isin(chart, chart[folded])
        if step < _ROUNDS:
            layer[open_[folded]] += 6
        else:
            layer[open_[folded]] = 6 * (_ROUNDS + 2) + np.arange(int(folded.sum()))
        open_ = open_[touched]
    # One atlas vertex for each mesh vertex in each chart.
    chart = edge_charts(faces, layer).astype(np.int64)
    _, first, inverse = np.unique(
        (np.repeat(chart, 3) << 32) | faces.reshape(-1), return_index=True, return_inverse=True
    )
    return flat.reshape(-1, 2)[first], inverse.reshape(-1, 3)


def edge_charts(faces: np.ndarray, layer: np.ndarray) -> np.ndarray:
    """(F,) number of the group of faces of one layer that hang together through edges."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edge = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
    _, pair = np.unique((edge[:, 0] << 32) | edge[:, 1], return_inverse=True)
    name = (np.repeat(layer, 3) << 32) | pair
    face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(name, kind="stable")
    same = name[order][1:] == name[order][:-1]
    a, b = face[order][1:][same], face[order][:-1][same]
    return connected_components(coo_matrix((np.ones(len(a), bool), (a, b)), shape=(len(faces),) * 2), directed=False)[1]
