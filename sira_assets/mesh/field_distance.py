"""How far a mesh stands from a field's zero set, both ways.

Notation: x a point of the mesh; p(x) where it comes to lie on the zero set when it is moved along the field's normals.
The distance |p(x) - x| is at least the distance of x from the zero set; the distance of p(x) from the mesh measures
the other way.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.fields.head_field import HeadField
from sira_assets.mesh.lattice import bounds_sdf
from sira_assets.mesh.project import ProjectConfig, ProjectedPoints, project_points
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products


@dataclass(frozen=True)
class SurfaceGap:
    """Two-sided distance of two surfaces in the points' unit: mean and greatest, there (first to second) and back."""

    mean_there: float
    greatest_there: float
    mean_back: float
    greatest_back: float

    @property
    def greatest(self) -> float:
        """The greater of both ways."""
        return max(self.greatest_there, self.greatest_back)


def surface_samples(mesh: TriangleMesh, count: int, *, seed: int = 0) -> np.ndarray:
    """(N, 3) points of a mesh: `count` at random, even in area, and the middle of every face (its worst point)."""
    area = np.linalg.norm(face_cross_products(mesh.vertices, mesh.faces), axis=1)
    rng = np.random.default_rng(seed)
    face = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.concatenate([a[face] + u * (b - a)[face] + v * (c - a)[face], (a + b + c) / 3])


def field_distance(
    field: HeadField,
    mesh: TriangleMesh,
    *,
    samples: int = 100_000,
    reach_m: float = 0.005,
    margin_m: float = 0.002,
    seed: int = 0,
    device: str = "cpu",
) -> SurfaceGap:
    """Distance of a mesh from the zero set of `field`, metres.

    Parameters
    ----------
    mesh : canonical metres
    samples : random points, beside every face's middle
    reach_m : points are followed at most this far; one that does not arrive counts with what |f| is left as well
    margin_m : points within this of the head's box are left out: there the box cuts the zero set

    Returns
    -------
    SurfaceGap : there is mesh to zero set, back is zero set to mesh.
    """
    points = surface_samples(mesh, samples, seed=seed)
    points = points[bounds_sdf(points) < -margin_m]
    if not len(points):
        return SurfaceGap(0.0, 0.0, 0.0, 0.0)
    moved = project_points(field, points, ProjectConfig(reach_m, iterations=8), device=device)
    there = np.linalg.norm(moved.points - points, axis=1) + np.abs(moved.residual_m)
    worst = np.argsort(-there)[: max(1, len(there) // 50)]
    there[worst] = _nearer(field, points[worst], moved, worst, there[worst], reach_m, device)
    arrived = np.abs(moved.residual_m) <= 2e-5  # ten times the projection's tolerance
    back = Raycaster(mesh).closest(moved.points[arrived]).distance if arrived.any() else np.zeros(1)
    return SurfaceGap(float(there.mean()), float(there.max()), float(back.mean()), float(back.max()))


def _nearer(
    field: HeadField,
    points: np.ndarray,
    moved: ProjectedPoints,
    rows: np.ndarray,
    distance: np.ndarray,
    reach_m: float,
    device: str,
) -> np.ndarray:
    """Distances of points from the zero set, no longer along its normals but slid along it towards each point.

    x is nearest to a point p of the zero set where x - p is normal to it, so p goes along the surface by the rest.
    """
    at, normals = moved.points[rows], moved.normals[rows]
    for _ in range(4):
        offset = points - at
        along = offset - (offset * normals).sum(1, keepdims=True) * normals
        slid = project_points(field, at + along, ProjectConfig(reach_m), device=device)
        found = np.linalg.norm(slid.points - points, axis=1) + np.abs(slid.residual_m)
        better = found < distance
        if not better.any():
            break
        distance = np.where(better, found, distance)
        at = np.where(better[:, None], slid.points, at)
        normals = np.where(better[:, None], slid.normals, normals)
    return distance


def mesh_distance(first: TriangleMesh, second: TriangleMesh, *, samples: int = 100_000, seed: int = 0) -> SurfaceGap:
    """Distance of two meshes, their unit: vertices, middles of faces and `samples` random points of each."""
    ways = []
    for mesh, other in ((first, second), (second, first)):
        points = np.concatenate([mesh.vertices[np.unique(mesh.faces)], surface_samples(mesh, samples, seed=seed)])
        distance = Raycaster(other).closest(points).distance
        ways += [float(distance.mean()), float(distance.max())]
    return SurfaceGap(*ways)
