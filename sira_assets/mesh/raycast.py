"""Rays and closest points against a mesh, through Open3D's Embree scene.

Notation: a ray is o + t d with t in units of |d|; barycentric (b0, b1, b2) weigh a face's vertices in its own order.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.open3d_core import open3d_core
from sira_assets.mesh.triangle_mesh import TriangleMesh


@dataclass(frozen=True)
class RayHits:
    """First hits of N rays.

    Parameters
    ----------
    t : (N,) distance in units of |direction|, inf where nothing is hit
    face : (N,) int64, -1 where nothing is hit
    barycentric : (N, 3), zeros where nothing is hit
    hit : (N,) bool
    """

    t: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    hit: np.ndarray


@dataclass(frozen=True)
class ClosestPoints:
    """Nearest points of the surface.

    Parameters
    ----------
    points : (N, 3)
    distance : (N,) unsigned, in the mesh's unit
    face : (N,) int64
    """

    points: np.ndarray
    distance: np.ndarray
    face: np.ndarray


class Raycaster:
    """A mesh ready to be asked. Single precision inside: 1e-7 of the mesh's size."""

    def __init__(self, mesh: TriangleMesh):
        open3d = open3d_core()
        if not len(mesh.faces):
            raise InputError(expected="a mesh with faces", received="none", remedy="check the mesh file")
        self._mesh = mesh
        # Subtracting the centre keeps float32 exact to the size of the mesh, wherever the mesh stands.
        self._centre = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            open3d.core.Tensor(np.ascontiguousarray(mesh.vertices - self._centre, np.float32)),
            open3d.core.Tensor(np.ascontiguousarray(mesh.faces, np.uint32)),
        )

    @property
    def mesh(self) -> TriangleMesh:
        """The mesh that is asked."""
        return self._mesh

    def _rays(self, origins: np.ndarray, directions: np.ndarray):
        open3d = open3d_core()
        origins = np.asarray(origins, np.float64).reshape(-1, 3)
        rays = np.empty((len(origins), 6), np.float32)
        rays[:, :3] = origins - self._centre
        rays[:, 3:] = directions
        return open3d.core.Tensor.from_numpy(rays)

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> RayHits:
        """First hits, on either side of a face.

        Parameters
        ----------
        origins : (N, 3) in the mesh's frame
        directions : (N, 3) or (3,), any length above 0
        """
        result = self._scene.cast_rays(self._rays(origins, directions))
        t = result["t_hit"].numpy().astype(np.float64)
        hit = np.isfinite(t)
        uv = result["primitive_uvs"].numpy().astype(np.float64)
        barycentric = np.where(hit[:, None], np.column_stack([1.0 - uv.sum(1), uv]), 0.0)
        face = np.where(hit, result["primitive_ids"].numpy().astype(np.int64), -1)
        return RayHits(t, face, barycentric, hit)

    def occluded(self, origins: np.ndarray, directions: np.ndarray, *, near: float = 0.0) -> np.ndarray:
        """(N,) bool: whether anything lies beyond `near` (in units of |direction|) along each ray."""
        return self._scene.test_occlusions(self._rays(origins, directions), tnear=near).numpy()

    def closest(self, points: np.ndarray) -> ClosestPoints:
        """Nearest surface points of (N, 3) points."""
        open3d = open3d_core()
        points = np.asarray(points, np.float64).reshape(-1, 3)
        query = open3d.core.Tensor(np.ascontiguousarray(points - self._centre, np.float32))
        result = self._scene.compute_closest_points(query)
        nearest = result["points"].numpy().astype(np.float64) + self._centre
        face = result["primitive_ids"].numpy().astype(np.int64)
        return ClosestPoints(nearest, np.linalg.norm(points - nearest, axis=1), face)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Distance (N,) of points (N, 3) to the surface, the mesh's unit, negative inside; needs a watertight mesh."""
        open3d = open3d_core()
        query = open3d.core.Tensor(np.ascontiguousarray(points - self._centre, np.float32))
        return self._scene.compute_signed_distance(query).numpy().astype(np.float64)
