"""From what a user brings to a `Portrait`: a scene folder, or a bare photo with a mask, landmarks and a focal length.

Where the head stands (`canonical_from_world`) comes from the file; else from 3D landmarks; else from 2D landmarks and
the intrinsics. What the user gives beside the scene overrides it. A scene's `gt/` is never looked at.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.camera import Camera
from sira_assets.scene.cameras_npz import read_cameras_npz
from sira_assets.scene.canonical import canonical_from_landmarks, similarity_scale
from sira_assets.scene.frame import Frame
from sira_assets.scene.image import ImageFile, image_size, orient, read_image, read_mask
from sira_assets.scene.landmarks import Landmarks, landmarks_from_json, read_json, read_landmarks
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.pose import camera_from_canonical
from sira_assets.scene.transforms_json import SceneFile, read_transforms

# Diagonal of the 36 x 24 mm film that "35 mm equivalent" refers to (CIPA DCG-001-2018, annex).
FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
# A classic portrait lens. A wrong guess moves the head's distance in proportion; the image still aligns.
ASSUMED_FOCAL_35MM = 85.0
# Heads of people differ by this much in size; outside it the unit is not the metre that was claimed.
PLAUSIBLE_SCALE = (0.8, 1.25)
FULL_MASK = 0.995


@dataclass(frozen=True)
class _Given:
    """The user's own files and numbers, each of which overrides what the scene says."""

    mask: Path | None
    landmarks: Landmarks | None
    focal_px: float | None
    fov_deg: float | None


def read_frames(folder: str | Path) -> list[Frame]:
    """All posed views of a scene folder, without their pixels.

    Parameters
    ----------
    folder : holds `transforms.json` (or is that file), or `cameras.npz` with `image/` and `mask/`

    Raises
    ------
    InputError : neither is there, or it is unusable.
    """
    return list(_read_description(Path(folder), only_first=False).frames)


def read_frame(frame: Frame) -> tuple[ImageFile, np.ndarray | None]:
    """Picture and mask of one view as its pinhole camera sees them; lens distortion is undone.

    Raises
    ------
    InputError : unreadable files, or a mask of another size.
    """
    image = read_image(frame.image_path)
    mask = None if frame.mask_path is None else _fitting_mask(read_mask(frame.mask_path), image, frame.mask_path)
    if not frame.distortion:
        return image, mask
    undo, k = frame.distortion.undistorted, frame.camera.intrinsics
    alpha = None if image.alpha is None else undo(image.alpha, k)
    image = replace(image, linear=undo(image.linear, k), saturated=undo(image.saturated, k), alpha=alpha)
    return image, None if mask is None else undo(mask, k)


