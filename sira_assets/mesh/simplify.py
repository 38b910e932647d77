"""Fewer triangles, the same surface: quadric edge collapse to a budget or to a tolerance, checked to be clean still.

Quadric error metrics: Garland and Heckbert 1997, DOI 10.1145/258734.258849.
"""

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.clean import CleanConfig, clean_mesh
from sira_assets.mesh.field_distance import SurfaceGap, mesh_distance
from sira_assets.mesh.open3d_core import open3d_core
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.topology import Topology, topology
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products

# Gentlest setting first. fast-simplification's own default, 7, has ten times the error of 3 on a 400k-face head.
AGGRESSIVENESS = (3.0, 1.0)
# More triangles than asked for by this share are no answer while there is another, nor is one with more than this share
# of its faces turned over.
FAR_TOO_MANY, MANY_ASIDE = 0.1, 0.01
# A tolerance is met with at most this many times the fewest triangles that meet it.
COUNT_STEP = 1.15


def simplify_mesh(mesh: TriangleMesh, max_triangles: int, *, importance: np.ndarray | None = None) -> TriangleMesh:
    """A mesh of at most `max_triangles` triangles (about; see Returns) on the same surface.

    Parameters
    ----------
    mesh : metres; manifold meshes stay manifold
    max_triangles : >= 4
    importance : (V,) weights >= 1 of the squared error at each vertex (`head_importance`); all alike if None

    Returns
    -------
    TriangleMesh : at most `max_triangles` faces unless topology forbids it (handles and borders cost triangles), or a
        tenth more where that keeps every face looking the right way;
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
    # The rim of an open bust is no hole: closing it would undo what was asked for.
    cleaning = CleanConfig(close_holes_of=0) if source.boundary_edges else CleanConfig()
    best, best_score = None, None
    weighted = () if importance is None else (_meshlab(importance),)
    for method in (*weighted, _fast(AGGRESSIVENESS[0]), _fast(AGGRESSIVENESS[1]), _open3d):
        vertices, faces = method(mesh, max_triangles)
        candidate = clean_mesh(TriangleMesh(vertices, faces), cleaning)
        result = topology(candidate)
        faults = (
            result.nonmanifold_edges
            + result.nonmanifold_vertices
            + result.misoriented_edges
            + result.zero_area_faces
            + _boundary_faults(result, source)
        )
        too_many = max(0, len(candidate.faces) - max_triangles)
        aside = int(flipped_faces(candidate, mesh, raycaster).sum())
        # A gentle collapse may stop at many times the triangles: a face or two that look aside are the lesser evil.
        many_aside = aside > MANY_ASIDE * len(candidate.faces)
        far_too_many = too_many > FAR_TOO_MANY * max_triangles
        score = (faults, many_aside, far_too_many, aside, too_many)
        if best_score is None or score < best_score:
            best, best_score = candidate, score
        if not any(score):
            break
    return TriangleMesh(best.vertices, best.faces, transfer_normals(best.vertices, mesh, raycaster))


def _boundary_faults(result: Topology, source: Topology) -> int:
    """Edges of holes beyond the source's own; all of the source's where nothing of its boundary is left."""
    if source.boundary_edges and not result.boundary_edges:
        return source.boundary_edges
    return max(0, result.boundary_edges - source.boundary_edges)


def simplify_to_tolerance(
    mesh: TriangleMesh, tolerance_m: float, *, importance: np.ndarray | None = None
) -> tuple[TriangleMesh, SurfaceGap]:
    """As few triangles as the greatest distance between `mesh` and the result allows, measured both ways.

    The count is found by halving an interval, so it is within `COUNT_STEP` of the least that was seen to do.

    Parameters
    ----------
    mesh : metres
    tolerance_m : > 0
    importance : as in `simplify_mesh`

    Returns
    -------
    TriangleMesh : `mesh` itself where no fewer triangles do
    SurfaceGap : mesh to result and back, metres, each at more than 100,000 points

    Raises
    ------
    InputError : a tolerance that is not above 0.
    """
    if not tolerance_m > 0:
        raise InputError(expected="a tolerance above 0", received=f"{tolerance_m}", remedy="correct it")
    best, best_gap = mesh, SurfaceGap(0.0, 0.0, 0.0, 0.0)
    low, high = 4.0, float(len(mesh.faces))  # `low` fails, `high` holds
    trial = max(high / 8.0, 4.0)
    while high > COUNT_STEP * low:
        candidate = simplify_mesh(mesh, int(trial), importance=importance)
        gap = mesh_distance(mesh, candidate)
        if gap.greatest <= tolerance_m:
            best, best_gap, high = candidate, gap, trial
        else:
            low = trial
        # An eighth at a time at first: a mesh on a fine lattice has many times too many.
        trial = max(high / 8.0, 4.0) if low == 4.0 and high > 40.0 else np.sqrt(low * high)
    return best, best_gap


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


def _meshlab(importance: np.ndarray):
    def run(mesh: TriangleMesh, max_triangles: int) -> tuple[np.ndarray, np.ndarray]:
        import pymeshlab

        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.faces, v_scalar_array=np.asarray(importance, np.float64)))
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=max_triangles,
            qualityweight=True,
            preserveboundary=True,
            preservenormal=True,
            preservetopology=True,
        )
        result = meshes.current_mesh()
        # Copies: the matrices are views that die with the MeshSet.
        return np.array(result.vertex_matrix()), np.array(result.face_matrix(), np.int64)

    return run


def _open3d(mesh: TriangleMesh, max_triangles: int) -> tuple[np.ndarray, np.ndarray]:
    open3d = open3d_core()
    legacy = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    )
    simple = legacy.simplify_quadric_decimation(max_triangles)
    return np.asarray(simple.vertices).copy(), np.asarray(simple.triangles).astype(np.int64)
