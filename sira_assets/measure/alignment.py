"""Bring a prediction onto the truth before measuring: not at all, rigidly or by a similarity; and say when that failed.

Notation: M = `gt_from_pred` (4, 4); t target points on the truth (N, 3), its frame and unit (metres); q the
prediction's nearest point to t under M; d = |t - q|; trimmed: the `keep` part of the targets with the smallest d. ICP
minimises the trimmed sum of d^2 over M. Each step is a Gauss-Newton step on d, whose gradient is the unit residual
(Low 2004, TR04-004, generalised by a scale); where that does not descend, the closed-form step on the pairs (Besl and
McKay 1992, DOI 10.1109/34.121791), which cannot ascend (Chetverikov et al. 2005, DOI 10.1016/j.imavis.2004.05.007).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sira_assets.measure.surface import MM_PER_M, Surface
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.canonical import similarity, similarity_scale, transform_points

AlignmentKind = Literal["none", "rigid", "similarity"]


@dataclass(frozen=True)
class AlignmentConfig:
    """How to align, and what counts as failed.

    Parameters
    ----------
    kind : "none", "rigid" (size kept) or "similarity"
    nearest : "surface" (point to triangle) or "vertex" (H3DS's choice)
    keep : part of the targets the minimisation trusts, (0, 1]
    iterations : at most so many steps
    tolerance_m : converged when the trimmed rms drops by less
    max_points : targets used, evenly picked
    inlier_m, min_inliers : failed when fewer than this part of the targets lie within this distance afterwards. Half
        of a face beyond 5 mm is worse than any mean head scores on anyone (2.7 mm), so it is the alignment that is
        wrong.
    scale_range : failed when the scale leaves it; adult heads differ by less
    max_rotation_deg : failed when ICP turned a mesh that was said to be in place by more
    """

    kind: AlignmentKind = "none"
    nearest: Literal["surface", "vertex"] = "surface"
    keep: float = 0.9
    iterations: int = 100
    tolerance_m: float = 1e-7
    max_points: int = 8000
    inlier_m: float = 5e-3
    min_inliers: float = 0.5
    scale_range: tuple[float, float] = (0.8, 1.25)
    max_rotation_deg: float = 45.0


@dataclass(frozen=True)
class Alignment:
    """The motion found and how far to trust it.

    Parameters
    ----------
    start : "as given" or "landmarks (n)"
    gt_from_pred : (4, 4) similarity
    rms_given_mm, rms_start_mm, rms_mm : trimmed rms of the targets as given, at the start and at the end
    inliers : part of all targets within `inlier_m` at the end
    problems : why the alignment failed, one line each; empty when it did not
    """

    kind: AlignmentKind
    start: str
    gt_from_pred: np.ndarray
    scale: float
    rotation_deg: float
    shift_mm: float
    rms_given_mm: float
    rms_start_mm: float
    rms_mm: float
    inliers: float
    iterations: int
    converged: bool
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """True when nothing speaks against the alignment."""
        return not self.problems


@dataclass(frozen=True)
class _State:
    matrix: np.ndarray
    points: np.ndarray  # nearest points q of the prediction, in the truth's frame
    distance: np.ndarray
    direction: np.ndarray  # unit, from q to t
    kept: np.ndarray
    rms: float


def align(
    pred: TriangleMesh,
    targets_gt: np.ndarray,
    config: AlignmentConfig,
    *,
    start: np.ndarray | None = None,
    start_name: str = "as given",
) -> Alignment:
    """Align a prediction to points of the true surface.

    Parameters
    ----------
    pred : the predicted mesh, in metres
    targets_gt : (N, 3) points on the region of the truth that counts (the face), metres
    start : (4, 4) first guess of `gt_from_pred` (from landmarks); default identity
    start_name : how `start` came about, for the report

    Returns
    -------
    Alignment; for kind "none" its motion is `start`, only measured.
    """
    targets = np.asarray(targets_gt, np.float64)[:: max(1, len(targets_gt) // config.max_points)]
    identity = np.eye(4)
    find = _finder(pred, config)
    given = _evaluate(find, targets, identity, config)
    state = first = given if start is None else _evaluate(find, targets, np.asarray(start, np.float64), config)
    steps, converged = 0, config.kind == "none"
    while not converged and steps < config.iterations:
        steps += 1
        after = _evaluate(find, targets, _newton_step(state, targets, config), config)
        if not after.rms < state.rms:
            after = _evaluate(find, targets, _pair_step(state, targets, config), config)
        drop = state.rms - after.rms
        if drop > 0.0:
            state = after
        converged = drop < config.tolerance_m
    scale = similarity_scale(state.matrix)
    rotation = _rotation_angle_deg(state.matrix)
    inliers = float((state.distance <= config.inlier_m).mean())
    middle = targets.mean(0)
    shift = float(np.linalg.norm(transform_points(state.matrix, middle[None]) - middle))
    problems = _problems(config, given, first, state, scale, rotation, inliers, converged, started=start is not None)
    return Alignment(
        kind=config.kind,
        start=start_name,
        gt_from_pred=state.matrix,
        scale=scale,
        rotation_deg=rotation,
        shift_mm=shift * MM_PER_M,
        rms_given_mm=given.rms * MM_PER_M,
        rms_start_mm=first.rms * MM_PER_M,
        rms_mm=state.rms * MM_PER_M,
        inliers=inliers,
        iterations=steps,
        converged=converged,
        problems=problems,
    )


def landmark_start(pred_landmarks: np.ndarray, gt_landmarks: np.ndarray, kind: AlignmentKind) -> np.ndarray:
    """`gt_from_pred` (4, 4) from matching landmarks (K, 3), by Procrustes without reflection (Umeyama 1991).

    Raises
    ------
    InputError : fewer than three landmarks, or all on one line.
    """
    return similarity(pred_landmarks, gt_landmarks, with_scale=kind == "similarity")


def _problems(config, given, first, state, scale, rotation, inliers, converged, *, started) -> tuple[str, ...]:
    if config.kind == "none":
        return ()
    out = []
    if not converged:
        out.append(f"not converged after {config.iterations} iterations")
    best_known = min(given.rms, first.rms)
    if state.rms > best_known + config.tolerance_m:
        before, after = best_known * MM_PER_M, state.rms * MM_PER_M
        out.append(f"the residual grew from {before:.2f} to {after:.2f} mm (trimmed rms)")
    if inliers < config.min_inliers:
        out.append(f"only {inliers:.0%} of the region lie within {config.inlier_m * MM_PER_M:.0f} mm")
    if not config.scale_range[0] <= scale <= config.scale_range[1]:
        out.append(f"scale {scale:.3f} is outside {config.scale_range[0]} to {config.scale_range[1]}: check the units")
    if not started and rotation > config.max_rotation_deg:
        out.append(f"turned by {rotation:.0f} degrees from where it was given: start from landmarks")
    return tuple(out)


def _finder(pred: TriangleMesh, config: AlignmentConfig):
    """A function from points in the prediction's frame to its nearest points and the unit normals there."""
    if config.nearest == "vertex":
        from scipy.spatial import cKDTree

        tree = cKDTree(pred.vertices)

        def nearest_vertex(points):
            index = tree.query(points)[1]
            return pred.vertices[index], pred.normals[index]

        return nearest_vertex
    surface = Surface(pred)
    cross = face_cross_products(pred.vertices, pred.faces)
    normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    def nearest_on_surface(points):
        found = surface.nearest(points)
        return found.points, normals[found.face]

    return nearest_on_surface


def _evaluate(find, targets: np.ndarray, matrix: np.ndarray, config: AlignmentConfig) -> _State:
    local, normal = find(transform_points(np.linalg.inv(matrix), targets))
    points = transform_points(matrix, local)
    residual = targets - points
    distance = np.linalg.norm(residual, axis=1)
    # The gradient of a distance is the unit residual, also on an open border; it is undefined at 0, where the
    # surface's normal takes over. 1e-9 m is far below any figure reported.
    on_surface = distance < 1e-9
    normal = normal @ matrix[:3, :3].T / similarity_scale(matrix)
    direction = np.where(on_surface[:, None], normal, residual / np.where(on_surface, 1.0, distance)[:, None])
    count = max(4, round(config.keep * len(targets)))
    kept = np.argsort(distance, kind="stable")[:count]
    return _State(matrix, points, distance, direction, kept, float(np.sqrt((distance[kept] ** 2).mean())))


def _newton_step(state: _State, targets: np.ndarray, config: AlignmentConfig) -> np.ndarray:
    """Gauss-Newton on the trimmed distances over a small turn, a shift and, for a similarity, a growth."""
    q, n = state.points[state.kept], state.direction[state.kept]
    r = ((targets[state.kept] - q) * n).sum(1)
    centre = q.mean(0)
    arm = q - centre
    size = max(float(np.sqrt((arm**2).sum(1).mean())), 1e-30)  # makes all unknowns lengths of one order
    columns = [np.cross(arm, n) / size, n]
    if config.kind == "similarity":
        columns.append((arm * n).sum(1, keepdims=True) / size)
    jacobian = np.concatenate(columns, 1)
    # lstsq leaves a motion the data do not fix (a sphere's turn) at zero.
    x = np.linalg.lstsq(jacobian, r, rcond=1e-6)[0]
    growth = np.exp(np.clip(x[6] / size, -0.2, 0.2)) if config.kind == "similarity" else 1.0
    step = np.eye(4)
    step[:3, :3] = growth * _rotation(x[:3] / size)
    step[:3, 3] = centre + x[3:6] - step[:3, :3] @ centre
    return step @ state.matrix


def _pair_step(state: _State, targets: np.ndarray, config: AlignmentConfig) -> np.ndarray:
    """The best motion for the present pairs."""
    kept = state.kept
    return similarity(state.points[kept], targets[kept], with_scale=config.kind == "similarity") @ state.matrix


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation matrix of a rotation vector (Rodrigues); sinc keeps it exact at 0."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * half**2 * (k @ k)


def _rotation_angle_deg(matrix: np.ndarray) -> float:
    r = matrix[:3, :3] / similarity_scale(matrix)
    sine = np.linalg.norm([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return float(np.degrees(np.arctan2(sine, np.trace(r) - 1.0)))
