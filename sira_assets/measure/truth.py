"""Reading what is measured: a predicted mesh, and a true one with its landmarks, frame and camera.

A mesh comes as a file (anything trimesh reads: PLY, OBJ, GLB, STL, OFF) or as a folder: an avatar's (`avatar.glb`), a
scene's (`gt/mesh.ply`) or a head's (`mesh.ply`). Everything returned is in metres.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, canonical_from_landmarks
from sira_assets.scene.landmarks import landmarks_from_json, read_json
from sira_assets.scene.transforms_json import read_transforms

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
    """3D landmarks by canonical name, metres.

    Read are the forms of `scene.landmarks` and `{name: [x, y, z]}`, in the mesh's own unit, also under the keys "gt"
    and "pred", of which `of` picks one; without these keys the file speaks of the truth.

    Raises
    ------
    InputError : no such file, not JSON, or not a landmark file.
    """
    data = read_json(Path(path))
    if isinstance(data, dict) and ("gt" in data or "pred" in data):
        data = data.get(of, {})
    elif of != "gt":
        return {}
    if isinstance(data, dict) and any(isinstance(data.get(name), list) for name in CANONICAL_LANDMARKS_M):
        data = {"landmarks_m": data}
    points = landmarks_from_json(data, Path(path).name).points_world
    return {name: point * metres_per_unit for name, point in points.items()}


def read_truth(
    path: str | Path,
    *,
    metres_per_unit: float | None = None,
    assumed_unit: float = 1.0,
    landmarks: str | Path | None = None,
) -> Truth:
    """Read the truth from a scene folder, a head folder or a mesh file.

    Parameters
    ----------
    metres_per_unit : overrides what a scene's transforms.json says
    assumed_unit : metres per unit where neither says it: what a portrait's reader found, or an export's extras say
    landmarks : a file to use in place of the `landmarks.json` beside the mesh
    """
    path = Path(path)
    file = mesh_file(path)
    described = path.is_dir() and (path / "transforms.json").is_file()
    scene = read_transforms(path / "transforms.json", only_first=True) if described else None
    unit = metres_per_unit or (scene.metres_per_unit if scene is not None else None) or assumed_unit
    source = Path(landmarks) if landmarks is not None else landmarks_beside(path)
    points = read_landmarks(source, metres_per_unit=unit) if source else {}
    if landmarks is not None and not points:
        raise InputError(
            expected=f"3D landmarks of the truth in {source}",
            received="none",
            remedy='give {"nose_tip": [x, y, z], ...}',
        )
    if scene is not None and not points:
        points = {name: point * unit for name, point in scene.landmarks.points_world.items()}
    frame = None
    if scene is not None and scene.canonical_from_world is not None:
        # The file's matrix takes the scene's unit; this one takes metres.
        frame = scene.canonical_from_world @ np.diag([1 / unit, 1 / unit, 1 / unit, 1.0])
    elif len(points) >= 3:
        frame = canonical_from_landmarks(points)
    camera = None if scene is None else camera_in_metres(scene.frames[0].camera, unit)
    return Truth(read_mesh(file, metres_per_unit=unit), points, frame, camera, unit)


def camera_in_metres(camera: Camera, metres_per_unit: float) -> Camera:
    """The same camera in a world whose unit is the metre."""
    pose = camera.world_from_camera.copy()
    pose[:3, 3] *= metres_per_unit
    return replace(camera, world_from_camera=pose)


def landmarks_beside(path: str | Path) -> Path | None:
    """The `landmarks.json` in the folder of the mesh that `path` means, or None."""
    file = mesh_file(path).parent / "landmarks.json"
    return file if file.is_file() else None
