"""What the fit is given: one photo, its mask, its camera, and where the head stands."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, similarity_fault, transform_points


@dataclass(frozen=True)
class Portrait:
    """One posed portrait.

    Parameters
    ----------
    image_linear : (H, W, 3) float32, linear Rec. 709 radiance, finite, >= 0
    mask : (H, W) bool, True on the head
    camera : pose and intrinsics of the image, in the scene's world
    canonical_from_world : (4, 4) similarity into the canonical head frame
    saturated : (H, W) bool, True where a channel is white or brighter: clipped by the file's encoding, or beyond what a
        fit compares
    name : for reports
    metres_per_unit : length of one world unit in metres
    landmarks_px : canonical name to (2,) pixel position, where canonical_from_world was found from these alone; empty
        where it is known
    warnings : what the reader had to assume or mend, one line each
    """

    image_linear: np.ndarray
    mask: np.ndarray
    camera: Camera
    canonical_from_world: np.ndarray
    saturated: np.ndarray
    name: str = "portrait"
    metres_per_unit: float = 1.0
    landmarks_px: Mapping[str, np.ndarray] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __post_init__(self):
        size = (self.camera.height, self.camera.width)
        for what, array in (("image", self.image_linear), ("mask", self.mask)):
            if array.shape[:2] != size:
                raise InputError(
                    expected=f"a {what} of the camera's size {size[1]}x{size[0]}",
                    received=f"{array.shape[1]}x{array.shape[0]}",
                    remedy=f"bring {what} and camera to one size",
                )
        bad = ~np.isfinite(self.image_linear)
        if bad.any():
            row, column = np.argwhere(bad.any(-1))[0]
            raise InputError(
                expected="finite pixels",
                received=f"{int(bad.any(-1).sum())} pixel(s) with NaN or inf, the first at row {row}, column {column}",
                remedy="repair the image",
            )
        count = int(self.mask.sum())
        if count == 0:
            raise InputError(
                expected="a mask that marks the head",
                received="a mask without a single pixel",
                remedy="use white (> 127) on the head, black elsewhere",
            )
        check_head_before_camera(self.camera, self.canonical_from_world)

    @property
    def pose_is_estimated(self) -> bool:
        """Whether canonical_from_world came from 2D landmarks, so that the fit should refine it."""
        return bool(self.landmarks_px)

    @property
    def world_from_canonical(self) -> np.ndarray:
        """(4, 4) the inverse similarity."""
        return np.linalg.inv(self.canonical_from_world)


def check_head_before_camera(camera: Camera, canonical_from_world: np.ndarray) -> None:
    """Refuse a head that stands behind the camera or outside the picture, naming the axis flip that would fit.

    Raises
    ------
    InputError : canonical_from_world is no similarity; or the nine canonical landmarks, brought to the world, have no
        positive depth or leave the image.
    """
    if fault := similarity_fault(canonical_from_world):
        raise InputError(
            expected="canonical_from_world, a similarity without reflection",
            received=fault,
            remedy="recompute it from landmarks, or leave it out and give --landmarks",
        )
    points = np.array(list(CANONICAL_LANDMARKS_M.values()))
    x_world = transform_points(np.linalg.inv(canonical_from_world), points)
    u, depth = camera.project(x_world)
    inside = (u >= 0).all(1) & (u[:, 0] <= camera.width) & (u[:, 1] <= camera.height)
    if (depth > 0).all() and inside.mean() >= 0.5:
        return
    flipped = Camera(
        camera.intrinsics, camera.world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0]), camera.width, camera.height
    )
    u_flipped, depth_flipped = flipped.project(x_world)
    inside_flipped = (u_flipped >= 0).all(1) & (u_flipped <= [camera.width, camera.height]).all(1)
    fits = (depth_flipped > 0).all() and inside_flipped.mean() >= 0.5
    where = "behind the camera" if (depth <= 0).any() else "outside the picture"
    raise InputError(
        expected="the head in front of the camera and inside the picture",
        received=f"a head {where} (landmark depths {depth.min():.3g} to {depth.max():.3g} world units)",
        remedy="flip the camera's Y and Z axes (OpenCV pose where OpenGL was expected)"
        if fits
        else "check transform_matrix and canonical_from_world",
    )
