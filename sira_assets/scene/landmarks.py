"""Face landmarks on disk.

Names are those of `canonical.CANONICAL_LANDMARKS_M`; right and left are the subject's. A 2D landmark is a position in
the upright picture, pixels, x right, y down, pixel centres at +0.5. A 3D landmark is a point in the scene's world.

Forms that are read (JSON):
  {"landmarks_2d": {"nose_tip": [x, y], ...}}      nine names; or 68 rows [x, y] in iBUG's order
  {"landmarks_m": {"nose_tip": [x, y, z], ...}}    or "landmarks_3d"; 68 rows likewise
  {"nose_tip": {"pixel": [x, y], "xyz_m": [x, y, z]}, ...}
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, IBUG68_OF_CANONICAL

MAX_JSON_BYTES = 64 << 20


@dataclass(frozen=True)
class Landmarks:
    """Landmarks of one head, by canonical name; either part may be empty.

    Parameters
    ----------
    pixels : name to (2,) float64 position in the upright picture
    points_world : name to (3,) float64 point in the scene's world
    """

    pixels: Mapping[str, np.ndarray] = field(default_factory=dict)
    points_world: Mapping[str, np.ndarray] = field(default_factory=dict)


def read_json(path: Path) -> object:
    """Parse a JSON file of moderate size.

    Raises
    ------
    InputError : missing, larger than 64 MiB, or not JSON; says the line.
    """
    if not path.is_file():
        raise InputError(expected=f"a file {path}", received="no such file", remedy="check the path")
    if path.stat().st_size > MAX_JSON_BYTES:
        raise InputError(
            expected=f"a JSON file of at most {MAX_JSON_BYTES >> 20} MiB at {path}",
            received=f"{path.stat().st_size >> 20} MiB",
            remedy="check that it is the right file",
        )
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        where = f"line {error.lineno}: {error.msg}" if isinstance(error, json.JSONDecodeError) else "no JSON text"
        raise InputError(expected=f"JSON in {path}", received=where, remedy="mend the file") from None


def _named(data: object, dimension: int, where: str) -> dict[str, np.ndarray]:
    """Canonical landmarks out of a mapping by name or of 68 rows."""
    refused = InputError(
        expected=f"landmarks in {where} as {{name: {dimension} numbers}} with the canonical names, or 68 rows",
        received=f"{type(data).__name__} {str(data)[:60]}",
        remedy=f"use the names {', '.join(CANONICAL_LANDMARKS_M)}",
    )
    if isinstance(data, list):
        if len(data) != 68:
            raise refused
        data = {name: data[row] for name, row in IBUG68_OF_CANONICAL.items()}
    if not isinstance(data, dict):
        raise refused
    try:
        out = {name: np.array(data[name], np.float64) for name in CANONICAL_LANDMARKS_M if data.get(name) is not None}
    except (TypeError, ValueError):
        raise refused from None
    if not out or any(point.shape != (dimension,) or not np.isfinite(point).all() for point in out.values()):
        raise refused
    return out


def landmarks_from_json(data: object, where: str) -> Landmarks:
    """Landmarks from any of the forms above; empty where `data` holds none of their keys.

    Parameters
    ----------
    data : parsed JSON
    where : the file's name, for messages

    Raises
    ------
    InputError : the keys are there, their values are not landmarks.
    """
    if isinstance(data, list):
        data = {"landmarks_2d": data}
    if not isinstance(data, dict):
        return Landmarks()
    entries = {name: data[name] for name in CANONICAL_LANDMARKS_M if isinstance(data.get(name), dict)}
    pixels = data.get("landmarks_2d", {n: e["pixel"] for n, e in entries.items() if "pixel" in e})
    points = data.get("landmarks_m", data.get("landmarks_3d"))
    points = {n: e["xyz_m"] for n, e in entries.items() if "xyz_m" in e} if points is None else points
    return Landmarks(_named(pixels, 2, where) if pixels else {}, _named(points, 3, where) if points else {})


def read_landmarks(path: str | Path) -> Landmarks:
    """Read a landmarks file.

    Raises
    ------
    InputError : missing, not JSON, or without landmarks.
    """
    path = Path(path)
    landmarks = landmarks_from_json(read_json(path), path.name)
    if not landmarks.pixels and not landmarks.points_world:
        raise InputError(
            expected=f"landmarks_2d or landmarks_m in {path}",
            received="neither",
            remedy='write {"landmarks_2d": {"nose_tip": [x, y], ...}} with the nine canonical names',
        )
    return landmarks
