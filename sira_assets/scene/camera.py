"""A calibrated pinhole camera.

Notation: x_world a point in the scene's world; x_camera in OpenCV axes (x right, y down, z forward); u the pixel
coordinates with pixel centres at +0.5; K the intrinsics in pixels. Depth is z_camera, never the ray length.
"""

from dataclasses import dataclass, replace

import numpy as np

from sira_assets.errors import InputError

# nerfstudio and Blender look along -Z with +Y up; OpenCV along +Z with +Y down. The flip is its own inverse.
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Camera:
    """A pinhole camera posed in a world.

    Parameters
    ----------
    intrinsics : (3, 3) array K, pixels; K[2] = [0, 0, 1]
    world_from_camera : (4, 4) rigid array, OpenCV axes
    width, height : image size, pixels
    """

    intrinsics: np.ndarray
    world_from_camera: np.ndarray
    width: int
    height: int

    def __post_init__(self):
        k = np.array(self.intrinsics, np.float64)
        pose = np.array(self.world_from_camera, np.float64)
        if k.shape != (3, 3) or not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0 or abs(np.linalg.det(k)) < 1e-9:
            raise InputError(
                expected="intrinsics [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths in pixels",
                received=f"{k.tolist()}",
                remedy="check fl_x, fl_y, cx, cy of the scene, or give --focal-px",
            )
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise InputError(
                expected="a finite 4x4 camera pose", received=f"{pose.tolist()}", remedy="check transform_matrix"
            )
        error = np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max()
        if error > 1e-3 or np.linalg.det(pose[:3, :3]) < 0:
            raise InputError(
                expected="a rigid camera pose (a rotation and a translation)",
                received=f"a 3x3 block off by {error:.2g}, determinant {np.linalg.det(pose[:3, :3]):.3g}",
                remedy="remove scale and reflection from transform_matrix; size belongs in canonical_from_world",
            )
        for array in (k, pose):
            array.setflags(write=False)
        object.__setattr__(self, "intrinsics", k)
        object.__setattr__(self, "world_from_camera", pose)

    @property
    def camera_from_world(self) -> np.ndarray:
        """(4, 4) rigid array, the inverse pose."""
        r, t = self.world_from_camera[:3, :3], self.world_from_camera[:3, 3]
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = r.T, -r.T @ t
        return out

    @property
    def centre_world(self) -> np.ndarray:
        """(3,) the projection centre."""
        return self.world_from_camera[:3, 3]

    def rays_world(self, pixels: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Unit rays through pixel positions.

        Parameters
        ----------
        pixels : (N, 2) pixel positions u (centres at +0.5); default: all centres, row by row.

        Returns
        -------
        origins_world, directions_world : (N, 3) float64 each; directions are unit.
        """
        if pixels is None:
            x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
            pixels = np.stack([x, y], -1).reshape(-1, 2)
        homogeneous = np.concatenate([pixels, np.ones((len(pixels), 1))], 1)
        directions = homogeneous @ np.linalg.inv(self.intrinsics).T @ self.world_from_camera[:3, :3].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(self.centre_world, directions.shape).copy(), directions

    def project(self, x_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel positions (N, 2) and depths (N,) of world points (N, 3); depth <= 0 is behind the camera."""
        x = x_world @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        depth = x[:, 2]
        u = x @ self.intrinsics.T
        return u[:, :2] / np.where(np.abs(depth) < 1e-12, 1e-12, depth)[:, None], depth

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera for an image of another size (pixel edges, not centres, are scaled)."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsics=scale @ self.intrinsics, width=width, height=height)
