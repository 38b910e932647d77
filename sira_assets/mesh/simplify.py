"""Fewer triangles, the same surface: quadric edge collapse, then checks that it is still a clean surface.

Quadric error metrics: Garland and Heckbert 1997, DOI 10.1145/258734.258849.
"""

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.clean import clean_mesh
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.topology import topology
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products

# Gentlest setting first. fast-simplification's own default, 7, has ten times the error of 3 on a 400k-face head.
AGGRESSIVENESS = (3.0, 1.0)


def simplify_mesh(mesh: TriangleMesh, max_triangles: int) -> TriangleMesh:
    """A mesh of at most `max_triangles` triangles (about; see Returns) on the same surface.

    Parameters
    ----------
    mesh : metres; manifold meshes stay manifold
    max_triangles : >= 4

    Returns
    -------
    TriangleMesh : at most `max_triangles` faces unless topology forbids it (handles and borders cost triangles);
        normals are interpolated from `mesh` at the nearest point, so that a field's own normals survive.

    Raises
    ------
    InputError : `max_triangles` < 4.
    """
    if max_triangles < 4:
        raise InputError(expected="at least 4 triangles", received=str(max_triangles), remedy="raise --max-triangles")
    if len(mesh.faces) <= max_triangles:
        return mesh
    raycaster = Raycaster(mesh)
    source = topology(mesh)
    best, best_score = None, None
    for method in (_fast(AGGRESSIVENESS[0]), _fast(AGGRESSIVENESS[1]), _open3d):
        vertices, faces = method(mesh, max_triangles)
        candidate = clean_mesh(TriangleMesh(vertices, faces))
        result = topology(candidate)
        faults = (
            result.nonmanifold_edges
            + result.nonmanifold_vertices
            + result.misoriented_edges
            + result.zero_area_faces
            + abs(result.boundary_edges - source.boundary_edges) * (source.boundary_edges == 0)
            + int(flipped_faces(candidate, mesh, raycaster).sum())
        )
        too_many = max(0, len(candidate.faces) - max_triangles)
        score = (faults, too_many)
        if best_score is None or score < best_score:
            best, best_score = candidate, score
        if score == (0, 0):
            break
    return TriangleMesh(best.vertices, best.faces, transfer_normals(best.vertices, mesh, raycaster))


def flipped_faces(mesh: TriangleMesh, reference: TriangleMesh, raycaster: Raycaster) -> np.ndarray:
    """(F,) bool: faces that look away from the side the reference surface's nearest face looks to.

    A face counts only where it turns by more than 120 degrees: on a crease the nearest face may be the one beyond.
    """
    nearest = raycaster.closest(mesh.vertices[mesh.faces].mean(1)).face
    ours = face_cross_products(mesh.vertices, mesh.faces)
    theirs = face_cross_products(reference.vertices, reference.faces[nearest])
    cosine = (ours * theirs).sum(1)
    return cosine < -0.5 * np.linalg.norm(ours, axis=1) * np.linalg.norm(theirs, axis=1)


def transfer_normals(points: np.ndarray, mesh: TriangleMesh, raycaster: Raycaster) -> np.ndarray:
    """(N, 3) unit normals of `mesh` at the surface points nearest to `points`, interpolated over the face."""
    nearest = raycaster.closest(points)
    weights = barycentric(nearest.points, mesh.vertices[mesh.faces[nearest.face]])
    normals = (mesh.normals[mesh.faces[nearest.face]] * weights[..., None]).sum(1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def barycentric(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N, 3) weights, clipped to the triangle, of points (N, 3) in triangles (N, 3, 3); thirds where degenerate."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    square = (normal**2).sum(1)
    safe = np.maximum(square, 1e-300)
    wb = (np.cross(points - a, c - a) * normal).sum(1) / safe
    wc = (np.cross(b - a, points - a) * normal).sum(1) / safe
    weights = np.clip(np.stack([1.0 - wb - wc, wb, wc], 1), 0.0, 1.0)
    weights[square <= 1e-40] = 1.0
    return weights / weights.sum(1, keepdims=True)


def _fast(aggressiveness: float):
    def run(mesh: TriangleMesh, max_triangles: int) -> tuple[np.ndarray, np.ndarray]:
        import fast_simplification

        # Centred and scaled to a unit box: the library works in float32 and has absolute thresholds.
        centre = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
        size = max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-30)
        vertices, faces = fast_simplification.simplify(
            np.ascontiguousarray((mesh.vertices - centre) / size, np.float32),
            np.ascontiguousarray(mesh.faces, np.int32),
            target_count=max_triangles,
            agg=aggressiveness,
        )
        return np.asarray(vertices, np.float64) * size + centre, np.asarray(faces, np.int64)

    return run


def _open3d(mesh: TriangleMesh, max_triangles: int) -> tuple[np.ndarray, np.ndarray]:
    import open3d

    legacy = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    )
    simple = legacy.simplify_quadric_decimation(max_triangles)
    return np.asarray(simple.vertices).copy(), np.asarray(simple.triangles).astype(np.int64)
