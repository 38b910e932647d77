"""One posed view of a scene on disk: where its files are, not yet their pixels."""

from dataclasses import dataclass, field
from pathlib import Path

from sira_assets.errors import InputError
from sira_assets.scene.camera import Camera
from sira_assets.scene.distortion import Distortion

IMAGE_SUFFIXES = (".png", ".exr", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG", ".EXR")


@dataclass(frozen=True)
class Frame:
    """One view.

    Parameters
    ----------
    camera : pose and intrinsics in the scene's world
    image_path : the picture
    mask_path : its mask, or None where the scene names none
    distortion : what its lens does beside the pinhole
    """

    camera: Camera
    image_path: Path
    mask_path: Path | None = None
    distortion: Distortion = field(default_factory=Distortion)


def path_inside(folder: Path, name: str) -> Path:
    """The file that a scene names, which must lie in the scene's folder and exist; images may lack their suffix.

    Raises
    ------
    InputError : it leads out of the folder (through "..", an absolute path or a link), or is missing.
    """
    root = folder.resolve()
    if not isinstance(name, str) or not name or "\0" in name:
        raise InputError(expected=f"a file name in {folder}", received=repr(name)[:80], remedy="mend the scene file")
    path = (root / name).resolve()
    if not path.is_relative_to(root):
        raise InputError(
            expected=f"files inside {folder}",
            received=f"{name}, which leads out of it",
            remedy="copy the file into the scene's folder and name it there",
        )
    if path.is_file():
        return path
    for suffix in IMAGE_SUFFIXES:
        candidate = path.with_name(path.name + suffix)
        if candidate.is_file() and candidate.resolve().is_relative_to(root):
            return candidate
    raise InputError(
        expected=f"the file {name} in {folder}", received="no such file", remedy="check file_path and mask_path"
    )
