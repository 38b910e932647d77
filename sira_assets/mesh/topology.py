"""What a mesh is made of: edges, pieces, holes.

Notation: V referenced vertices, E distinct edges, F faces; Euler characteristic V - E + F = 2 (pieces - genus) for a
closed orientable surface.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products


@dataclass(frozen=True)
class Topology:
    """Counts that say whether a mesh is a clean surface.

    Parameters
    ----------
    pieces : parts connected through shared vertices
    boundary_edges : edges with one face (holes)
    nonmanifold_edges : edges with three faces or more
    misoriented_edges : edges run twice in the same direction (faces disagree on which side is out)
    nonmanifold_vertices : vertices where two fans of faces touch
    zero_area_faces : faces whose area is below 1e-16 m^2 (a hundredth of a micrometre squared)
    euler : V - E + F
    """

    pieces: int
    boundary_edges: int
    nonmanifold_edges: int
    misoriented_edges: int
    nonmanifold_vertices: int
    zero_area_faces: int
    euler: int

    @property
    def watertight(self) -> bool:
        """Closed, edge-manifold and consistently oriented."""
        return self.boundary_edges == self.nonmanifold_edges == self.misoriented_edges == 0

    @property
    def genus(self) -> int:
        """Number of handles, summed over the pieces; meaningful for a watertight, vertex-manifold mesh only."""
        return self.pieces - self.euler // 2


def topology(mesh: TriangleMesh) -> Topology:
    """Count what `Topology` holds.

    Parameters
    ----------
    mesh : metres (for the area threshold)
    """
    faces = mesh.faces
    if not len(faces):
        return Topology(0, 0, 0, 0, 0, 0, 0)
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, counts = np.unique(edge_keys(directed), return_counts=True)
    _, directed_counts = np.unique(directed[:, 0] * len(mesh.vertices) + directed[:, 1], return_counts=True)
    label = vertex_pieces(mesh)
    used = np.unique(faces)
    area = 0.5 * np.linalg.norm(face_cross_products(mesh.vertices, faces), axis=1)
    return Topology(
        pieces=len(np.unique(label[used])),
        boundary_edges=int((counts == 1).sum()),
        nonmanifold_edges=int((counts > 2).sum()),
        misoriented_edges=int((directed_counts > 1).sum()),
        nonmanifold_vertices=len(nonmanifold_vertices(mesh)),
        zero_area_faces=int((area < 1e-16).sum()),
        euler=len(used) - len(counts) + len(faces),
    )


def edge_keys(edges: np.ndarray) -> np.ndarray:
    """(N,) int64, one number for each undirected edge (N, 2); vertex indices must be below 2^31."""
    low, high = edges.min(1), edges.max(1)
    return (low << 32) | high


def vertex_pieces(mesh: TriangleMesh) -> np.ndarray:
    """(V,) label of the connected piece each vertex belongs to."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    a, b = mesh.faces[:, [0, 1]].reshape(-1), mesh.faces[:, [1, 2]].reshape(-1)
    graph = coo_matrix((np.ones(len(a), bool), (a, b)), shape=(len(mesh.vertices),) * 2)
    return connected_components(graph, directed=False)[1]


def nonmanifold_vertices(mesh: TriangleMesh) -> np.ndarray:
    """Indices of vertices whose faces do not form a single fan (linked through edges at that vertex)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    # Nodes are face corners; two corners at one vertex are linked when their faces share an edge at that vertex.
    faces = mesh.faces
    corner = np.arange(faces.size).reshape(faces.shape)
    # For corner (f, k): the outgoing edge (k, k+1) and the incoming one (k-1, k) both touch vertex faces[f, k].
    at = np.concatenate([faces[:, k] for k in range(3)] * 2)
    other = np.concatenate([faces[:, (k + 1) % 3] for k in range(3)] + [faces[:, (k + 2) % 3] for k in range(3)])
    node = np.concatenate([corner[:, k] for k in range(3)] * 2)
    directed = at * len(mesh.vertices) + other
    order = np.argsort(directed, kind="stable")
    directed, node = directed[order], node[order]
    same = directed[1:] == directed[:-1]
    graph = coo_matrix((np.ones(int(same.sum()), bool), (node[1:][same], node[:-1][same])), shape=(faces.size,) * 2)
    count, fan = connected_components(graph, directed=False)
    # Corners are linked at one vertex only, so each fan has one.
    vertex = np.empty(count, np.int64)
    vertex[fan] = faces.reshape(-1)
    return np.flatnonzero(np.bincount(vertex) > 1)
