"""Write an avatar as GLB: geometry in the scene's own world, material with F0 in KHR_materials_specular.

glTF's texture origin is the top left, the atlas's the bottom left: v is flipped here and nowhere else.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import sira_assets
from sira_assets.asset.avatar import Avatar
from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.glb_file import GlbFile
from sira_assets.asset.gltf_material import FLAT_NORMAL, gltf_material
from sira_assets.asset.quantise import quantise_positions, quantise_signed, quantise_uv
from sira_assets.asset.split import SplitVertices, split_at_seams
from sira_assets.atomic import write_bytes
from sira_assets.scene.camera import Camera
from sira_assets.texture.tangents import tangents


def write_glb(avatar: Avatar, path: str | Path, config: ExportConfig = ExportConfig()) -> None:
    """Write `avatar` to `path`, whole or not at all; the same avatar gives the same bytes.

    Positions are the scene's world coordinates, so that the file overlays the scene's truth; the unit and the
    similarity into the canonical head frame stand in the scene's `extras`, with the light.
    """
    write_bytes(path, glb_bytes(avatar, config))


def glb_bytes(avatar: Avatar, config: ExportConfig = ExportConfig()) -> bytes:
    """The GLB file of `write_glb`, in memory (glTF 2.0; KHR_materials_specular, KHR_mesh_quantization if asked)."""
    file = GlbFile()
    material = gltf_material(avatar, file, config)
    split = split_at_seams(avatar.mesh.faces, avatar.atlas.faces_uv)
    vertices = _vertices(avatar, split, with_tangents="normalTexture" in material)
    node: dict = {"name": avatar.name, "mesh": 0}
    if config.quantise:
        positions = quantise_positions(vertices.position)
        node |= {"scale": [positions.scale] * 3, "translation": positions.translation.tolist()}
        attributes = _quantised(vertices, positions.codes, file)
    else:
        attributes = _floats(vertices, file)
    indices = file.add_indices(split.faces, len(vertices.position))
    primitive = {"attributes": attributes, "indices": indices, "material": 0, "mode": 4}
    required = {"extensionsRequired": ["KHR_mesh_quantization"]} if config.quantise else {}
    document = {
        "asset": {"version": "2.0", "generator": f"sira_assets {sira_assets.__version__}"},
        "extensionsUsed": ["KHR_materials_specular", *required.get("extensionsRequired", [])],
        **required,
        "scene": 0,
        "scenes": [{"name": avatar.name, "nodes": [0], "extras": avatar_extras(avatar)}],
        "nodes": [node],
        "meshes": [{"name": f"{avatar.name}_mesh", "primitives": [primitive]}],
        "materials": [material],
    }
    return file.to_bytes(document)


@dataclass(frozen=True)
class _Vertices:
    """Split at the seams, float64; tangents None where there is no normal map; uv with glTF's origin."""

    position: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray | None
    uv: np.ndarray


def _vertices(avatar: Avatar, split: SplitVertices, *, with_tangents: bool) -> _Vertices:
    uv = avatar.atlas.uv[split.uv_index]
    frame = None
    if with_tangents:
        frame = np.array(tangents(avatar.mesh, avatar.atlas), np.float64)[split.uv_index]
        frame[:, :3] = _unit(frame[:, :3], np.array([1.0, 0.0, 0.0]))
        frame[:, 3] = np.where(frame[:, 3] < 0, -1.0, 1.0)
    return _Vertices(
        avatar.mesh.vertices[split.position_index],
        _unit(avatar.mesh.normals[split.position_index], FLAT_NORMAL),
        frame,
        np.stack([uv[:, 0], 1.0 - uv[:, 1]], 1),
    )


def _floats(vertices: _Vertices, file: GlbFile) -> dict[str, int]:
    attributes = {"POSITION": file.add_vectors(vertices.position, bounds=True)}
    attributes["NORMAL"] = file.add_vectors(vertices.normal)
    if vertices.tangent is not None:
        attributes["TANGENT"] = file.add_vectors(vertices.tangent)
    attributes["TEXCOORD_0"] = file.add_vectors(vertices.uv)
    return attributes


def _quantised(vertices: _Vertices, positions: np.ndarray, file: GlbFile) -> dict[str, int]:
    """Normals keep 16 bits, since highlights show steps of 0.4 degrees; tangents only turn the normal map's detail."""
    attributes = {"POSITION": file.add_codes(positions, bounds=True)}
    attributes["NORMAL"] = file.add_codes(quantise_signed(vertices.normal, np.int16))
    if vertices.tangent is not None:
        attributes["TANGENT"] = file.add_codes(quantise_signed(vertices.tangent, np.int8))
    attributes["TEXCOORD_0"] = file.add_codes(quantise_uv(vertices.uv))
    return attributes


def avatar_extras(avatar: Avatar) -> dict:
    """What glTF has no place for: unit, canonical frame, light, and the portrait's camera with its principal point."""
    camera = {} if avatar.camera is None else {"camera": _camera(avatar.camera)}
    return {
        "units": "scene world units; metres_per_unit gives their length",
        "metres_per_unit": float(avatar.metres_per_unit),
        "canonical_from_world": np.asarray(avatar.canonical_from_world, np.float64).tolist(),
        "light": {
            "frame": "scene world",
            "model": "sum amplitude exp(sharpness (w . axis - 1))",
            **avatar.light.to_dict(),
        },
        **camera,
    }


def _camera(camera: Camera) -> dict:
    return {
        "frame": "scene world",
        "model": "pinhole, OpenCV axes (x right, y down, z forward), pixel centres at +0.5",
        "intrinsics": camera.intrinsics.tolist(),
        "world_from_camera": camera.world_from_camera.tolist(),
        "width": int(camera.width),
        "height": int(camera.height),
    }


def _unit(vectors: np.ndarray, fallback: np.ndarray) -> np.ndarray:
    """Unit vectors (N, k) in float64; `fallback` where there is no length to divide by."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), fallback)
