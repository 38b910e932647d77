"""Reading what is measured: a predicted mesh, and a true one with its landmarks, frame and camera.

A mesh comes as a file (anything trimesh reads: PLY, OBJ, GLB, STL, OFF) or as a folder: an avatar's (`avatar.glb`), a
scene's (`gt/mesh.ply`) or a head's (`mesh.ply`). Everything returned is in metres.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, canonical_from_landmarks

METRES_PER = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "um": 1e-6, "in": 0.0254, "ft": 0.3048}


@dataclass(frozen=True)
class Truth:
    """The true surface and what is known about it, metres, in the scene's own axes.

    Parameters
    ----------
    mesh : the whole true mesh, inner surfaces included
    landmarks : name -> (3,) position; may be empty
    canonical_from_world : (4, 4) similarity for metres, or None where neither file nor landmarks tell
    camera : the input camera in metres, or None
    metres_per_unit : of the files; already applied
    """

    mesh: TriangleMesh
    landmarks: Mapping[str, np.ndarray] = field(default_factory=dict)
    canonical_from_world: np.ndarray | None = None
    camera: Camera | None = None
    metres_per_unit: float = 1.0


def mesh_file(path: str | Path) -> Path:
    """The mesh file that `path` means: itself, or the one a folder holds.

    Raises
    ------
    InputError : nothing there.
    """
    path = Path(path)
    if path.is_dir():
        for name in ("avatar.glb", "gt/mesh.ply", "mesh.ply"):
            if (path / name).is_file():
                return path / name
        raise InputError(
            expected=f"avatar.glb, gt/mesh.ply or mesh.ply in {path}",
            received="none of them",
            remedy="name a mesh file",
        )
    if not path.is_file():
        raise InputError(expected=f"a mesh at {path}", received="no such file", remedy="check the path")
    return path


def read_mesh(path: str | Path, *, metres_per_unit: float = 1.0) -> TriangleMesh:
    """Read one mesh, all its parts in their world pose, in metres.

    Raises
    ------
    InputError : no such file, a format trimesh cannot read, a broken file, or no triangles.
    """
    import trimesh

    path = mesh_file(path)
    try:
        loaded = trimesh.load(path, process=False)
        mesh = loaded.to_geometry() if isinstance(loaded, trimesh.Scene) else loaded
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except MemoryError:
        raise
    except Exception as error:  # each of trimesh's readers fails in its own way on a broken file
        raise InputError(
            expected=f"a triangle mesh in {path.name}",
            received=f"{type(error).__name__}: {error}",
            remedy="bring PLY, OBJ, GLB, STL or OFF",
        ) from error
    if not len(faces):
        raise InputError(
            expected=f"a triangle mesh in {path.name}", received="no triangles", remedy="a point cloud has no surface"
        )
    return TriangleMesh(vertices * metres_per_unit, faces)


def read_landmarks(path: str | Path, *, metres_per_unit: float = 1.0, of: str = "gt") -> dict[str, np.ndarray]:
    """Landmarks by name, metres.

    Read are `{name: {"xyz_m": [x, y, z]}}`, `{"landmarks_m": {name: [x, y, z]}}` (metres), `{name: [x, y, z]}` (the
    mesh's own unit), and any of these under "gt" and "pred", of which `of` picks one; without these keys the file
    speaks of the truth.

    Raises
    ------
    InputError : no such file, not JSON, or not a landmark file.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(expected=f"landmarks at {path}", received="no such file", remedy="check the path")
    try:
        data = json.loads(path.read_text())
        if "gt" in data or "pred" in data:
            data = data.get(of, {})
        elif of != "gt":
            return {}
        named_metres = data.get("landmarks_m")
        out = {}
        for name, value in (named_metres if named_metres is not None else data).items():
            metric = named_metres is not None or isinstance(value, dict)
            xyz = np.array(value["xyz_m"] if isinstance(value, dict) else value, np.float64)
            if xyz.shape != (3,) or not np.isfinite(xyz).all():
                raise ValueError(f"{name} is {value}")
            out[name] = xyz * (1.0 if metric else metres_per_unit)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            expected=f'landmarks in {path.name} as {{"nose_tip": [x, y, z], ...}}',
            received=f"{type(error).__name__}: {error}",
            remedy="see the landmarks.json of any scene",
        ) from error
    return out


def read_truth(path: str | Path, *, metres_per_unit: float | None = None, landmarks: str | Path | None = None) -> Truth:
    """Read the truth from a scene folder, a head folder or a mesh file.

    Parameters
    ----------
    metres_per_unit : overrides what a scene's transforms.json says (default there: 1)
    landmarks : a file to use in place of the `landmarks.json` beside the mesh
    """
    path = Path(path)
    file = mesh_file(path)
    transforms = path / "transforms.json" if path.is_dir() else None
    header = _header(transforms)
    unit = metres_per_unit if metres_per_unit is not None else float(header.get("metres_per_unit", 1.0))
    beside = file.parent / "landmarks.json"
    source = Path(landmarks) if landmarks is not None else beside if beside.is_file() else None
    points = read_landmarks(source, metres_per_unit=unit) if source else {}
    frame = None
    if "canonical_from_world" in header:
        # The file's matrix takes the scene's unit; this one takes metres.
        frame = np.array(header["canonical_from_world"], np.float64) @ np.diag([1 / unit, 1 / unit, 1 / unit, 1.0])
    elif len(CANONICAL_LANDMARKS_M.keys() & points.keys()) >= 3:
        frame = canonical_from_landmarks(points)
    camera = _first_camera(path, unit) if "frames" in header else None
    return Truth(read_mesh(file, metres_per_unit=unit), points, frame, camera, unit)


def _header(transforms: Path | None) -> dict:
    if transforms is None or not transforms.is_file():
        return {}
    try:
        return json.loads(transforms.read_text())
    except ValueError as error:
        raise InputError(
            expected=f"JSON in {transforms}", received=str(error), remedy="repair or leave out transforms.json"
        ) from error


def _first_camera(folder: Path, unit: float) -> Camera:
    from sira_assets.scene.read_scene import read_frames

    camera = read_frames(folder)[0].camera
    pose = camera.world_from_camera.copy()
    pose[:3, 3] *= unit
    return Camera(camera.intrinsics, pose, camera.width, camera.height)
