"""A GLB for tests, written by trimesh and edited by hand: nothing of this project's own writer is in it."""

import json
import struct
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from sira_assets.mesh.triangle_mesh import TriangleMesh


def write_test_glb(
    path: Path, mesh: TriangleMesh, uv: np.ndarray, texture: np.ndarray, *, ks: float = 1.0, **extras
) -> None:
    """Write `mesh` with uv (V, 2), origin bottom-left, an 8-bit texture (H, W, 3), constant `ks`, and the extras."""
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(texture), metallicFactor=0.0, roughnessFactor=0.5
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    written = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, visual=visual, process=False)
    raw = written.export(file_type="glb", include_normals=True)
    length = struct.unpack_from("<I", raw, 12)[0]
    gltf = json.loads(raw[20 : 20 + length])
    gltf["materials"][0]["extensions"] = {"KHR_materials_specular": {"specularColorFactor": [ks] * 3}}
    gltf["scenes"][0]["extras"] = extras
    gltf["extensionsUsed"] = ["KHR_materials_specular"]
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    rest = raw[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + len(rest))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)
