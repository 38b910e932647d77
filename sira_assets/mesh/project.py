"""Moving points onto a field's zero set along its normals.

Notation: f signed distance, n = grad f / |grad f|; x_{k+1} = x_k - f(x_k) n(x_k) / s_k, with s_k the slope of f along n
as the previous step measured it (1 at first, as for an exact distance). For an exact distance one step lands on the
surface and n does not change along it, so most points need two evaluations.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.fields.head_field import HeadField, query
from sira_assets.mesh.lattice import chunk_for
from sira_assets.mesh.triangle_mesh import TriangleMesh


@dataclass(frozen=True)
class ProjectConfig:
    """How points are moved onto the zero set.

    Parameters
    ----------
    max_distance_m : a point never ends further than this from where it started
    tolerance_m : |f| at which a point is left alone. A float32 network resolves about 1e-6 m, so less gains nothing.
    iterations : evaluations of the field at the points that are not there yet
    """

    max_distance_m: float = 0.003
    tolerance_m: float = 2e-6
    iterations: int = 4


@dataclass(frozen=True)
class ProjectedPoints:
    """Points on (or as near as allowed to) the zero set.

    Parameters
    ----------
    points : (N, 3) float64 canonical metres; a point that got no nearer stays where it was
    normals : (N, 3) float64 unit field normals at `points`; (0, 0, 0) where the gradient vanishes
    residual_m : (N,) float64 signed f at `points`
    """

    points: np.ndarray
    normals: np.ndarray
    residual_m: np.ndarray


def project_points(
    field: HeadField, points_m: np.ndarray, config: ProjectConfig = ProjectConfig(), *, device: str = "cpu"
) -> ProjectedPoints:
    """Move points onto the zero set of `field` by safeguarded Newton steps along its normals.

    A step is kept only where it makes |f| smaller; where it does not, half of it is tried next.

    Parameters
    ----------
    points_m : (N, 3) canonical metres, within a few millimetres of the surface

    Returns
    -------
    ProjectedPoints
    """
    start = np.asarray(points_m, np.float64).reshape(-1, 3)
    best = start.copy()
    first = query(field, best, normals=True, device=device, chunk=chunk_for(device))
    residual, normals = first.sdf_m.astype(np.float64), first.normals.astype(np.float64)
    slope = np.ones(len(best))
    shrink = np.ones(len(best))
    for _ in range(config.iterations):
        active = np.flatnonzero(np.abs(residual) > config.tolerance_m)
        if not len(active):
            break
        length = np.clip(
            -residual[active] / slope[active] * shrink[active], -config.max_distance_m, config.max_distance_m
        )
        trial = best[active] + length[:, None] * normals[active]
        offset = trial - start[active]
        distance = np.linalg.norm(offset, axis=1)
        too_far = distance > config.max_distance_m
        trial[too_far] = (start[active] + offset * (config.max_distance_m / np.maximum(distance, 1e-300))[:, None])[
            too_far
        ]
        there = query(field, trial, normals=True, device=device, chunk=chunk_for(device))
        value = there.sdf_m.astype(np.float64)
        better = np.abs(value) < np.abs(residual[active])  # False for NaN: such a step is never taken
        measured = (value - residual[active]) / np.where(np.abs(length) > 1e-12, length, 1e-12)
        # A slope outside [1/4, 4] is not that of a distance: the step crossed a fold, or is lost in rounding.
        slope[active] = np.where(better, np.clip(measured, 0.25, 4.0), slope[active])
        shrink[active] = np.where(better, 1.0, 0.5 * shrink[active])
        taken = active[better]
        best[taken], residual[taken] = trial[better], value[better]
        normals[taken] = there.normals[better]
    return ProjectedPoints(best, normals, residual)


def project_mesh(
    field: HeadField,
    mesh: TriangleMesh,
    config: ProjectConfig = ProjectConfig(),
    *,
    fixed: np.ndarray | None = None,
    device: str = "cpu",
) -> TriangleMesh:
    """The mesh with its vertices on the zero set and its normals from the field.

    A vertex that cannot reach the zero set (on the cap that closes the bust, for one) stays, with the normal it had;
    so do the vertices of a face that the move would turn over.

    Parameters
    ----------
    mesh : canonical metres
    fixed : (V,) bool, vertices that are to stay
    """
    moved = project_points(field, mesh.vertices, config, device=device)
    # Ten times the tolerance: the last step of a point that converges may fall a little short of it.
    on_surface = np.abs(moved.residual_m) <= 10 * config.tolerance_m
    agree = (moved.normals * mesh.normals).sum(1) > 0.0
    keep = on_surface & agree if fixed is None else on_surface & agree & ~fixed
    vertices = np.where(keep[:, None], moved.points, mesh.vertices)
    normals = np.where(keep[:, None], moved.normals, mesh.normals)
    turned = _turned_faces(mesh.vertices, vertices, mesh.faces)
    while turned.any():
        back = np.unique(mesh.faces[turned])
        if np.array_equal(vertices[back], mesh.vertices[back]):
            break
        vertices[back], normals[back] = mesh.vertices[back], mesh.normals[back]
        turned = _turned_faces(mesh.vertices, vertices, mesh.faces)
    return TriangleMesh(vertices, mesh.faces, normals)


def _turned_faces(before: np.ndarray, after: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) bool: faces whose plane turned by more than about 78 degrees, or that lost nearly all their area."""
    a, b, c = (before[faces[:, k]] for k in range(3))
    old = np.cross(b - a, c - a)
    a, b, c = (after[faces[:, k]] for k in range(3))
    new = np.cross(b - a, c - a)
    old_length, new_length = np.linalg.norm(old, axis=1), np.linalg.norm(new, axis=1)
    sliver = old_length <= 1e-14
    turned = (old * new).sum(1) < 0.2 * old_length * new_length
    return ~sliver & (turned | (new_length < 0.02 * old_length))
