"""Write an avatar as GLB: geometry in the scene's own world, material with F0 in KHR_materials_specular.

Notation: s specular albedo (F0); S its largest value on the atlas; a diffuse albedo. glTF's texture origin is the top
left, the atlas's the bottom left: v is flipped here and nowhere else.
"""

from pathlib import Path

import numpy as np

import sira_assets
from sira_assets.asset.avatar import Avatar
from sira_assets.asset.encoding import F0_OF_IOR_1_5, encode_normal, encode_srgb
from sira_assets.asset.glb_file import GlbFile
from sira_assets.asset.png import encode_png
from sira_assets.asset.split import split_at_seams
from sira_assets.atomic import write_bytes
from sira_assets.scene.camera import Camera
from sira_assets.texture.tangents import tangents

FLAT_NORMAL = np.array([0.0, 0.0, 1.0])


def write_glb(avatar: Avatar, path: str | Path) -> None:
    """Write `avatar` to `path`, whole or not at all; the same avatar gives the same bytes.

    Positions are the scene's world coordinates in float32, so that the file overlays the scene's truth; the unit and
    the similarity into the canonical head frame stand in the scene's `extras`, with the light.
    """
    write_bytes(path, glb_bytes(avatar))


def glb_bytes(avatar: Avatar) -> bytes:
    """The GLB file of `write_glb`, in memory (glTF 2.0; KHR_materials_specular)."""
    file = GlbFile()
    split = split_at_seams(avatar.mesh.faces, avatar.atlas.faces_uv)
    material = _material(avatar, file)
    uv = avatar.atlas.uv[split.uv_index]
    attributes = {
        "POSITION": file.add_vectors(avatar.mesh.vertices[split.position_index], bounds=True),
        "NORMAL": file.add_vectors(_unit(avatar.mesh.normals[split.position_index], FLAT_NORMAL)),
    }
    if "normalTexture" in material:
        frame = np.array(tangents(avatar.mesh, avatar.atlas), np.float64)[split.uv_index]
        frame[:, :3] = _unit(frame[:, :3], np.array([1.0, 0.0, 0.0]))
        frame[:, 3] = np.where(frame[:, 3] < 0, -1.0, 1.0)
        attributes["TANGENT"] = file.add_vectors(frame)
    attributes["TEXCOORD_0"] = file.add_vectors(np.stack([uv[:, 0], 1.0 - uv[:, 1]], 1))
    indices = file.add_indices(split.faces, len(uv))
    primitive = {"attributes": attributes, "indices": indices, "material": 0, "mode": 4}
    document = {
        "asset": {"version": "2.0", "generator": f"sira_assets {sira_assets.__version__}"},
        "extensionsUsed": ["KHR_materials_specular"],
        "scene": 0,
        "scenes": [{"name": avatar.name, "nodes": [0], "extras": _extras(avatar)}],
        "nodes": [{"name": avatar.name, "mesh": 0}],
        "meshes": [{"name": f"{avatar.name}_mesh", "primitives": [primitive]}],
        "materials": [material],
    }
    return file.to_bytes(document)


def _material(avatar: Avatar, file: GlbFile) -> dict:
    """The material, its textures added to `file`; a map that is constant on the atlas becomes a factor."""
    maps = avatar.textures
    used = maps.coverage if maps.coverage.any() else np.ones_like(maps.coverage)
    pbr: dict = {"metallicFactor": 0.0, "roughnessFactor": float(avatar.roughness)}
    material: dict = {"name": f"{avatar.name}_material", "pbrMetallicRoughness": pbr}

    base = encode_srgb(maps.diffuse)
    if (base[used] == base[used][0]).all():
        pbr["baseColorFactor"] = [*np.clip(maps.diffuse[used].mean(0, np.float64), 0, 1).tolist(), 1.0]
    else:
        text = {"Description": "diffuse albedo, sRGB encoded"}
        pbr["baseColorTexture"] = {"index": file.add_texture(encode_png(base, text), "diffuse")}

    normal = encode_normal(maps.normal_tangent)
    if not (normal[used] == encode_normal(FLAT_NORMAL)).all():
        text = {"Description": "tangent-space normal (n + 1) / 2, linear, +Y up"}
        material["normalTexture"] = {"index": file.add_texture(encode_png(normal, text), "normal")}

    # F0 with F90 = 1 is specularColor; specularFactor would scale F90 too. glTF's F0 is 0.04 * factor * texture, and
    # the factor may pass 1, so S / 0.04 there keeps the texture within 8 bits whatever the range of s.
    largest = float(np.clip(maps.specular_f0[used], 0.0, 1.0).max())
    extension: dict = {}
    codes = encode_srgb(maps.specular_f0 / largest) if largest > 0 else np.zeros(used.shape, np.uint8)
    factor = largest / F0_OF_IOR_1_5
    if (codes[used] == codes[used][0]).all():
        factor = float(maps.specular_f0[used].mean(dtype=np.float64)) / F0_OF_IOR_1_5
    else:
        rgb = np.repeat(codes[..., None], 3, -1)
        text = {"Description": "F0 / (0.04 specularColorFactor), sRGB encoded"}
        extension["specularColorTexture"] = {"index": file.add_texture(encode_png(rgb, text), "specular")}
    extension["specularColorFactor"] = [factor] * 3
    material["extensions"] = {"KHR_materials_specular": extension}
    return material


def _extras(avatar: Avatar) -> dict:
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
