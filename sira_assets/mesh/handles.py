"""Close small handles: tunnels and bridges that a head does not have.

Notation: T a shortest-path tree of the vertices from a root, C a spanning tree of the faces that crosses no edge of T
and leaves out short loops first; each of the 2 genus edges in neither closes, with its two paths in T, a loop that does
not part the surface (Erickson and Whittlesey 2005, "Greedy optimal homotopy and homology generators"). Cutting along
one and closing both sides takes one handle away.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.topology import edge_keys, topology
from sira_assets.mesh.triangle_mesh import TriangleMesh

# Handles taken away at most, and new roots tried for each: both end what a surface of noise would go on with.
MOST_HANDLES = 64
MOST_ROOTS = 8
# Smoothing steps of the rims of a cut and their caps, each towards its own side: they part, and lose their zigzag, so
# that neither passes through the other.
DRAWN_BACK = 6


def close_handles(mesh: TriangleMesh, most_length_m: float) -> tuple[TriangleMesh, int]:
    """Cut the handles that a loop of at most this length goes around, and close the cuts.

    Parameters
    ----------
    mesh : one closed, manifold, oriented piece, metres; anything else is given back as it is
    most_length_m : of the shortest loop along edges that was found around (or through) the handle

    Returns
    -------
    TriangleMesh, int
        vertices that stay keep their normals, and how many handles were closed
    """
    for closed in range(MOST_HANDLES):
        counts = topology(mesh)
        if counts.pieces != 1 or not counts.watertight or counts.nonmanifold_vertices or counts.genus < 1:
            return mesh, closed
        loop, length = _short_loop(mesh)
        if length > most_length_m:
            return mesh, closed
        mesh = _cut_and_close(mesh, loop)
    return mesh, MOST_HANDLES


@dataclass(frozen=True)
class _Edges:
    """ends (E, 2), faces on both sides (E, 2), lengths (E,), and the graph of the vertices along them."""

    ends: np.ndarray
    faces: np.ndarray
    length: np.ndarray

    @staticmethod
    def of(mesh: TriangleMesh) -> "_Edges":
        pairs = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        order = np.argsort(edge_keys(pairs), kind="stable")
        ends = np.sort(pairs[order[::2]], 1)
        faces = np.repeat(np.arange(len(mesh.faces)), 3)[order].reshape(-1, 2)
        length = np.linalg.norm(mesh.vertices[ends[:, 0]] - mesh.vertices[ends[:, 1]], axis=1)
        return _Edges(ends, faces, length)


def _short_loop(mesh: TriangleMesh) -> tuple[np.ndarray, float]:
    """A short loop of vertices that does not part the surface, and its length.

    A root finds the shortest of the loops through itself, so the loops of a first root lead to further roots: the far
    ends of the shortest ones, where both ways around meet, then that of the best so far until it no longer shortens.
    """
    edges = _Edges.of(mesh)
    loops = _loops_from(mesh, edges, int(mesh.faces[0, 0]))
    for loop, _ in loops[:MOST_ROOTS]:
        loops = [*loops, _loops_from(mesh, edges, int(loop[0]))[0]]
    best = min(loops, key=lambda found: found[1])
    for _ in range(MOST_ROOTS):
        other = _loops_from(mesh, edges, int(best[0][len(best[0]) // 2]))[0]
        if other[1] > best[1] * (1 - 1e-9):
            break
        best = other
    return best


def _loops_from(mesh: TriangleMesh, edges: _Edges, root: int) -> list[tuple[np.ndarray, float]]:
    """The loops that the two trees from this root leave, and their lengths; the shortest first."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

    count = len(mesh.vertices)
    # No length of zero: the sparse graph would take it for no edge.
    length = np.maximum(edges.length, 1e-12)
    graph = csr_matrix((length, (edges.ends[:, 0], edges.ends[:, 1])), shape=(count, count))
    away, before = dijkstra(graph, directed=False, indices=root, return_predecessors=True)
    a, b = edges.ends.T
    rest = np.flatnonzero((before[a] != b) & (before[b] != a))
    around = away[a[rest]] + away[b[rest]] + length[rest]
    # The spanning tree of greatest weight, as one of least: the shortest loops are what it leaves.
    left, right = edges.faces[rest].T
    faces = len(mesh.faces)
    dual = csr_matrix((2.0 * around.max() - around, (left, right)), shape=(faces, faces))
    tree = minimum_spanning_tree(dual).tocoo()
    crossed = edge_keys(np.stack([tree.row, tree.col], 1).astype(np.int64))
    loops = rest[~np.isin(edge_keys(edges.faces[rest]), crossed)]
    traced = [np.array(_trace(before, int(a[e]), int(b[e]))) for e in loops]
    lengths = [float(np.linalg.norm(mesh.vertices[t] - mesh.vertices[np.roll(t, 1)], axis=1).sum()) for t in traced]
    return sorted(zip(traced, lengths, strict=True), key=lambda found: found[1])


