"""What unwrappers can take: everything that makes them hang, crash or shatter is set aside or cut open first.

Notation: W welded vertices, G sound faces. Welding joins vertices at exactly one place (a soup would make each triangle
a chart); faces of no area and second copies of a face are set aside; where more than two faces meet at an edge, or two
run it the same way, or two fans at a vertex, the surface is cut, so that what is left is manifold and orientable.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.topology import edge_keys
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products

# Twice the least area of a face in the unit box: below it single precision, in which unwrappers work, sees a segment.
_LEAST_CROSS = 1e-14


@dataclass(frozen=True)
class SoundSurface:
    """Faces to be unwrapped, and where the others belong.

    Parameters
    ----------
    vertices : (W, 3) float64 in the unit box
    faces : (G, 3) int64 into them
    number : (G,) int64, the mesh's face behind each
    welded : (V,) int64, the welded vertex of each of the mesh's vertices
    original : (F,) int64, for each of the mesh's faces the sound face on the same three places, -1 where it has no area
    """

    vertices: np.ndarray
    faces: np.ndarray
    number: np.ndarray
    welded: np.ndarray
    original: np.ndarray


def sound_surface(mesh: TriangleMesh) -> SoundSurface:
    """Weld, rescale, and keep one of each face that has some area.

    Raises
    ------
    InputError : no face has any area.
    """
    size = np.ptp(mesh.vertices, axis=0).max() if len(mesh.vertices) else 0.0
    unit = (mesh.vertices - mesh.vertices.min(0, initial=np.inf)) / max(size, 1e-300)
    first, welded = _weld(unit)
    vertices = unit[first]
    faces = welded[mesh.faces]
    area = np.linalg.norm(face_cross_products(vertices, faces), axis=1) > _LEAST_CROSS
    if not area.any():
        raise InputError(
            expected="a mesh with some area", received=f"{len(mesh.faces)} faces, none of any area", remedy="mend it"
        )
    some = np.flatnonzero(area)
    ordered = np.sort(faces[some], 1)
    # Three indices in one number would overflow above two million vertices: pairs first.
    _, edge = np.unique(edge_keys(ordered[:, :2]), return_inverse=True)
    _, earliest, same = np.unique((edge << 32) | ordered[:, 2], return_index=True, return_inverse=True)
    kept = np.sort(some[earliest])
    original = np.full(len(faces), -1)
    original[some] = np.searchsorted(kept, some[earliest[same]])
    return SoundSurface(vertices, faces[kept], kept, welded, original)


def _weld(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First index of each distinct row, and each row's place among them, in order of first appearance."""
    key = np.zeros(len(points), np.int64)
    for axis in range(3):
        _, rank = np.unique(points[:, axis], return_inverse=True)
        _, key = np.unique((key << 31) | rank, return_inverse=True)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return first[order], place[inverse]


def cut_open(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut faces (G, 3) into an orientable manifold.

    Returns
    -------
    faces : (G, 3) int64 into new vertices
    vertex : (N,) int64, the given vertex behind each new one
    """
    loose = np.zeros(len(faces), bool)
    while True:
        corner = _glued_corners(faces, loose)
        _, index, new = np.unique(corner, return_index=True, return_inverse=True)
        out = new.reshape(-1, 3)
        # Corners may still meet by another way round the vertex: faces of such an edge stand alone.
        directed = out[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        _, run, times = np.unique(directed[:, 0] << 32 | directed[:, 1], return_inverse=True, return_counts=True)
        wrong = (times > 1)[run].reshape(-1, 3).any(1) & ~loose
        if not wrong.any():
            return out, faces.reshape(-1)[index]
        loose |= wrong


def _glued_corners(faces: np.ndarray, loose: np.ndarray) -> np.ndarray:
    """(3 G,) label of each corner; corners are one where their faces share a proper edge at that vertex."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    start, end = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    corner = np.arange(faces.size)
    following = corner.reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    _, edge, times = np.unique(edge_keys(np.stack([start, end], 1)), return_inverse=True, return_counts=True)
    proper = (times == 2)[edge] & ~np.repeat(loose, 3)
    order = np.argsort(edge[proper], kind="stable")
    used = corner[proper][order]
    one, other = used[:-1], used[1:]
    # Run once each way: the start of one is the end of the other.
    match = (edge[one] == edge[other]) & (start[one] == end[other])
    one, other = one[match], other[match]
    a, b = np.concatenate([one, following[one]]), np.concatenate([following[other], other])
    graph = coo_matrix((np.ones(len(a), bool), (a, b)), shape=(faces.size, faces.size))
    return connected_components(graph, directed=False)[1]


def face_pieces(faces: np.ndarray) -> np.ndarray:
    """(G,) number of the piece each face belongs to, connected through shared vertices."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = int(faces.max(initial=-1)) + 1
    a, b = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    graph = coo_matrix((np.ones(len(a), bool), (a, b)), shape=(count, count))
    label = connected_components(graph, directed=False)[1][faces[:, 0]]
    return np.unique(label, return_inverse=True)[1]
