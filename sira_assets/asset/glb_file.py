"""The GLB container: one JSON chunk, one binary chunk, everything 4-byte aligned (glTF 2.0, sections 3.6 and 4.4).

Notation: a view is a span of the binary chunk; an accessor gives a view a type.
"""

import json
import struct

import numpy as np

MAGIC, VERSION = 0x46546C67, 2
CHUNK_JSON, CHUNK_BIN = 0x4E4F534A, 0x004E4942
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125
INTEGER_TYPES = {np.dtype(np.int8): 5120, np.dtype(np.int16): 5122, np.dtype(np.uint16): UNSIGNED_SHORT}
VECTOR_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
# The largest value of an index type restarts primitives, so 65535 vertices (indices to 65534) are the most for 16 bits.
MAX_VERTICES_16_BIT = 65535


class GlbFile:
    """Collects buffer views, accessors and images; `to_bytes` makes the file of them."""

    def __init__(self):
        self._blob = bytearray()
        self._views: list[dict] = []
        self._accessors: list[dict] = []
        self._images: list[dict] = []

    def add_view(self, data: bytes, target: int | None = None) -> int:
        """Append bytes at a 4-byte boundary; returns the view's index."""
        self._blob += b"\0" * (-len(self._blob) % 4)
        view = {"buffer": 0, "byteOffset": len(self._blob), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._blob += data
        self._views.append(view)
        return len(self._views) - 1

    def add_vectors(self, array: np.ndarray, *, bounds: bool = False) -> int:
        """Append (N, k) vertex data as float32; returns the accessor's index.

        Parameters
        ----------
        bounds : also write min and max, which glTF demands of positions (of the float32 values, as readers see them)
        """
        data = np.ascontiguousarray(array, np.float32)
        if not np.isfinite(data).all():
            raise ValueError("vertex data must be finite in float32")
        accessor = {
            "bufferView": self.add_view(data.tobytes(), ARRAY_BUFFER),
            "componentType": FLOAT,
            "count": len(data),
            "type": VECTOR_TYPES[data.shape[1]],
        }
        if bounds:
            accessor["min"] = [float(x) for x in data.min(0)]
            accessor["max"] = [float(x) for x in data.max(0)]
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def add_codes(self, codes: np.ndarray, *, bounds: bool = False) -> int:
        """Append (N, k) int8, int16 or uint16 vertex data that stands for fractions; returns the accessor's index.

        Each vertex is padded to a multiple of four bytes, which KHR_mesh_quantization demands.
        """
        count, width = codes.shape
        stride = codes.dtype.itemsize * width
        stride += -stride % 4
        padded = np.zeros((count, stride // codes.dtype.itemsize), codes.dtype)
        padded[:, :width] = codes
        view = self.add_view(padded.tobytes(), ARRAY_BUFFER)
        self._views[view]["byteStride"] = stride
        accessor = {
            "bufferView": view,
            "componentType": INTEGER_TYPES[codes.dtype],
            "normalized": True,
            "count": count,
            "type": VECTOR_TYPES[width],
        }
        if bounds:
            accessor["min"] = codes.min(0).tolist()
            accessor["max"] = codes.max(0).tolist()
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def add_indices(self, faces: np.ndarray, vertex_count: int) -> int:
        """Append (F, 3) triangle indices in the smallest type that holds them; returns the accessor's index."""
        small = vertex_count <= MAX_VERTICES_16_BIT
        data = np.ascontiguousarray(faces, np.uint16 if small else np.uint32).reshape(-1)
        accessor = {
            "bufferView": self.add_view(data.tobytes(), ELEMENT_ARRAY_BUFFER),
            "componentType": UNSIGNED_SHORT if small else UNSIGNED_INT,
            "count": data.size,
            "type": "SCALAR",
        }
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def add_texture(self, picture: bytes, name: str, mime: str = "image/png") -> int:
        """Append a PNG or JPEG; returns the texture's index (one texture for each image, one sampler for all)."""
        self._images.append({"name": name, "mimeType": mime, "bufferView": self.add_view(picture)})
        return len(self._images) - 1

    def to_bytes(self, document: dict) -> bytes:
        """The whole file.

        Parameters
        ----------
        document : glTF's JSON without buffers, bufferViews, accessors, images, textures and samplers

        Raises
        ------
        ValueError : a number in `document` is NaN or infinite, which JSON cannot say.
        """
        blob = bytes(self._blob + b"\0" * (-len(self._blob) % 4))
        document = dict(document)
        if self._images:
            document["textures"] = [{"sampler": 0, "source": k} for k in range(len(self._images))]
            document["images"] = self._images
            # Linear with mipmaps; clamped, since an atlas does not repeat and its borders are padded.
            document["samplers"] = [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}]
        document["accessors"] = self._accessors
        document["bufferViews"] = self._views
        document["buffers"] = [{"byteLength": len(blob)}]
        text = json.dumps(document, allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + len(blob)
        return b"".join(
            (
                struct.pack("<III", MAGIC, VERSION, total),
                struct.pack("<II", len(text), CHUNK_JSON),
                text,
                struct.pack("<II", len(blob), CHUNK_BIN),
                blob,
            )
        )
