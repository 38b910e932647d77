"""Places where one texel would have to show what is far apart on the surface.

Notation: a notch is a gap in a chart narrower than a texel; d is how far apart its two banks are on the surface. One
texel lies on both banks and can be right on one of them only: the other is read wrong by as much as the map changes
over d. (A slit, cut so that a chart lies flat, has both banks at one place, d = 0, and is no notch.) Unwrappers that
keep angles roughly may close a wedge that was left out of a chart to such a gap. They also squeeze single faces to
needles, whose two sides are then the banks.
"""

import numpy as np

from sira_assets.texture.atlas import border_edges, chart_labels, furthest_apart
from sira_assets.texture.overlap import losers

# A bilinear reading reaches one texel far; the rest is for how well the texel's size is foreseen.
_NARROW_TEXELS = 1.25
# As far as the map may be read wrong: what a texel is held to (one) and what a chart's stretch adds on the surface.
_FAR_TEXELS = 3.0
_SPACING_TEXELS = 0.5


def faces_at_notches(
    uv: np.ndarray, faces_uv: np.ndarray, vertices: np.ndarray, faces: np.ndarray, texel: float
) -> np.ndarray:
    """(F,) bool: faces without which no chart has a notch along the borders it has now.

    Parameters
    ----------
    uv : (T, 2) in the unit of `vertices`, so that a chart has its surface's area
    faces_uv : (F, 3)
    vertices, faces : (V, 3), (F, 3) the surface, corner by corner
    texel : in the same unit
    """
    from scipy.spatial import cKDTree

    edge = border_edges(faces_uv)
    face, corner = edge // 3, edge % 3
    ends = [(face, corner), (face, (corner + 1) % 3)]
    uv_ends, x_ends = (
        [values[numbers[f, c]] for f, c in ends] for values, numbers in ((uv, faces_uv), (vertices, faces))
    )
    length = np.linalg.norm(uv_ends[1] - uv_ends[0], axis=1) / texel
    count = np.maximum(np.ceil(length / _SPACING_TEXELS).astype(np.int64), 1) + 1
    owner = np.repeat(np.arange(len(edge)), count)
    t = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)) / (np.repeat(count, count) - 1)
    place, point = (a[owner] + t[:, None] * (b - a)[owner] for a, b in (uv_ends, x_ends))
    # Charts lie where they fell, maybe over each other: a third axis keeps them apart.
    chart = chart_labels(faces_uv, len(uv))[faces_uv[face[owner], 0]]
    tree = cKDTree(np.column_stack([place / texel, 4.0 * _NARROW_TEXELS * chart]))
    pairs = tree.query_pairs(_NARROW_TEXELS, output_type="ndarray")
    one, other = pairs[:, 0], pairs[:, 1]
    apart = np.linalg.norm(point[one] - point[other], axis=1) > _FAR_TEXELS * texel
    banks = np.sort(face[owner][pairs[apart]], axis=1)
    # Within one face it is stretch, for `squeezed_faces`.
    banks = np.unique(banks[banks[:, 0] != banks[:, 1]], axis=0)
    return losers(banks, len(faces_uv))


def squeezed_faces(uv: np.ndarray, faces_uv: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) bool: faces squeezed so much in a chart that a texel reaches further over them than it may.

    Parameters
    ----------
    uv, faces_uv, vertices, faces : as for `faces_at_notches`
    """
    return furthest_apart(vertices, faces, uv, faces_uv) > _FAR_TEXELS
