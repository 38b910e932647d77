"""A strict little GLB reader for the tests: it checks the container while it reads."""

import io
import itertools
import json
import struct
from dataclasses import dataclass

import numpy as np
from PIL import Image

TYPES = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class Glb:
    document: dict
    blob: bytes

    def view(self, index: int) -> bytes:
        v = self.document["bufferViews"][index]
        assert v["byteOffset"] % 4 == 0
        assert v["byteOffset"] + v["byteLength"] <= len(self.blob)
        return self.blob[v["byteOffset"] : v["byteOffset"] + v["byteLength"]]

    def accessor(self, index: int) -> np.ndarray:
        a = self.document["accessors"][index]
        data = np.frombuffer(self.view(a["bufferView"]), TYPES[a["componentType"]])
        width = WIDTHS[a["type"]]
        assert data.size == a["count"] * width
        return data.reshape(a["count"], width) if width > 1 else data

    def attribute(self, name: str) -> np.ndarray:
        return self.accessor(self.primitive["attributes"][name])

    def texels(self, reference: dict) -> np.ndarray:
        image = self.document["images"][self.document["textures"][reference["index"]]["source"]]
        with Image.open(io.BytesIO(self.view(image["bufferView"]))) as picture:
            return np.array(picture)

    @property
    def primitive(self) -> dict:
        return self.document["meshes"][0]["primitives"][0]

    @property
    def faces(self) -> np.ndarray:
        return self.accessor(self.primitive["indices"]).reshape(-1, 3).astype(np.int64)

    @property
    def material(self) -> dict:
        return self.document["materials"][0]

    @property
    def specular(self) -> dict:
        return self.material["extensions"]["KHR_materials_specular"]


def refuse_constant(name: str):
    raise AssertionError(f"{name} is not JSON")


def read_glb(data: bytes) -> Glb:
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    assert length % 4 == 0
    document = json.loads(data[20 : 20 + length], parse_constant=refuse_constant)
    size, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0"
    assert size % 4 == 0
    assert 28 + length + size == len(data)
    blob = data[28 + length :]
    assert [b["byteLength"] for b in document["buffers"]] == [len(blob)]
    ends = [(v["byteOffset"], v["byteOffset"] + v["byteLength"]) for v in document["bufferViews"]]
    assert all(a[1] <= b[0] for a, b in itertools.pairwise(ends)), "views overlap"
    return Glb(document, blob)
