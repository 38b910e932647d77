"""Close what a scanner left open.

Notation: an edge's net count is how often faces run along it one way less the other way. A surface is closed, and its
winding number whole, when every net count is zero; edges with another count form the borders.
"""

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh


def oriented(faces: np.ndarray) -> np.ndarray:
    """Faces (F, 3) turned so that neighbours agree, piece by piece; as they are where they agree already.

    Edges of more than two faces connect nothing here.
    """
    import igl

    edges, forward = _edges(faces)
    key, index, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    net = np.bincount(index.reshape(-1), forward, len(key))
    if not ((count == 2) & (net != 0)).any():
        return faces
    turned, _ = igl.bfs_orient(faces)
    return np.asarray(turned, np.int64)


def closed_by_caps(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with every border closed by a fan about its mean; its own vertices and faces come first.

    Fans keep the scan as it is and close it exactly, whatever else is wrong with it; they are flat, so a large opening
    is closed by guesswork. `mesh` itself where nothing is open.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges, forward = _edges(mesh.faces)
    key, index = np.unique(edges, axis=0, return_inverse=True)
    net = np.bincount(index.reshape(-1), forward, len(key)).astype(np.int64)
    # A fan's face runs along its border edge against the mesh's own.
    border = np.concatenate(
        [np.repeat(key, np.maximum(net, 0), axis=0), np.repeat(key, np.maximum(-net, 0), axis=0)[:, ::-1]]
    )
    if not len(border):
        return mesh
    nodes, local = np.unique(border, return_inverse=True)
    local = local.reshape(-1, 2)
    graph = coo_matrix((np.ones(len(local)), local.T), (len(nodes), len(nodes)))
    pieces, label = connected_components(graph, directed=False)
    size = np.bincount(label, minlength=pieces)[:, None]
    at = mesh.vertices[nodes]
    centres = np.stack([np.bincount(label, at[:, k], pieces) for k in range(3)], axis=1) / size
    fans = np.stack([border[:, 1], border[:, 0], len(mesh.vertices) + label[local[:, 0]]], axis=1)
    vertices, faces = np.concatenate([mesh.vertices, centres]), np.concatenate([mesh.faces, fans])
    return TriangleMesh(vertices, faces)


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All edges (3F, 2), smaller index first, and +1 where the face runs that way, else -1."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0)
    return np.sort(edges, axis=1), forward
