"""Portrait cameras and the head's pose in the world, drawn by seed.

Notation: yaw turns the camera around the head from the front (+Z) towards the subject's left (+X), pitch lifts it. One
pinhole camera takes every view of a scene, so its intrinsics are the scene's; the distance varies from view to view.
A focal length in mm is 35 mm equivalent: that of a frame 24 mm high. The picture is a square cut out of that frame.
"""

from dataclasses import dataclass
from itertools import count

import numpy as np

from sira_assets.scene.camera import Camera

FRAME_MM = 24.0
MOST_FILL = 0.95  # of the picture that a whole head spans in any view
# How portraits are taken: name, share, focal lengths in mm, distances in m both drawn on a logarithmic scale.
# Phones have 24 to 28 mm at the back, 22 to 30 at the front, 48 to 77 in the second lens; portraits 50 to 135.
STYLES = (
    ("selfie", 0.22, (22.0, 30.0), (0.35, 0.65)),
    ("phone", 0.20, (24.0, 28.0), (0.6, 1.3)),
    ("phone tele", 0.15, (48.0, 77.0), (0.8, 1.8)),
    ("portrait", 0.25, (50.0, 90.0), (1.0, 2.2)),
    ("studio", 0.18, (85.0, 135.0), (1.6, 3.2)),
)


@dataclass(frozen=True)
class CameraConfig:
    """How views are drawn. Angles in degrees, distances in metres between camera and head centre.

    Parameters
    ----------
    width, height : pixels
    front_yaw, front_pitch : limits of the first view, the portrait; draws are normal, of 0.4 of the limit
    around_yaw, around_pitch : limits of the others; their yaws are spread evenly, with jitter
    fill : range of the part of the picture that the head spans, by the larger of its width and height
    off_centre : share of scenes whose picture is cut from a side of the frame: the principal point leaves the middle
    crops : share of scenes whose picture cuts the head, at any side
    """

    width: int = 256
    height: int = 256
    front_yaw: float = 45.0
    front_pitch: float = 20.0
    around_yaw: float = 150.0
    around_pitch: float = 25.0
    fill: tuple[float, float] = (0.4, 0.88)
    off_centre: float = 0.3
    crops: float = 0.0


@dataclass(frozen=True)
class Framing:
    """A scene's choice of lens and picture.

    Parameters
    ----------
    style : among STYLES; focal_mm : 35 mm equivalent; distance_m : of the first view, to the head's centre
    fill : part of the picture that the head spans in the first view, above 1 where it is cut
    shift : (2,) where the middle of the head is, less the middle of the picture, in pictures
    axis : (2,) where the optical axis meets the picture, less its middle, in pictures
    """

    style: str
    focal_mm: float
    distance_m: float
    fill: float
    shift: np.ndarray
    axis: np.ndarray


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def sample_framing(rng: np.random.Generator, config: CameraConfig = CameraConfig(), head_m: float = 0.25) -> Framing:
    """Draw a framing of a head `head_m` high.

    The lens and the distance say how much of the frame's height the head takes; the picture is cut so that the head
    takes `fill` of it, or the photographer steps back where it would take more.
    """
    name, _, focal, distance = STYLES[rng.choice(len(STYLES), p=[share for _, share, *_ in STYLES])]
    focal_mm, distance_m = _log_uniform(rng, *focal), _log_uniform(rng, *distance)
    fill, shift = rng.uniform(*config.fill), rng.uniform(-0.5, 0.5, 2)
    cut, off_centre = rng.random() < config.crops, rng.random() < config.off_centre
    axis = rng.uniform(-0.5, 0.5, 2)
    of_frame = head_m * focal_mm / (FRAME_MM * distance_m)
    if of_frame > fill:
        distance_m *= of_frame / fill
        of_frame = fill
    picture_of_frame = of_frame / fill
    # The head stays whole: it may move by what the picture leaves beside it, mostly less.
    shift = shift * (0.4 * (1.0 - fill))
    if cut:
        fill = rng.uniform(1.05, 1.5)
        shift = rng.uniform(-0.3, 0.3, 2)
    # How far the picture's middle can be from the frame's, in pictures, if the frame is 24 mm square.
    axis = axis * (1.0 / picture_of_frame - 1.0) if off_centre else np.zeros(2)
    return Framing(name, focal_mm, distance_m, fill, shift, axis)