def read_scene(
    path: str | Path,
    *,
    mask: str | Path | None = None,
    landmarks: str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
) -> Portrait:
    """Read one portrait; of a scene with many views, the first.

    Parameters
    ----------
    path : a scene folder (or its `transforms.json` or `cameras.npz`), or a photo
    mask, landmarks : files that override the scene's; a bare photo needs both, unless its alpha is the mask
    focal_px : focal length in pixels, > 0; overrides the scene's
    fov_deg : the same as the picture's horizontal field of view in degrees, in (0, 180)

    Returns
    -------
    Portrait. The world of a bare photo is the canonical head frame itself.

    Raises
    ------
    InputError : anything that cannot be used, with the remedy.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(
            expected=f"a scene folder or a photo at {path}", received="nothing there", remedy="check the path"
        )
    if focal_px is not None and not (math.isfinite(focal_px) and focal_px > 0):
        raise InputError(expected="--focal-px > 0", received=f"{focal_px}", remedy="give pixels of this picture")
    if fov_deg is not None and not 0 < fov_deg < 180:
        raise InputError(
            expected="--fov between 0 and 180 degrees",
            received=f"{fov_deg}",
            remedy="give the horizontal angle",
        )
    if focal_px is not None and fov_deg is not None:
        raise InputError(expected="--focal-px or --fov", received="both", remedy="give one of them")
    own = None if landmarks is None else read_landmarks(landmarks)
    given = _Given(None if mask is None else Path(mask), own, focal_px, fov_deg)
    if path.is_dir() or path.suffix.lower() in (".json", ".npz"):
        return _from_scene(path, given)
    return _from_photo(path, given)


def _read_description(path: Path, *, only_first: bool) -> SceneFile:
    if path.is_dir():
        found = [path / name for name in ("transforms.json", "cameras.npz") if (path / name).is_file()]
        if not found:
            raise InputError(
                expected=f"transforms.json or cameras.npz in {path}",
                received="neither" if path.exists() else "no such folder",
                remedy="give the scene's own folder, or a photo",
            )
        path = found[0]
    if path.suffix.lower() == ".npz":
        # The format has no place for the head: an optional landmarks.json beside it holds what transforms.json would.
        beside = path.parent / "landmarks.json"
        landmarks = landmarks_from_json(read_json(beside), beside.name) if beside.is_file() else Landmarks()
        return SceneFile(read_cameras_npz(path, only_first=only_first), landmarks=landmarks)
    return read_transforms(path, only_first=only_first)


def _from_scene(path: Path, given: _Given) -> Portrait:
    scene = _read_description(path, only_first=True)
    frame = scene.frames[0]
    if given.focal_px is not None or given.fov_deg is not None:
        frame = replace(frame, camera=_with_focal(frame.camera, given))
    image, mask = read_frame(replace(frame, mask_path=given.mask or frame.mask_path))
    said = list(image.warnings)
    if frame.distortion:
        said.append("lens distortion undone by resampling the picture")
    if mask is None:
        beside = frame.image_path.parent / "mask.png"
        if image.alpha is None and beside.is_file():
            _, mask = read_frame(replace(frame, mask_path=beside))
    mask = _mask_or_alpha(mask, image)
    landmarks = given.landmarks or scene.landmarks
    pixels = {}
    metres = 1.0 if scene.metres_per_unit is None else scene.metres_per_unit
    camera = frame.camera
    if scene.canonical_from_world is not None and given.landmarks is None:
        canonical_from_world = scene.canonical_from_world
    elif landmarks.points_world:
        canonical_from_world = canonical_from_landmarks(landmarks.points_world)
        said.append("head placed by its 3D landmarks")
    elif landmarks.pixels:
        pixels = landmarks.pixels
        if frame.distortion:
            pixels = {n: frame.distortion.ideal(u, camera.intrinsics) for n, u in pixels.items()}
        canonical_from_camera = np.linalg.inv(camera_from_canonical(pixels, camera.intrinsics))
        unit = np.diag([metres, metres, metres, 1.0])
        canonical_from_world = canonical_from_camera @ unit @ camera.camera_from_world
        said.append("head placed by its 2D landmarks, at the mean head's size; expect some degrees and 2 % of distance")
    else:
        raise InputError(
            expected="canonical_from_world, landmarks_m or landmarks_2d in the scene",
            received="none of them",
            remedy="add one to transforms.json, or give --landmarks with the nine landmarks in 2D or 3D",
        )
    scale = similarity_scale(canonical_from_world)
    if scene.metres_per_unit is None and not PLAUSIBLE_SCALE[0] <= scale <= PLAUSIBLE_SCALE[1] and scale > 0:
        metres = scale
        said.append(f"the scene does not say metres_per_unit; {scale:.4g} assumed, which makes the head of mean size")
    name = (path if path.is_dir() else path.parent).resolve().name
    return _portrait(image, mask, camera, canonical_from_world, name, metres, said, pixels)


def _from_photo(path: Path, given: _Given) -> Portrait:
    width, height = image_size(path)
    image = read_image(path)
    said = list(image.warnings)
    mask = None if given.mask is None else _fitting_mask(read_mask(given.mask), image, given.mask)
    mask = _mask_or_alpha(mask, image)
    if given.landmarks is None or not given.landmarks.pixels:
        raise InputError(
            expected="2D landmarks for a bare photo",
            received="none" if given.landmarks is None else "3D landmarks only",
            remedy="give --landmarks FILE with landmarks_2d (nine names, or 68 rows)",
        )
    film = ASSUMED_FOCAL_35MM if image.focal_35mm is None else image.focal_35mm
    focal = film / FILM_DIAGONAL_MM * math.hypot(width, height)
    if given.focal_px is None and given.fov_deg is None:
        source = "from EXIF, right if the photo is not cropped" if image.focal_35mm else "a portrait lens assumed"
        said.append(
            f"focal length {focal:.0f} px ({film:.0f} mm equivalent, {source}); --focal-px or --fov overrides it"
        )
    intrinsics = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    camera = _with_focal(Camera(intrinsics, np.eye(4), width, height), given)
    pixels = given.landmarks.pixels
    pose = np.linalg.inv(camera_from_canonical(pixels, camera.intrinsics))
    said.append("head placed by its 2D landmarks, at the mean head's size; expect some degrees and 2 % of distance")
    return _portrait(image, mask, replace(camera, world_from_camera=pose), np.eye(4), path.stem, 1.0, said, pixels)


def _with_focal(camera: Camera, given: _Given) -> Camera:
    """The camera with the user's focal length, if there is one; its pixel aspect and principal point stay."""
    focal = given.focal_px
    if given.fov_deg is not None:
        focal = 0.5 * camera.width / math.tan(math.radians(0.5 * given.fov_deg))
    if focal is None:
        return camera
    k = camera.intrinsics.copy()
    k[:2, :2] *= focal / k[0, 0]
    return replace(camera, intrinsics=k)


