"""A GLB read as a stranger would read it: binary glTF 2.0 to arrays, by the specification and nothing of our writer.

Notation: uv has its origin top-left, as glTF has it; F0 the reflectance at normal incidence. Colours are linear.
Read are meshes with node transforms, vertex colours, base colour, metallic and roughness, normal texture,
`KHR_materials_specular` and `KHR_materials_ior`. Sources: glTF 2.0 specification (registry.khronos.org/glTF), sections
3.6, 3.9 and 4.
"""

import base64
import io
import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb

_COMPONENT = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_CLAMP = 33071


@dataclass(frozen=True)
class Texture:
    """Texels (H, W, 4) float32, linear where they were sRGB; `clamp` in s and t (else the picture repeats)."""

    texels: np.ndarray
    clamp: tuple[bool, bool] = (False, False)

    def at(self, uv: np.ndarray) -> np.ndarray:
        """(N, 4) bilinear values at uv (N, 2); filtered after decoding, as glTF demands."""
        size = np.array([self.texels.shape[1], self.texels.shape[0]])
        x = uv * size - 0.5
        low = np.floor(x).astype(np.int64)
        part = x - low
        corner = []
        for step in (0, 1):
            index = low + step
            corner.append(
                [np.clip(index[:, k], 0, size[k] - 1) if self.clamp[k] else index[:, k] % size[k] for k in (0, 1)]
            )
        out = np.zeros((len(uv), 4))
        for i, wx in ((0, 1 - part[:, 0]), (1, part[:, 0])):
            for j, wy in ((0, 1 - part[:, 1]), (1, part[:, 1])):
                out += (wx * wy)[:, None] * self.texels[corner[j][1], corner[i][0]]
        return out


@dataclass(frozen=True)
class Material:
    """One glTF material; textures are None where absent, factors have glTF's defaults."""

    base_factor: np.ndarray
    base_texture: Texture | None
    metallic: float
    roughness: float
    metallic_roughness_texture: Texture | None
    f0_dielectric: float
    specular_factor: float
    specular_texture: Texture | None
    specular_colour_factor: np.ndarray
    specular_colour_texture: Texture | None
    normal_texture: Texture | None
    normal_scale: float


@dataclass(frozen=True)
class GlbModel:
    """All triangles of a GLB in world coordinates.

    Parameters
    ----------
    vertices, normals : (V, 3); normals None where any part lacks them
    uv : (V, 2), zeros where absent; colours : (V, 3) linear factors, ones where absent
    tangents : (V, 4) or None
    faces : (F, 3); material : (F,) index into `materials`
    extras : the scene's `extras`
    """

    vertices: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray
    colours: np.ndarray
    tangents: np.ndarray | None
    faces: np.ndarray
    material: np.ndarray
    materials: tuple[Material, ...]
    extras: dict


def read_avatar(path: str | Path) -> GlbModel:
    """Read an exported folder's `avatar.glb`, or a GLB itself.

    Raises
    ------
    InputError : a folder that holds no avatar, or as `read_glb`.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / "avatar.glb").is_file():
            raise InputError(
                expected=f"an exported avatar in {path}",
                received="a folder without avatar.glb",
                remedy="give the folder that export_avatar.py wrote, or a .glb",
            )
        path = path / "avatar.glb"
    return read_glb(path)


def read_glb(path: str | Path) -> GlbModel:
    """Read a GLB.

    Raises
    ------
    InputError : not a file, not binary glTF 2, truncated, no triangles, or buffers outside the file.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(expected=f"a GLB at {path}", received="no such file", remedy="check the path")
    try:
        return _model(*_chunks(path.read_bytes()))
    except InputError:
        raise
    except (ValueError, KeyError, IndexError, TypeError, struct.error, OSError) as error:
        raise InputError(
            expected=f"binary glTF 2.0 with its buffers inside in {path.name}",
            received=f"{type(error).__name__}: {error}",
            remedy="export the avatar again",
        ) from error


def _chunks(raw: bytes) -> tuple[dict, bytes]:
    magic, version, total = struct.unpack_from("<4sII", raw)
    if magic != b"glTF" or version != 2:
        raise ValueError("no glTF 2 header")
    if total != len(raw):
        raise ValueError(f"the header says {total} bytes, the file has {len(raw)}")
    length, _ = struct.unpack_from("<I4s", raw, 12)
    return json.loads(raw[20 : 20 + length]), raw[20 + length + 8 :]


