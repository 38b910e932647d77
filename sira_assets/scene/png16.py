"""16-bit PNG at full depth, which Pillow cuts to 8 bits for colour.

Notation of the PNG specification (ISO/IEC 15948, clause 9): each byte x of a row was predicted from a (one pixel to
the left), b (above) and c (above left); the filter type of the row says how.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from sira_assets.atomic import write_bytes
from sira_assets.errors import InputError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # by colour type
# Adam7 passes: first column, first row, column step, row step.
ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


def is_png16(head: bytes) -> bool:
    """Whether a file that starts with `head` (at least 26 bytes) is a PNG of 16 bits a sample."""
    return head[:8] == SIGNATURE and len(head) >= 26 and head[24] == 16


def png_size(head: bytes) -> tuple[int, int]:
    """Width and height from the first 24 bytes of a PNG file."""
    return struct.unpack(">2I", head[16:24])


def _unfilter(filters: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Undo the filters of `rows` (H, W, bytes a pixel) by anti-diagonals, each of which depends on the two before."""
    height, width, _ = rows.shape
    x = np.zeros((height + 1, width + 1, rows.shape[2]), np.int32)
    for diagonal in range(height + width - 1):
        r = np.arange(max(0, diagonal - width + 1), min(height, diagonal + 1))
        c = diagonal - r
        kind = filters[r][:, None]
        left, above, corner = x[r + 1, c], x[r, c + 1], x[r, c]
        p = left + above - corner
        to_left, to_above, to_corner = np.abs(p - left), np.abs(p - above), np.abs(p - corner)
        paeth = np.where(
            (to_left <= to_above) & (to_left <= to_corner), left, np.where(to_above <= to_corner, above, corner)
        )
        guess = np.select([kind == 1, kind == 2, kind == 3, kind == 4], [left, above, (left + above) // 2, paeth], 0)
        x[r + 1, c + 1] = (rows[r, c] + guess) & 255
    return x[1:, 1:].astype(np.uint8)


def read_png16(path: str | Path) -> np.ndarray:
    """Samples of a 16-bit PNG as uint16, (H, W, channels) with 1 to 4 channels (grey, grey+alpha, RGB, RGBA).

    Raises
    ------
    InputError : the file is damaged or truncated.
    """
    data = Path(path).read_bytes()
    damaged = InputError(
        expected=f"a whole PNG image at {path}", received=f"{len(data)} damaged bytes", remedy="copy or export it again"
    )
    at, packed, ended = 8, [], False
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        if kind == b"IDAT":
            packed.append(data[at + 8 : at + 8 + length])
        ended |= kind == b"IEND"
        at += 12 + length
    width, height, depth, colour, _, _, interlaced = struct.unpack_from(">2I5B", data, 16)
    if not ended or depth != 16 or colour not in CHANNELS or not width or not height:
        raise damaged
    size = 2 * CHANNELS[colour]
    passes = ADAM7 if interlaced else ((0, 0, 1, 1),)
    shapes = [(-(-(height - y) // dy), -(-(width - x) // dx)) for x, y, dx, dy in passes]
    lengths = [h * (1 + w * size) if h > 0 and w > 0 else 0 for h, w in shapes]
    try:
        # max_length: a few bytes may unpack to terabytes.
        raw = np.frombuffer(zlib.decompressobj().decompress(b"".join(packed), max_length=sum(lengths)), np.uint8)
    except zlib.error:
        raise damaged from None
    if len(raw) != sum(lengths):
        raise damaged
    out, start = np.zeros((height, width, size), np.uint8), 0
    for (x, y, dx, dy), (h, w), length in zip(passes, shapes, lengths, strict=True):
        if length:
            rows = raw[start : start + length].reshape(h, 1 + w * size)
            out[y::dy, x::dx] = _unfilter(rows[:, 0], rows[:, 1:].reshape(h, w, size))
        start += length
    return out.view(">u2").astype(np.uint16)


def write_png16(path: str | Path, samples: np.ndarray) -> None:
    """Write uint16 samples (H, W) or (H, W, 1 to 4) as a 16-bit PNG, whole or not at all."""
    samples = np.asarray(samples, np.uint16)
    samples = samples[..., None] if samples.ndim == 2 else samples
    height, width, channels = samples.shape
    colour = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    rows = np.ascontiguousarray(samples.astype(">u2")).view(np.uint8).reshape(height, -1)
    # Filter 2 (Up) on every row: smooth pictures shrink well and the arithmetic is one subtraction.
    up = np.diff(rows.astype(np.int16), axis=0, prepend=0).astype(np.uint8)
    raw = np.concatenate([np.full((height, 1), 2, np.uint8), up], 1).tobytes()
    chunks = [(b"IHDR", struct.pack(">2I5B", width, height, 16, colour, 0, 0, 0)), (b"IDAT", zlib.compress(raw, 6))]
    body = b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in [*chunks, (b"IEND", b"")]
    )
    write_bytes(path, SIGNATURE + body)
