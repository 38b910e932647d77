"""Which part of the truth counts: face, head, all, NoW's disc; and what the input camera sees.

Notation: points are in the truth's world, metres. Regions are defined on the truth alone, so that no prediction can
choose where it is measured.
"""

from collections.abc import Mapping
from typing import Literal

import numpy as np

from sira_assets.errors import InputError
from sira_assets.measure.surface import Surface
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, transform_points

Region = Literal["face", "head", "all"]

# H3DS's evaluation sphere: `face_sphere` of its public protocol.
FACE_RADIUS_M = 0.095

# The head ends at a plane through a point 15 mm under the canonical chin that rises towards the nape (0.35 is 19
# degrees: 15 mm under the chin in front, the height of the ear lobe 130 mm behind it), so that neck and collar are not
# counted.
HEAD_BELOW_CHIN_M = 0.015
HEAD_RISE = 0.35

# A point counts as seen when nothing hits its ray earlier than this: scans have relief at the millimetre.
SEEN_TOLERANCE_M = 2e-3

NOW_LANDMARKS = (
    "right_eye_outer",
    "right_eye_inner",
    "left_eye_inner",
    "left_eye_outer",
    "nose_base",
    "mouth_right",
    "mouth_left",
)


def in_face(points: np.ndarray, nose_tip: np.ndarray, radius_m: float = FACE_RADIUS_M) -> np.ndarray:
    """(N,) bool: within `radius_m` of the nose tip."""
    return np.linalg.norm(np.asarray(points) - np.asarray(nose_tip), axis=1) < radius_m


def in_head(points: np.ndarray, canonical_from_world: np.ndarray) -> np.ndarray:
    """(N,) bool: above the plane that parts head from neck (see `HEAD_RISE`), judged in the canonical frame."""
    x = transform_points(canonical_from_world, np.asarray(points, np.float64))
    _, chin_y, chin_z = CANONICAL_LANDMARKS_M["chin"]
    return x[:, 1] > chin_y - HEAD_BELOW_CHIN_M + HEAD_RISE * np.maximum(chin_z - x[:, 2], 0.0)


def now_disc(landmarks: Mapping[str, np.ndarray]) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of NoW's face region.

    Centre: 0.3 of the way from the nose base to the point between the inner eye corners; radius: 1.4 times the mean of
    the outer eye distance and that nose length (Sanyal et al. 2019, DOI 10.1109/CVPR.2019.00795, and its public
    evaluation).

    Raises
    ------
    InputError : one of the five landmarks is absent.
    """
    needed = NOW_LANDMARKS[:5]
    absent = [name for name in needed if name not in landmarks]
    if absent:
        raise InputError(
            expected="the truth's eye corners and nose base for the protocol now",
            received=f"no {', '.join(absent)}",
            remedy="give them by --landmarks",
        )
    right_outer, right_inner, left_inner, left_outer, base = (np.asarray(landmarks[k], np.float64) for k in needed)
    bridge = (right_inner + left_inner) / 2
    radius = 1.4 * (np.linalg.norm(right_outer - left_outer) + np.linalg.norm(bridge - base)) / 2
    return base + 0.3 * (bridge - base), float(radius)


def seen_by(camera: Camera, points: np.ndarray, surface: Surface) -> np.ndarray:
    """(N,) bool: inside the picture, before the camera and not hidden by the surface the points lie on."""
    u, depth = camera.project(points)
    inside = (depth > 0) & (u >= 0).all(1) & (u[:, 0] <= camera.width) & (u[:, 1] <= camera.height)
    ray = points - camera.centre_world
    distance = np.linalg.norm(ray, axis=1)
    origin = np.broadcast_to(camera.centre_world, ray.shape)
    hit = surface.first_hit(origin, ray / np.maximum(distance, 1e-30)[:, None])
    return inside & (hit > distance - SEEN_TOLERANCE_M)