def rotation_xyz(pitch_deg: float, yaw_deg: float, roll_deg: float) -> np.ndarray:
    """(3, 3) rotation Ry(yaw) Rx(pitch) Rz(roll)."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians([pitch_deg, yaw_deg, roll_deg])) for f in (np.cos, np.sin))
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return ry @ rx @ rz


def _tilt(rng: np.random.Generator, deviation: float, limit: float) -> float:
    """A normal draw, in degrees, held within a limit."""
    return float(np.clip(rng.normal(0.0, deviation), -limit, limit))


def sample_world_from_canonical(rng: np.random.Generator) -> np.ndarray:
    """(4, 4) similarity: a head that turns up to 40 degrees, nods and tilts as people do, scaled by 0.9 to 1.1.

    Nods of 7 and tilts of 5 degrees standard deviation are about those of posed portraits; world +Y is up.
    """
    out = np.eye(4)
    rotation = rotation_xyz(_tilt(rng, 7.0, 20.0), rng.uniform(-40, 40), _tilt(rng, 5.0, 15.0))
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
    framing = sample_framing(rng, config, scale * np.ptp(head_points_canonical[:, 1]))
    others = (np.arange(views - 1) + rng.uniform(0.1, 0.9, views - 1)) / max(views - 1, 1)
    yaws = [_tilt(rng, 0.4, 1.0) * config.front_yaw, *((2 * others - 1) * config.around_yaw)]
    poses, spans = [], []
    for k, yaw in enumerate(yaws):
        front = _tilt(rng, 0.4, 1.0) * config.front_pitch
        pitch = front if k == 0 else rng.uniform(-config.around_pitch, config.around_pitch)
        away = rotation_xyz(-pitch, yaw, 0.0) @ np.array([0.0, 0.0, 1.0])
        distance = framing.distance_m * (1.0 if k == 0 else rng.uniform(0.92, 1.12))
        centre = middle + distance / scale * away
        jitter = np.zeros(3) if k == 0 else rng.uniform(-0.02, 0.02, 3)
        poses.append(look_at(centre, middle + jitter, np.array([0.0, 1.0, 0.0]), _tilt(rng, 3.0, 8.0)))
        inside = (head_points_canonical - centre) @ poses[-1][:3, :3]
        spans.append(np.ptp(inside[:, :2] / inside[:, 2:], axis=0).max())
    # The first view gets exactly the drawn fill.
    focal = framing.fill / spans[0]
    if framing.fill < 1.0:
        focal = min(focal, MOST_FILL / max(spans))
    size = np.array([config.width, config.height])
    pixels = focal * size.min()
    axis = 0.5 * size + framing.axis * size.min()
    intrinsics = np.array([[pixels, 0, axis[0]], [0, pixels, axis[1]], [0, 0, 1.0]])
    edges = np.array([-axis, size - axis]) / pixels
    out = []
    for k, canonical in enumerate(poses):
        # Turn the camera from the head to where the head shall be off the optical axis.
        wanted = (framing.shift - framing.axis) / focal
        canonical[:3, :3] = canonical[:3, :3] @ _towards(wanted).T
        # No other view cuts the head unless the first is meant to.
        if k > 0 and framing.fill < 1.0:
            canonical = _showing_all(canonical, head_points_canonical, *edges)
        pose = world_from_canonical @ canonical
        pose[:3, :3] /= scale
        out.append(Camera(intrinsics, pose, config.width, config.height))
    return out


def _showing_all(pose: np.ndarray, points: np.ndarray, least: np.ndarray, most: np.ndarray) -> np.ndarray:
    """The (4, 4) pose itself where points (N, 3) lie within slopes `least` to `most` (2,), the picture's edges; else
    turned so that they lie in the middle, and back from them where they are too large for it."""
    middle = 0.5 * (points.min(0) + points.max(0))
    for attempt in count():
        inside = (points - pose[:3, 3]) @ pose[:3, :3]
        slopes = inside[:, :2] / inside[:, 2:]
        low, high = slopes.min(0), slopes.max(0)
        if (low >= least).all() and (high <= most).all():
            return pose
        # A turn moves an outline's middle but nearly to where it shall be; an outline that shrinks gets there.
        away = max(((high - low) / (most - least)).max() / MOST_FILL, 1.0 + 0.01 * attempt)
        pose = pose.copy()
        pose[:3, :3] = pose[:3, :3] @ _towards(0.5 * (low + high)) @ _towards(0.5 * (least + most)).T
        pose[:3, 3] = middle + away * (pose[:3, 3] - middle)


def _towards(slope: np.ndarray) -> np.ndarray:
    """(3, 3) least rotation of camera axes that takes (0, 0, 1) to the direction (slope_x, slope_y, 1)."""
    target = np.array([*slope, 1.0]) / np.sqrt(slope @ slope + 1.0)
    v, c = np.cross([0.0, 0.0, 1.0], target), target[2]
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + k + k @ k / (1.0 + c)
