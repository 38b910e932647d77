"""Where an exported asset is looked at from: the portrait's own camera, another's, or one that frames the head; orbits.

Notation: the asset's world is the scene's; up is its axis nearest to the head's own +Y; a turn is about up, positive
from +Z towards +X (to the head's left) in a world with +Y up.
"""

from dataclasses import replace

import numpy as np

from sira_assets.errors import InputError
from sira_assets.relight.glb_model import GlbModel
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import similarity_fault, similarity_scale

# The framing camera stands this many of the asset's largest extents away (a bust of 0.4 m from 1.2 m, as portraits are
# taken) and leaves this share of the picture around it.
FRAMING_DISTANCE = 3.0
FRAMING_MARGIN = 0.08


def portrait_camera(model: GlbModel, *, size: int | None = None) -> tuple[Camera, bool]:
    """The camera of the portrait the asset was made from, and whether it is that one.

    An asset without `scene.extras.camera` is framed from the front (`framing_camera`, 512 pixels unless `size`).

    Parameters
    ----------
    size : longest side of the picture, pixels; the portrait's own if None

    Raises
    ------
    InputError : extras that hold something else than a camera.
    """
    said = model.extras.get("camera")
    if said is None:
        return framing_camera(model, size or 512), False
    try:
        camera = Camera(
            np.array(said["intrinsics"], np.float64),
            np.array(said["world_from_camera"], np.float64),
            int(said["width"]),
            int(said["height"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            expected="intrinsics, world_from_camera, width and height in scene.extras.camera",
            received=f"{type(error).__name__}: {error}",
            remedy="export the avatar again, or give --camera",
        ) from None
    return with_longest_side(camera, size), True


def with_longest_side(camera: Camera, size: int | None) -> Camera:
    """The camera for a picture of `size` pixels on its longest side; unchanged if None."""
    if size is None:
        return camera
    scale = size / max(camera.width, camera.height)
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))


def head_axes(model: GlbModel) -> np.ndarray:
    """(3, 3) rotation whose rows are the head's +X, +Y and +Z in the asset's world.

    Without `scene.extras.canonical_from_world` the head is taken to stand as glTF asks: +Y up, +Z to the front.

    Raises
    ------
    InputError : extras whose matrix is no similarity.
    """
    said = model.extras.get("canonical_from_world")
    if said is None:
        return np.eye(3)
    try:
        matrix = np.array(said, np.float64).reshape(4, 4)
    except (TypeError, ValueError):
        matrix = np.full((4, 4), np.nan)
    if similarity_fault(matrix):
        raise InputError(
            expected="a 4x4 similarity in scene.extras.canonical_from_world",
            received=f"{said}"[:80],
            remedy="export the avatar again",
        )
    return matrix[:3, :3] / similarity_scale(matrix)


def up_axis(model: GlbModel) -> np.ndarray:
    """(3,) the world's axis, +-X, +-Y or +-Z, nearest to the head's own up."""
    up = head_axes(model)[1]
    largest = int(np.abs(up).argmax())
    out = np.zeros(3)
    out[largest] = np.sign(up[largest])
    return out


def framing_camera(model: GlbModel, size: int) -> Camera:
    """A square picture with the whole asset in it, from the front of the head."""
    axes = head_axes(model)
    inside = model.vertices[np.unique(model.faces)] @ axes.T
    low, high = inside.min(0), inside.max(0)
    distance = FRAMING_DISTANCE * float((high - low).max())
    if distance <= 0:
        raise InputError(expected="an asset of some size", received="triangles of no extent", remedy="export it again")
    centre = 0.5 * (low + high)
    eye = np.array([centre[0], centre[1], high[2] + distance])
    pose = np.eye(4)
    # OpenCV's axes: x to the right is the head's +X, y down its -Y, z away from the viewer its -Z.
    pose[:3, :3] = axes.T @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = axes.T @ eye
    slope = np.abs((inside[:, :2] - centre[:2]) / (eye[2] - inside[:, 2:])).max()
    focal = 0.5 * size * (1.0 - FRAMING_MARGIN) / slope
    return Camera(np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]]), pose, size, size)


def rotation_about(axis: np.ndarray, degrees: float) -> np.ndarray:
    """(3, 3) rotation by the right-hand rule (Rodrigues)."""
    x, y, z = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def orbited(camera: Camera, centre: np.ndarray, up: np.ndarray, degrees: float) -> Camera:
    """The camera carried around `centre` about `up`, looking at it as before."""
    turn = rotation_about(up, degrees)
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = turn @ (pose[:3, 3] - centre) + centre
    return replace(camera, world_from_camera=pose)


def orbit_centre(model: GlbModel) -> np.ndarray:
    """(3,) the middle of the asset's bounding box, world."""
    used = model.vertices[np.unique(model.faces)]
    return 0.5 * (used.min(0) + used.max(0))
