"""Portrait cameras and the head's pose in the world, drawn by seed.

Notation: yaw turns the camera around the head from the front (+Z) towards the subject's left (+X), pitch lifts it. One
pinhole camera takes every view of a scene, so its focal length is the scene's; the distance varies from view to view.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.scene.camera import Camera


@dataclass(frozen=True)
class CameraConfig:
    """How views are drawn. Angles in degrees, distances in metres between camera and head centre.

    Parameters
    ----------
    width, height : pixels
    front_yaw, front_pitch : limits of the first view, the portrait
    around_yaw, around_pitch : limits of the others; their yaws are spread evenly, with jitter
    distance_m : range of the scene's typical distance
    fill : range of the part of the picture that the head spans, by the larger of its width and height
    """

    width: int = 256
    height: int = 256
    front_yaw: float = 30.0
    front_pitch: float = 12.0
    around_yaw: float = 150.0
    around_pitch: float = 25.0
    distance_m: tuple[float, float] = (0.6, 1.8)
    fill: tuple[float, float] = (0.5, 0.85)


def rotation_xyz(pitch_deg: float, yaw_deg: float, roll_deg: float) -> np.ndarray:
    """(3, 3) rotation Ry(yaw) Rx(pitch) Rz(roll)."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians([pitch_deg, yaw_deg, roll_deg])) for f in (np.cos, np.sin))
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return ry @ rx @ rz


def sample_world_from_canonical(rng: np.random.Generator) -> np.ndarray:
    """(4, 4) similarity: a head that turns up to 40 degrees and nods up to 15, scaled by 0.9 to 1.1."""
    out = np.eye(4)
    rotation = rotation_xyz(rng.uniform(-15, 15), rng.uniform(-40, 40), rng.uniform(-10, 10))
    out[:3, :3] = rng.uniform(0.9, 1.1) * rotation
    out[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return out


def look_at(centre: np.ndarray, target: np.ndarray, up: np.ndarray, roll_deg: float) -> np.ndarray:
    """(4, 4) pose with OpenCV axes (x right, y down, z forward) at `centre`, looking at `target`."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1) @ rotation_xyz(0.0, 0.0, roll_deg)
    out[:3, 3] = centre
    return out


def sample_cameras(
    rng: np.random.Generator,
    head_points_canonical: np.ndarray,
    world_from_canonical: np.ndarray,
    views: int,
    config: CameraConfig = CameraConfig(),
) -> list[Camera]:
    """Draw `views` cameras; the first is the frontal portrait.

    Parameters
    ----------
    head_points_canonical : (N, 3) points of the head without the shoulders; they are what is framed
    world_from_canonical : (4, 4) similarity

    Returns
    -------
    list of Camera, in the world, with one and the same intrinsics
    """
    scale = np.cbrt(np.linalg.det(world_from_canonical[:3, :3]))
    middle = 0.5 * (head_points_canonical.min(0) + head_points_canonical.max(0))
    typical, fill = rng.uniform(*config.distance_m), rng.uniform(*config.fill)
    others = (np.arange(views - 1) + rng.uniform(0.1, 0.9, views - 1)) / max(views - 1, 1)
    yaws = [np.clip(rng.normal(0, 0.45), -1, 1) * config.front_yaw, *((2 * others - 1) * config.around_yaw)]
    poses, spans = [], []
    for k, yaw in enumerate(yaws):
        limit = config.front_pitch if k == 0 else config.around_pitch
        direction = rotation_xyz(-rng.uniform(-limit, limit), yaw, 0.0) @ np.array([0.0, 0.0, 1.0])
        distance = typical * (1.0 if k == 0 else rng.uniform(0.92, 1.12))
        target = middle + rng.uniform(-0.02, 0.02, 3)
        canonical = look_at(
            target + distance / scale * direction, target, np.array([0.0, 1.0, 0.0]), rng.uniform(-5, 5)
        )
        inside = (head_points_canonical - canonical[:3, 3]) @ canonical[:3, :3]
        spans.append(np.ptp(inside[:, :2] / inside[:, 2:], axis=0).max())
        pose = world_from_canonical @ canonical
        pose[:3, :3] /= scale
        poses.append(pose)
    # The first view gets exactly the drawn fill; no other may burst the frame.
    focal = min(fill / spans[0], 0.95 / max(spans)) * min(config.width, config.height)
    intrinsics = np.array([[focal, 0, config.width / 2], [0, focal, config.height / 2], [0, 0, 1.0]])
    return [Camera(intrinsics, pose, config.width, config.height) for pose in poses]