def _fitting_mask(mask: np.ndarray, image: ImageFile, path: Path) -> np.ndarray:
    """The mask, turned as its photo was if it was drawn on the stored pixels of a photo that EXIF turns."""
    size = image.linear.shape[:2]
    if mask.shape != size and mask.shape == size[::-1] and image.orientation >= 5:
        mask = orient(mask, image.orientation)
    if mask.shape != size:
        raise InputError(
            expected=f"a mask of the picture's size {size[1]}x{size[0]}",
            received=f"{mask.shape[1]}x{mask.shape[0]} in {path}",
            remedy="bring the mask to the picture's size",
        )
    return mask


def _mask_or_alpha(mask: np.ndarray | None, image: ImageFile) -> np.ndarray:
    if mask is not None:
        return mask
    if image.alpha is not None:
        return image.alpha > 0.5
    raise InputError(
        expected="a mask of the head",
        received="none, and a picture without transparency",
        remedy="give --mask FILE (white on the head), or name mask_path in the scene",
    )


def _portrait(
    image: ImageFile,
    mask: np.ndarray,
    camera: Camera,
    canonical_from_world: np.ndarray,
    name: str,
    metres_per_unit: float,
    said: list[str],
    landmarks_px: Mapping[str, np.ndarray],
) -> Portrait:
    negative = int((image.linear < 0).any(-1).sum())
    if negative:
        said.append(f"{negative} pixel(s) with negative radiance set to 0")
    if mask.mean() > FULL_MASK:
        said.append("the mask covers the whole picture: the background will be taken for the head")
    # An EXR goes on above white, where pictures are compared no more: it says "at least white", as a clipped file does.
    saturated = image.saturated | (image.linear >= 1.0).any(-1)
    clipped = float(saturated[mask].mean()) if mask.any() else 0.0
    if clipped > 0.01:
        said.append(f"{100 * clipped:.0f} % of the head is clipped: as bright as white, or brighter")
    return Portrait(
        image_linear=np.maximum(image.linear, 0.0),  # NaN passes on to Portrait, which says where it is
        mask=mask,
        camera=camera,
        canonical_from_world=canonical_from_world,
        saturated=saturated,
        name=name,
        metres_per_unit=metres_per_unit,
        landmarks_px=landmarks_px,
        warnings=tuple(said),
    )
