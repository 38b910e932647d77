"""OpenEXR files: read and written whole, or refused with a reason.

OpenEXR's reader neither raises on a truncated file nor stays silent about it (it prints), so the header, the table of
chunk offsets and the last chunk are checked here before it sees the file. Its writer takes non-contiguous arrays and
writes them wrong, so every array is made contiguous.
"""

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sira_assets.atomic import replacing
from sira_assets.errors import InputError

MAGIC = 20000630
TILED, MULTIPART, DEEP = 0x200, 0x1000, 0x800
# Scan lines in one chunk by compression method: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB
# ("Technical Introduction to OpenEXR", table of compression methods).
LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}


def _damaged(path: Path, what: str) -> InputError:
    return InputError(
        expected=f"a whole OpenEXR image at {path}", received=what, remedy="copy or export the file again"
    )


def _attributes(data: bytes, path: Path) -> tuple[dict[str, bytes], int, int]:
    """Header attributes of the first part as raw bytes, the version flags, and the offset just after the header."""
    if len(data) < 8 or struct.unpack_from("<i", data)[0] != MAGIC:
        raise _damaged(path, "another kind of file" if len(data) >= 8 else f"{len(data)} byte(s)")
    flags, at, attributes = struct.unpack_from("<i", data, 4)[0], 8, {}
    try:
        while data[at] != 0:
            name_end = data.index(0, at)
            type_end = data.index(0, name_end + 1)
            (size,) = struct.unpack_from("<i", data, type_end + 1)
            if size < 0 or type_end + 5 + size > len(data):
                raise ValueError
            attributes[data[at:name_end].decode("latin-1")] = data[type_end + 5 : type_end + 5 + size]
            at = type_end + 5 + size
    except (ValueError, IndexError, struct.error):
        raise _damaged(path, "a header that ends early") from None
    return attributes, flags, at + 1


def exr_size(path: str | Path) -> tuple[int, int]:
    """Width and height of the image in an EXR file, from its header; checks that the file is whole.

    Raises
    ------
    InputError : not an EXR file, or one that ends before its last chunk does.
    """
    path = Path(path)
    length = path.stat().st_size
    with open(path, "rb") as file:
        attributes, flags, at = _attributes(file.read(1 << 20), path)
        if len(attributes.get("dataWindow", b"")) != 16:
            raise _damaged(path, "a header without dataWindow")
        x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"])
        width, height = x1 - x0 + 1, y1 - y0 + 1
        if width <= 0 or height <= 0:
            raise _damaged(path, f"an image of {width}x{height} pixels")
        lines = LINES_PER_CHUNK.get(attributes.get("compression", b"\xff")[0])
        if flags & (TILED | MULTIPART | DEEP) or lines is None:
            return width, height  # the chunk layout is another; read_exr still notices missing channels
        chunks = -(-height // lines)
        file.seek(at)
        table = file.read(8 * chunks) if chunks < 1 << 20 else b""
        if len(table) != 8 * chunks:
            raise _damaged(path, f"{length} bytes, which end inside the table of chunks")
        offsets = np.frombuffer(table, "<u8")
        last = int(offsets.max())
        file.seek(min(last, length))
        leader = file.read(8)
        if offsets.min() == 0 or len(leader) < 8 or last + 8 + struct.unpack("<2i", leader)[1] > length:
            raise _damaged(path, f"{length} bytes, which end before the last scan line")
    return width, height


def read_exr(path: str | Path) -> np.ndarray:
    """Pixels of an EXR file as float32: (H, W, 3) for R, G, B, else (H, W) for its one channel.

    Layers are told apart by their prefix ("ViewLayer.Combined.R"); the first that has R, G and B is taken.

    Raises
    ------
    InputError : damaged, or neither RGB nor of one channel.
    """
    import OpenEXR

    path = Path(path)
    exr_size(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {k: np.array(v.pixels, np.float32) for p in file.parts for k, v in p.channels.items()}
    except (RuntimeError, ValueError) as error:
        raise _damaged(path, str(error)) from None
    if not channels:
        raise _damaged(path, "a file without readable pixels")
    for name in channels:
        rgb = [name[: len(name) - 1] + letter for letter in "RGB"]
        if name.endswith("R") and (len(name) == 1 or name[-2] == ".") and all(n in channels for n in rgb):
            return np.stack([channels[n] for n in rgb], -1)
    colour = [n for n in channels if n != "A"]
    if len(colour) > 1:
        raise InputError(
            expected=f"channels R, G, B or a single one in {path}",
            received=", ".join(sorted(channels)[:8]),
            remedy="export the picture as RGB",
        )
    return channels[(colour or list(channels))[0]]


def write_exr(path: str | Path, linear: np.ndarray, *, header: Mapping[str, object] | None = None) -> None:
    """Write linear float32 pixels, ZIP-compressed, whole or not at all.

    Parameters
    ----------
    path : ends in .exr
    linear : (H, W, 3) written as R, G, B; (H, W, 4) with A, colours premultiplied by it; or (H, W) written as Y
    header : further EXR attributes, such as {"envmap": OpenEXR.ENVMAP_LATLONG}

    Raises
    ------
    InputError : another shape.
    """
    import OpenEXR

    pixels = np.ascontiguousarray(linear, np.float32)
    if pixels.size == 0 or not (pixels.ndim == 2 or (pixels.ndim == 3 and pixels.shape[2] in (3, 4))):
        raise InputError(
            expected="pixels (H, W, 3), (H, W, 4) or (H, W)",
            received=f"shape {pixels.shape}",
            remedy="give the picture as RGB",
        )
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(header or {})}
    channels = {"Y" if pixels.ndim == 2 else "RGBA"[: pixels.shape[2]]: pixels}
    with replacing(path) as temporary, OpenEXR.File(attributes, channels) as file:
        file.write(str(temporary))
