"""`transforms.json`, as nerfstudio and Blender's NeRF exporters write it.

Poses there are OpenGL's (camera looks along -Z, +Y up) and camera-to-world; intrinsics stand once for the file or in
each frame; Blender's variant has only `camera_angle_x` and names without suffix. Of this project's own keys are
`canonical_from_world`, `landmarks_2d`, `landmarks_m` (or `landmarks_3d`) and `metres_per_unit`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.camera import OPENCV_FROM_OPENGL, Camera
from sira_assets.scene.distortion import Distortion
from sira_assets.scene.frame import Frame, path_inside
from sira_assets.scene.image import image_size
from sira_assets.scene.landmarks import Landmarks, landmarks_from_json, read_json

# COLMAP's and nerfstudio's names of models that are a pinhole with, at most, OpenCV's five coefficients.
CAMERA_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")


@dataclass(frozen=True)
class SceneFile:
    """What a scene's description says.

    Parameters
    ----------
    frames : one or many
    canonical_from_world : (4, 4) or None where it is not said
    landmarks : of the first frame and of the world; may be empty
    metres_per_unit : or None where it is not said
    """

    frames: tuple[Frame, ...]
    canonical_from_world: np.ndarray | None = None
    landmarks: Landmarks = field(default_factory=Landmarks)
    metres_per_unit: float | None = None


def _number(data: Mapping, key: str, default: float | None, path: Path) -> float | None:
    value = data.get(key)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(expected=f"a number {key} in {path}", received=repr(value)[:60], remedy=f"mend {key}")
    return float(value)


def _matrix(value: object, what: str, path: Path) -> np.ndarray:
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InputError(
            expected=f"{what} in {path}, a finite 4x4 matrix", received=f"{str(value)[:60]}", remedy=f"mend {what}"
        )
    return matrix


def _intrinsics(data: Mapping, width: int, height: int, path: Path) -> np.ndarray:
    def focal(key: str, angle_key: str, size: int) -> float | None:
        angle = _number(data, angle_key, None, path)
        if angle is not None and not 0.0 < angle < math.pi:
            raise InputError(
                expected=f"{angle_key} in {path} between 0 and pi radians", received=f"{angle:g}", remedy="mend it"
            )
        return _number(data, key, None if angle is None else 0.5 * size / math.tan(0.5 * angle), path)

    fx, fy = focal("fl_x", "camera_angle_x", width), focal("fl_y", "camera_angle_y", height)
    if fx is None and fy is None:
        raise InputError(
            expected=f"fl_x, or camera_angle_x, in {path}", received="neither", remedy="add it, or give --focal-px"
        )
    return np.array(
        [
            [fy if fx is None else fx, _number(data, "skew", 0.0, path), _number(data, "cx", width / 2, path)],
            [0.0, fx if fy is None else fy, _number(data, "cy", height / 2, path)],
            [0.0, 0.0, 1.0],
        ]
    )


def _distortion(data: Mapping, path: Path) -> Distortion:
    model = data.get("camera_model", "OPENCV")
    higher = [key for key in ("k4", "k5", "k6") if _number(data, key, 0.0, path)]
    if model not in CAMERA_MODELS or higher:
        raise InputError(
            expected=f"a camera_model of {', '.join(CAMERA_MODELS)} with k1, k2, k3, p1, p2 only in {path}",
            received=f"{model} {' '.join(higher)}",
            remedy="undistort the pictures to a pinhole first (colmap image_undistorter)",
        )
    return Distortion(**{key: _number(data, key, 0.0, path) for key in ("k1", "k2", "p1", "p2", "k3")})


def _frame(shared: Mapping, frame: Mapping, folder: Path, path: Path) -> Frame:
    data = {**shared, **frame}
    image_path = path_inside(folder, data.get("file_path"))
    width, height = image_size(image_path)
    for key, size in (("w", width), ("h", height)):
        if _number(data, key, size, path) != size:
            raise InputError(
                expected=f"{image_path.name} of {data.get('w')}x{data.get('h')} pixels, as {path} says",
                received=f"{width}x{height}",
                remedy="bring the picture and w, h, fl_x, fl_y, cx, cy to one size",
            )
    mask = data.get("mask_path")
    pose = _matrix(data.get("transform_matrix"), "transform_matrix", path) @ OPENCV_FROM_OPENGL
    return Frame(
        camera=Camera(_intrinsics(data, width, height, path), pose, width, height),
        image_path=image_path,
        mask_path=path_inside(folder, mask) if mask else None,
        distortion=_distortion(data, path),
    )


def read_camera(path: str | Path, *, frame: int = 0) -> Camera:
    """One camera of a `transforms.json`, without its picture where `w` and `h` stand in the file.

    It is the pinhole that `read_transforms` gives the frame as well; the distortion, which there is undone in the
    picture, is left out.

    Raises
    ------
    InputError : not of that form, no such frame, an unusable camera, or a lens that `read_transforms` refuses.
    """
    path = Path(path)
    shared, frames = _shared_and_frames(path)
    if not 0 <= frame < len(frames):
        raise InputError(
            expected=f"a frame of 0 to {len(frames) - 1} in {path}", received=f"{frame}", remedy="choose another"
        )
    data = {**shared, **frames[frame]}
    _distortion(data, path)  # refuses lenses that are no pinhole behind their distortion
    width, height = (_number(data, key, None, path) for key in ("w", "h"))
    if not width or not height:
        width, height = image_size(path_inside(path.parent, data.get("file_path")))
    pose = _matrix(data.get("transform_matrix"), "transform_matrix", path) @ OPENCV_FROM_OPENGL
    return Camera(_intrinsics(data, int(width), int(height), path), pose, int(width), int(height))


def _shared_and_frames(path: Path) -> tuple[dict, list[dict]]:
    data = read_json(path)
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise InputError(
            expected=f"frames, a list of one or more views, in {path}",
            received=str(frames)[:60],
            remedy="write it as nerfstudio does",
        )
    return {key: value for key, value in data.items() if key != "frames"}, frames


def read_transforms(path: str | Path, *, only_first: bool = False) -> SceneFile:
    """Read a `transforms.json`; pictures are looked at for their size only.

    Parameters
    ----------
    path : the file; names in it are relative to its folder
    only_first : leave the other frames (and their files) alone

    Raises
    ------
    InputError : not of that form, a path that leads out of the folder, a missing file, an unusable camera.
    """
    path = Path(path)
    shared, frames = _shared_and_frames(path)
    canonical = shared.get("canonical_from_world")
    metres = _number(shared, "metres_per_unit", None, path)
    if metres is not None and metres <= 0:
        raise InputError(expected=f"metres_per_unit > 0 in {path}", received=f"{metres:g}", remedy="mend it")
    # 2D landmarks may stand in the frame they were found in.
    own = {**shared, **{k: v for k, v in frames[0].items() if k.startswith("landmarks")}}
    return SceneFile(
        frames=tuple(_frame(shared, frame, path.parent, path) for frame in (frames[:1] if only_first else frames)),
        canonical_from_world=None if canonical is None else _matrix(canonical, "canonical_from_world", path),
        landmarks=landmarks_from_json(own, path.name),
        metres_per_unit=metres,
    )