class _Reader:
    """Accessors, textures and materials of one file."""

    def __init__(self, gltf: dict, blob: bytes):
        self.gltf, self.blob = gltf, blob
        self._decoded: dict[int, np.ndarray] = {}

    def accessor(self, index: int) -> np.ndarray:
        a = self.gltf["accessors"][index]
        if "sparse" in a:
            raise ValueError("sparse accessors are not read")
        view = self.gltf["bufferViews"][a["bufferView"]]
        dtype, width = np.dtype(_COMPONENT[a["componentType"]]), _WIDTH[a["type"]]
        offset = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        stride = view.get("byteStride") or dtype.itemsize * width
        out = np.ndarray((a["count"], width), dtype, self.blob, offset, (stride, dtype.itemsize)).copy()
        return np.maximum(out / float(np.iinfo(dtype).max), -1.0) if a.get("normalized") else out

    def _picture(self, index: int) -> np.ndarray:
        if index not in self._decoded:
            from PIL import Image

            entry = self.gltf["images"][index]
            if "bufferView" in entry:
                view = self.gltf["bufferViews"][entry["bufferView"]]
                start = view.get("byteOffset", 0)
                data = self.blob[start : start + view["byteLength"]]
            elif entry.get("uri", "").startswith("data:"):
                data = base64.b64decode(entry["uri"].split(",", 1)[1])
            else:
                raise ValueError("pictures outside the GLB are not read")
            with Image.open(io.BytesIO(data)) as picture:
                self._decoded[index] = np.asarray(picture.convert("RGBA"), np.float32) / 255
        return self._decoded[index]

    def texture(self, slot: dict | None, *, srgb: bool) -> Texture | None:
        if slot is None:
            return None
        texture = self.gltf["textures"][slot["index"]]
        texels = self._picture(texture["source"])
        if srgb:
            texels = np.concatenate([linear_from_srgb(texels[..., :3]), texels[..., 3:]], -1)
        sampler = self.gltf["samplers"][texture["sampler"]] if "sampler" in texture else {}
        return Texture(texels, (sampler.get("wrapS") == _CLAMP, sampler.get("wrapT") == _CLAMP))

    def material(self, m: dict) -> Material:
        pbr, extensions = m.get("pbrMetallicRoughness", {}), m.get("extensions", {})
        specular = extensions.get("KHR_materials_specular", {})
        ior = float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5))
        return Material(
            base_factor=np.array(pbr.get("baseColorFactor", [1, 1, 1, 1]), np.float64)[:3],
            base_texture=self.texture(pbr.get("baseColorTexture"), srgb=True),
            metallic=float(pbr.get("metallicFactor", 1.0)),
            roughness=float(pbr.get("roughnessFactor", 1.0)),
            metallic_roughness_texture=self.texture(pbr.get("metallicRoughnessTexture"), srgb=False),
            f0_dielectric=((ior - 1) / (ior + 1)) ** 2,
            specular_factor=float(specular.get("specularFactor", 1.0)),
            specular_texture=self.texture(specular.get("specularTexture"), srgb=False),
            specular_colour_factor=np.array(specular.get("specularColorFactor", [1, 1, 1]), np.float64),
            specular_colour_texture=self.texture(specular.get("specularColorTexture"), srgb=True),
            normal_texture=self.texture(m.get("normalTexture"), srgb=False),
            normal_scale=float(m.get("normalTexture", {}).get("scale", 1.0)),
        )


def _local(node: dict) -> np.ndarray:
    """(4, 4) pose of a node in its parent: a column-major matrix, or translation, rotation (x, y, z, w) and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    out = np.eye(4)
    out[:3, :3] = (np.eye(3) + 2 * w * cross + 2 * cross @ cross) * np.array(node.get("scale", [1, 1, 1]))
    out[:3, 3] = node.get("translation", [0, 0, 0])
    return out


def _model(gltf: dict, blob: bytes) -> GlbModel:
    reader = _Reader(gltf, blob)
    parts = []

    def visit(index: int, parent: np.ndarray, depth: int) -> None:
        if depth > 64:
            raise ValueError("nodes nested deeper than 64")
        node = gltf["nodes"][index]
        pose = parent @ _local(node)
        for primitive in gltf["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
            if primitive.get("mode", 4) == 4:
                parts.append(_part(reader, primitive, pose))
        for child in node.get("children", []):
            visit(child, pose, depth + 1)

    scene = gltf["scenes"][gltf.get("scene", 0)]
    for root in scene["nodes"]:
        visit(root, np.eye(4), 0)
    if not sum(len(part["faces"]) for part in parts):
        raise ValueError("no triangles")
    start = np.cumsum([0] + [len(part["vertices"]) for part in parts])
    joined = {
        key: None if any(part[key] is None for part in parts) else np.concatenate([part[key] for part in parts])
        for key in ("vertices", "normals", "uv", "colours", "tangents", "material")
    }
    faces = np.concatenate([part["faces"] + s for part, s in zip(parts, start, strict=False)])
    # glTF's default material stands last, for parts that name none.
    materials = tuple(reader.material(m) for m in [*gltf.get("materials", []), {}])
    joined["material"] = np.where(joined["material"] < 0, len(materials) - 1, joined["material"])
    return GlbModel(faces=faces, materials=materials, extras=scene.get("extras") or {}, **joined)


def _part(reader: _Reader, primitive: dict, pose: np.ndarray) -> dict:
    names = primitive["attributes"]

    def get(key):
        return reader.accessor(names[key]).astype(np.float64) if key in names else None

    vertices, normals, tangents = get("POSITION"), get("NORMAL"), get("TANGENT")
    linear = pose[:3, :3]
    faces = reader.accessor(primitive["indices"]) if "indices" in primitive else np.arange(len(vertices))
    faces = faces.reshape(-1, 3).astype(np.int64)
    if faces.size and faces.max() >= len(vertices):
        raise ValueError("an index beyond the vertices")
    if np.linalg.det(linear) < 0:
        faces = faces[:, ::-1]
    colours, uv = get("COLOR_0"), get("TEXCOORD_0")
    return {
        "vertices": vertices @ linear.T + pose[:3, 3],
        "normals": None if normals is None else unit(normals @ np.linalg.inv(linear)),
        "tangents": None if tangents is None else np.c_[unit(tangents[:, :3] @ linear.T), tangents[:, 3]],
        "uv": np.zeros((len(vertices), 2)) if uv is None else uv,
        "colours": np.ones((len(vertices), 3)) if colours is None else colours[:, :3],
        "faces": faces,
        "material": np.full(len(faces), primitive.get("material", -1), np.int64),
    }


def unit(x: np.ndarray) -> np.ndarray:
    """(N, 3) vectors of length 1; zero stays zero."""
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300)
