"""The parts of a scan, each with what colours it.

Notation: U vertices, F faces of a part. Its albedo is picture times tint; what they are made of, as far as it is there:

  glTF    picture: the base colour texture; tint: COLOR_0 times baseColorFactor, both linear
  others  the first of the picture, vertex colours, face colours and the material's own; all sRGB

A picture of the user's own stands in place of all these where there are texture coordinates. A white material is how
files say that they know no colour: a neutral grey stands for it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_synth.scan_file import is_gltf, load_parts, picture_of, uv_of
from data_synth.scan_material import NEUTRAL_ALBEDO
from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb
from sira_assets.scene.image import to_srgb


@dataclass(frozen=True)
class Picture:
    """pixels (H, W, 3) uint8 sRGB; notes on what was converted."""

    pixels: np.ndarray
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ScanPart:
    """vertices (U, 3), faces (F, 3), uv (U, 2), tint (U, 3) linear, picture (H, W, 3) uint8 sRGB or None; notes."""

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    tint: np.ndarray
    picture: np.ndarray | None
    notes: tuple[str, ...]


def read_scan_parts(path: Path, texture: Path | None = None) -> list[ScanPart]:
    """Read any mesh that trimesh reads.

    Parameters
    ----------
    texture : picture for all parts with texture coordinates; None takes what the file names

    Raises
    ------
    InputError : a file is missing or unreadable, there are no triangles, or no texture coordinates for `texture`.
    """
    own = None if texture is None else _read_picture(texture)
    parts = load_parts(path, pictured=own is not None)
    if own is not None and all(uv_of(part) is None for part in parts):
        raise InputError(
            expected=f"texture coordinates in {path}",
            received="none",
            remedy="leave out the texture, or unwrap the mesh",
        )
    return [_coloured(part, own, gltf=is_gltf(path)) for part in parts]


def _read_picture(path: Path) -> Picture:
    from PIL import Image, UnidentifiedImageError

    if not path.is_file():
        raise InputError(expected=f"a picture {path}", received="no such file", remedy="check the path")
    try:
        with Image.open(path) as image:
            return _picture(image, path.name)
    except (UnidentifiedImageError, OSError, Image.DecompressionBombError) as error:
        raise InputError(
            expected=f"a picture {path}", received=str(error)[:120], remedy="export as PNG or JPEG"
        ) from None


def _picture(image, name: str) -> Picture:
    image, notes = to_srgb(image, name)
    return Picture(np.asarray(image.convert("RGB")), notes)


def _coloured(part, own: Picture | None, *, gltf: bool) -> ScanPart:
    """A part of trimesh's as one of ours."""
    x, f = np.asarray(part.vertices, np.float64), np.asarray(part.faces, np.int64)
    uv, image = uv_of(part), picture_of(part)
    if uv is not None and (own is not None or image is not None):
        picture = own or _picture(image, "the texture")
        tint = _tint_gltf(part) if gltf and own is None else np.ones(x.shape)
        return ScanPart(x, f, uv, tint, picture.pixels, picture.notes)
    return _without_picture(part, x, f, gltf=gltf)


def _without_picture(part, x: np.ndarray, f: np.ndarray, *, gltf: bool) -> ScanPart:
    of_vertices, of_faces, notes = _stored(part, "vertex"), _stored(part, "face"), ()
    if gltf:
        tint = _tint_gltf(part)
    elif of_vertices is not None:
        tint = linear_from_srgb(of_vertices)
    elif of_faces is not None:
        tint = linear_from_srgb(np.repeat(of_faces, 3, axis=0))
        x, f = x[f].reshape(-1, 3), np.arange(f.size).reshape(-1, 3)
    else:
        tint = np.tile(linear_from_srgb(_of_material(part)), (len(x), 1))
    if of_vertices is None and of_faces is None:
        cut, white = uv_of(part) is not None, bool((tint == 1.0).all())
        what = "texture coordinates but no picture (give one with --scan-texture)" if cut else "no colours"
        notes = (f"{what}: " + (f"neutral grey {NEUTRAL_ALBEDO[0]:g}" if white else "its material's one colour"),)
        tint = np.broadcast_to(NEUTRAL_ALBEDO, x.shape) if white else tint
    return ScanPart(x, f, np.zeros((len(x), 2)), tint, None, notes)


def _tint_gltf(part) -> np.ndarray:
    """(U, 3) COLOR_0 times baseColorFactor."""
    of_vertices = _stored(part, "vertex")
    return np.tile(_of_material(part), (len(part.vertices), 1)) * (1.0 if of_vertices is None else of_vertices)


def _stored(part, kind: str) -> np.ndarray | None:
    """Colours (U or F, 3) of each "vertex" or "face" as the file has them, in 0 to 1; None where it has none."""
    from trimesh.visual.color import to_float

    colours = getattr(part, f"{kind}_attributes").get("color")
    if part.visual.kind == kind:
        colours = getattr(part.visual, f"{kind}_colors")
    if colours is None or len(colours) != len(part.vertices if kind == "vertex" else part.faces):
        return None
    return np.clip(to_float(colours)[:, :3], 0.0, 1.0)


def _of_material(part) -> np.ndarray:
    """(3,) a material's one colour as the file has it (baseColorFactor, Kd), in 0 to 1; white where it has none."""
    material = getattr(part.visual, "material", None)
    colour = getattr(material, "baseColorFactor", None)
    if colour is None and "kd" in getattr(material, "kwargs", {}):
        colour = material.diffuse
    return np.ones(3) if colour is None else np.asarray(colour[:3]) / 255.0
