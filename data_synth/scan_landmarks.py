"""Landmarks of a scan, in the scan's own unit and frame.

Files that are read:
  JSON   {"landmarks_m": {"nose_tip": [x, y, z], ...}} by the nine canonical names, or 68 rows in iBUG's order; the 68
         may also stand beside the nine as "lm68_m". Numbers are in the scan's unit whatever the key says.
  .pp    MeshLab's picked points: named after the nine, or nine or 68 of them picked in order.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, IBUG68_OF_CANONICAL
from sira_assets.scene.landmarks import MAX_JSON_BYTES, landmarks_from_json, read_json

KEYS_OF_68 = ("lm68_m", "multipie68_m", "landmarks_m", "landmarks_3d")  # Multi-PIE's 68 are iBUG's
LEAST = 5  # of the nine; fewer leave the pose to chance
MOST_OFF_SURFACE_M = 0.012  # a picked landmark lies on the scan; a nose tip of another unit does not


@dataclass(frozen=True)
class ScanLandmarks:
    """By canonical name, at least five of the nine -> (3,); and all 68 (68, 3), or None."""

    nine: Mapping[str, np.ndarray]
    all68: np.ndarray | None

    def moved(self, transform) -> "ScanLandmarks":
        """The landmarks under a function of points (N, 3)."""
        nine = {name: transform(np.asarray(p)[None])[0] for name, p in self.nine.items()}
        return ScanLandmarks(nine, None if self.all68 is None else transform(self.all68))


def read_scan_landmarks(path: str | Path) -> ScanLandmarks:
    """Read a landmarks file.

    Raises
    ------
    InputError : missing, of no form above, or fewer than five of the nine landmarks.
    """
    path = Path(path)
    nine, all68 = _from_picked_points(path) if path.suffix.lower() == ".pp" else _from_json(path)
    if all68 is not None:
        nine = {name: all68[row] for name, row in IBUG68_OF_CANONICAL.items()} | nine
    if len(nine) < LEAST:
        raise InputError(
            expected=f"at least {LEAST} of the nine canonical landmarks in {path}",
            received=f"{len(nine)}",
            remedy=f"pick more of {', '.join(CANONICAL_LANDMARKS_M)}",
        )
    return ScanLandmarks(nine, all68)


def _from_json(path: Path) -> tuple[dict, np.ndarray | None]:
    data = read_json(path)
    nine = dict(landmarks_from_json(data, path.name).points_world) if isinstance(data, dict) else {}
    rows = data if isinstance(data, list) else next((data[k] for k in KEYS_OF_68 if _is_list(data, k)), None)
    return nine, None if rows is None else _checked68(rows, path)


def _is_list(data: object, key: str) -> bool:
    return isinstance(data, dict) and isinstance(data.get(key), list)


def _checked68(rows: object, path: Path) -> np.ndarray:
    try:
        out = np.array(rows, np.float64)
    except (TypeError, ValueError):
        out = np.zeros(0)
    if out.shape != (68, 3) or not np.isfinite(out).all():
        raise InputError(
            expected=f"68 rows of three finite numbers in {path}",
            received=f"an array of shape {out.shape}" if out.size else "something else",
            remedy="give iBUG's 68 landmarks, or the nine by name",
        )
    return out


def _from_picked_points(path: Path) -> tuple[dict, np.ndarray | None]:
    if not path.is_file() or path.stat().st_size > MAX_JSON_BYTES:
        raise InputError(expected=f"picked points in {path}", received="no such file", remedy="check the path")
    try:
        points = [p.attrib for p in ElementTree.parse(path).iter("point") if p.get("active", "1") != "0"]
        position = np.array([[float(p[axis]) for axis in "xyz"] for p in points], np.float64).reshape(-1, 3)
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise InputError(
            expected=f"MeshLab's picked points in {path}", received=str(error), remedy="save them again"
        ) from None
    names = [p.get("name", "") for p in points]
    if set(names) & set(CANONICAL_LANDMARKS_M):
        return {n: x for n, x in zip(names, position, strict=True) if n in CANONICAL_LANDMARKS_M}, None
    if len(points) == 68:
        return {}, _checked68(position, path)
    if len(points) == len(CANONICAL_LANDMARKS_M):
        return dict(zip(CANONICAL_LANDMARKS_M, position, strict=True)), None
    raise InputError(
        expected=f"points in {path} named after the canonical nine, or nine or 68 of them in order",
        received=f"{len(points)} points named {', '.join(names[:4])}",
        remedy=f"pick, in this order: {', '.join(CANONICAL_LANDMARKS_M)}",
    )


def check_on_surface(points: np.ndarray, mesh: TriangleMesh, path: str | Path) -> None:
    """Refuse landmarks (N, 3) that are not their mesh's, both in canonical metres; `path` is the mesh's file.

    Raises
    ------
    InputError : half of them lie farther than `MOST_OFF_SURFACE_M` from the surface.
    """
    off = float(np.median(Raycaster(mesh).closest(points).distance))
    if not off <= MOST_OFF_SURFACE_M:
        raise InputError(
            expected=f"landmarks on the surface of {path}",
            received=f"points {1e3 * off:.0f} mm off (median)",
            remedy="check that both have one frame and unit",
        )