def _trace(before: np.ndarray, start: int, end: int) -> list[int]:
    """The vertices of a loop: from `start` back to where both paths meet, and out again to `end`."""
    back = [start]
    while before[back[-1]] >= 0:
        back.append(int(before[back[-1]]))
    place = {vertex: i for i, vertex in enumerate(back)}
    out = [end]
    while out[-1] not in place:
        out.append(int(before[out[-1]]))
    return back[: place[out[-1]]] + out[::-1]


def _cut_and_close(mesh: TriangleMesh, loop: np.ndarray) -> TriangleMesh:
    """Part the surface's two sides along the loop, draw both back and close each by a fan about its middle."""
    count, n = len(mesh.vertices), len(loop)
    faces, twin = mesh.faces.copy(), {int(v): count + i for i, v in enumerate(loop)}
    for i, vertex in enumerate(loop):
        around = np.flatnonzero((mesh.faces == vertex).any(1))
        for face in _right_of(mesh.faces, around, int(loop[i - 1]), int(vertex), int(loop[(i + 1) % n])):
            faces[face][mesh.faces[face] == vertex] = twin[int(vertex)]
    right = np.arange(count, count + n)
    vertices = np.vstack([mesh.vertices, mesh.vertices[loop]])
    normals = np.vstack([mesh.normals, mesh.normals[loop]])
    middles = np.repeat(mesh.vertices[loop].mean(0)[None], 2, 0)
    # Left faces run along the loop, so their cap runs against it; right ones the other way.
    ahead = np.roll(np.arange(n), -1)
    left_cap = np.stack([loop[ahead], loop, np.full(n, count + n)], 1)
    right_cap = np.stack([right, right[ahead], np.full(n, count + n + 1)], 1)
    vertices, faces = np.vstack([vertices, middles]), np.vstack([faces, left_cap, right_cap])
    touched = np.concatenate([loop, np.arange(count, len(vertices))])
    vertices = _drawn_back(vertices, faces, touched)
    normals = np.vstack([normals, np.zeros((2, 3))])
    fresh = TriangleMesh(vertices, faces, None).normals
    normals[touched] = fresh[touched]
    return TriangleMesh(vertices, faces, normals)


def _right_of(faces: np.ndarray, around: np.ndarray, before: int, vertex: int, after: int) -> list[int]:
    """Those of the faces around a vertex that lie right of the path before, vertex, after."""
    # Each face at the vertex leads from one neighbour to the next, counter-clockwise seen from outside.
    leads = {}
    for face in around:
        k = int(np.flatnonzero(faces[face] == vertex)[0])
        leads[int(faces[face, (k + 1) % 3])] = (int(faces[face, (k + 2) % 3]), int(face))
    # From the neighbour before, counter-clockwise, to the one after: the right side.
    right, at = [], before
    while at != after:
        at, face = leads[at]
        right.append(face)
    return right


def _drawn_back(vertices: np.ndarray, faces: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """The moving vertices after some steps towards the mean of their neighbours."""
    moves = np.zeros(len(vertices), bool)
    moves[moving] = True
    pairs = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    pairs = np.vstack([pairs, pairs[:, ::-1]])
    pairs = np.unique(pairs[moves[pairs[:, 0]]], axis=0)
    number = np.bincount(pairs[:, 0], minlength=len(vertices))[:, None]
    out = vertices.copy()
    for _ in range(DRAWN_BACK):
        mean = np.stack([np.bincount(pairs[:, 0], out[pairs[:, 1], k], len(vertices)) for k in range(3)], 1)
        out[moving] += 0.5 * (mean[moving] / number[moving] - out[moving])
    return out
