"""Radiance pictures (.hdr, .pic): RGBE pixels, read and written whole, or refused with a reason.

Notation: a pixel is four bytes (r, g, b, e) and stands for (r + 1/2, g + 1/2, b + 1/2) 2^{e - 136}, or black where
e = 0; the writer truncates, so a channel comes back within 1/256 of the pixel's largest (Ward, Real Pixels, Graphics
Gems II, 1991, and Radiance's own color.c). Programs that leave the 1/2 out see up to 1/256 less.
"""

import re
from pathlib import Path

import numpy as np

from sira_assets.atomic import write_bytes
from sira_assets.errors import InputError

# 16384 x 8192: twice the largest panorama in common use, 1.6 GB as float32.
MAX_PIXELS = 1 << 27
# Radiance writes no longer header; what goes on without its blank line is another kind of file.
MAX_HEADER = 1 << 16
# Run-length coding by component is defined for these widths only.
MIN_RLE_WIDTH, MAX_RLE_WIDTH = 8, 0x7FFF
# A run of three equal bytes costs no less as a run than inside a literal.
MIN_RUN = 4
# Scan lines expanded at a time: bounds the index arrays to some 10 MB.
ROWS_PER_BLOCK = 64

_RESOLUTION = re.compile(rb"([+-])([XY]) (\d{1,9}) ([+-])([XY]) (\d{1,9})[ \t\r]*")


def _damaged(path: Path, what: str) -> InputError:
    return InputError(
        expected=f"a whole Radiance picture at {path}", received=what, remedy="copy or export the file again"
    )


def _header(data: bytes, path: Path) -> tuple[np.ndarray, tuple[bytes, ...], int]:
    """Gain (3,) that undoes exposure and colour correction, the resolution string's six parts, the pixels' offset."""
    if not data.startswith(b"#?"):
        raise _damaged(path, "another kind of file" if data else "an empty file")
    end = data.find(b"\n\n", 0, MAX_HEADER)
    gap = 2
    if end < 0:
        end, gap = data.find(b"\n\r\n", 0, MAX_HEADER), 3
    stop = data.find(b"\n", end + gap, end + gap + 128) if end >= 0 else -1
    match = _RESOLUTION.fullmatch(data[end + gap : stop]) if stop >= 0 else None
    if match is None or match[2] == match[5]:
        raise _damaged(path, "a header that ends early or names no size")
    gain = np.ones(3)
    for line in data[:end].split(b"\n")[1:]:
        name, _, value = line.partition(b"=")
        name, value = name.strip(), value.strip()
        if name == b"FORMAT" and value != b"32-bit_rle_rgbe":
            raise InputError(
                expected=f"FORMAT=32-bit_rle_rgbe in {path}",
                received=value.decode("latin-1")[:40],
                remedy="convert it to RGB, or export it as EXR",
            )
        if name in (b"EXPOSURE", b"COLORCORR"):
            try:
                divisor = np.broadcast_to(np.array([float(v) for v in value.split()]), 3)
            except ValueError:
                divisor = np.zeros(3)
            # Twenty decades either way are more than any camera's; beyond, the radiance would overflow.
            if not ((divisor > 1e-20) & (divisor < 1e20)).all():
                raise _damaged(path, f"{name.decode()}={value.decode('latin-1')[:40]}")
            gain = gain / divisor
    return gain, match.groups(), stop + 1


def _runs_of_line(data: bytes, at: int, width: int) -> tuple[list[int], int]:
    """Where the codes of a run-length coded line lie, from its first one on, and where the line ends."""
    codes = []
    for _ in range(4):
        filled = 0
        while filled < width:
            codes.append(at)
            code = data[at]
            if code > 128:
                filled += code - 128
                at += 2
            elif code:
                filled += code
                at += code + 1
            else:
                raise ValueError("a run of no length")
        if filled != width:
            raise ValueError("a run beyond the end of its line")
    return codes, at


def _expand(buffer: np.ndarray, codes: list[int], width: int) -> np.ndarray:
    """(lines, width, 4) bytes of run-length coded lines."""
    at = np.array(codes)
    code = buffer[at].astype(np.int64)
    run = code > 128
    length = np.where(run, code - 128, code)
    within = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    source = np.repeat(at + 1, length) + np.where(np.repeat(run, length), 0, within)
    return np.swapaxes(buffer[source].reshape(-1, 4, width), 1, 2)


def _old_line(data: bytes, at: int, width: int) -> tuple[np.ndarray, int]:
    """One line (width, 4) of plain pixels, in which (1, 1, 1, n) repeats the pixel before it; and where it ends."""
    pixels = np.frombuffer(data, np.uint8, min(4 * width, (len(data) - at) // 4 * 4), at).reshape(-1, 4)
    marks = (pixels[:, :3] == 1).all(1)
    if len(pixels) == width and not marks.any():
        return pixels, at + 4 * width
    out, filled, shift = np.empty((width, 4), np.uint8), 0, 0
    while filled < width:
        pixel = data[at : at + 4]
        if len(pixel) < 4:
            raise IndexError
        at += 4
        if pixel[:3] == b"\x01\x01\x01":
            count = pixel[3] << shift
            if filled == 0 or shift > 24 or filled + count > width:
                raise ValueError("a repetition beyond its line")
            out[filled : filled + count] = out[filled - 1]
            filled, shift = filled + count, shift + 8
        else:
            out[filled] = np.frombuffer(pixel, np.uint8)
            filled, shift = filled + 1, 0
    return out, at


def _lines(data: bytes, at: int, lines: int, width: int) -> np.ndarray:
    """(lines, width, 4) bytes, in the file's own order."""
    buffer = np.frombuffer(data, np.uint8)
    leader = bytes([2, 2, width >> 8, width & 255]) if MIN_RLE_WIDTH <= width <= MAX_RLE_WIDTH else None
    blocks, codes = [], []
    for line in range(lines):
        if leader is not None and data[at : at + 4] == leader:
            more, at = _runs_of_line(data, at + 4, width)
            codes += more
            # A literal that reaches past the end is found here, before its bytes are taken.
            if at > len(data):
                raise IndexError
            full = (line + 1) % ROWS_PER_BLOCK == 0
        else:
            if codes:
                blocks.append(_expand(buffer, codes, width))
                codes = []
            plain, at = _old_line(data, at, width)
            blocks.append(plain[None])
            full = False
        if codes and (full or line + 1 == lines):
            blocks.append(_expand(buffer, codes, width))
            codes = []
    return np.concatenate(blocks)


def read_hdr(path: str | Path) -> np.ndarray:
    """Pixels (H, W, 3) float32 of a Radiance picture, upright, with EXPOSURE and COLORCORR undone.

    Reads run-length coded, old run-length coded and plain lines, in all eight orientations. PRIMARIES are not
    applied: Radiance's own differ from Rec. 709 by less than 0.01 in x and y, and other programs ignore them.

    Raises
    ------
    InputError : another kind of file, XYZ pixels, more than `MAX_PIXELS`, or one that ends early or is damaged.
    """
    path = Path(path)
    data = path.read_bytes()
    gain, (sign_1, axis_1, count_1, sign_2, _, count_2), at = _header(data, path)
    lines, width = int(count_1), int(count_2)
    if not 0 < lines * width <= MAX_PIXELS:
        raise InputError(
            expected=f"a picture of at most {MAX_PIXELS >> 20} megapixels at {path}",
            received=f"{width}x{lines} in its header",
            remedy="make it smaller",
        )
    try:
        rgbe = _lines(data, at, lines, width)
    except IndexError:
        raise _damaged(path, f"{len(data)} bytes, which end before the last line") from None
    except ValueError as error:
        raise _damaged(path, str(error)) from None
    exponent = rgbe[..., 3].astype(np.int32)
    scale = np.where(exponent > 0, np.ldexp(1.0, exponent - 136), 0.0)[..., None] * gain
    pixels = np.minimum((rgbe[..., :3] + 0.5) * scale, np.finfo(np.float32).max).astype(np.float32)
    # "-Y H +X W" is upright: lines go down, columns to the right. Columns come first where X is named first.
    down, right = (sign_1, sign_2) if axis_1 == b"Y" else (sign_2, sign_1)
    if axis_1 == b"X":
        pixels = np.swapaxes(pixels, 0, 1)
    pixels = pixels[:: 1 if down == b"-" else -1, :: 1 if right == b"+" else -1]
    return np.ascontiguousarray(pixels)


def _rgbe(linear: np.ndarray) -> np.ndarray:
    """(..., 4) bytes of finite radiance >= 0; below 2^-127 it is black."""
    value = linear.astype(np.float64)
    _, exponent = np.frexp(value.max(-1))
    seen = (value.max(-1) > 0) & (exponent > -128)
    mantissa = np.ldexp(value, (8 - exponent)[..., None])
    rgbe = np.concatenate([np.floor(mantissa), exponent[..., None] + 128], -1)
    return np.where(seen[..., None], rgbe, 0).astype(np.uint8)


def _compressed(rgbe: np.ndarray) -> bytes:
    """Lines (n, W, 4) in Radiance's run-length code by component, W in 8 to 32767."""
    width = rgbe.shape[1]
    values = np.swapaxes(rgbe, 1, 2).reshape(-1)
    fresh = np.empty(len(values), bool)
    fresh[1:] = values[1:] != values[:-1]
    fresh[::width] = True  # neither runs nor literals go over the end of a component
    start = np.flatnonzero(fresh)
    run = np.diff(start, append=len(values)) >= MIN_RUN
    # Short runs that follow each other make one literal.
    opens = run | (start % width == 0)
    opens[1:] |= run[:-1]
    start, run = start[opens], run[opens]
    length = np.diff(start, append=len(values))
    limit = np.where(run, 127, 128)
    pieces = -(-length // limit)
    nth = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    start, run, length, limit = (np.repeat(a, pieces) for a in (start, run, length, limit))
    start, length = start + nth * limit, np.minimum(length - nth * limit, limit)

    size = np.where(run, 2, length + 1)
    line = start // (4 * width)
    at = np.cumsum(size) - size + 4 * (line + 1)  # four bytes lead each line
    out = np.empty(size.sum() + 4 * len(rgbe), np.uint8)
    out[at] = np.where(run, length + 128, length)
    out[at[run] + 1] = values[start[run]]
    literal = length[~run]
    within = np.arange(literal.sum()) - np.repeat(np.cumsum(literal) - literal, literal)
    out[np.repeat(at[~run] + 1, literal) + within] = values[np.repeat(start[~run], literal) + within]
    first = at[start % (4 * width) == 0] - 4
    out[first[:, None] + np.arange(4)] = [2, 2, width >> 8, width & 255]
    return out.tobytes()


def write_hdr(path: str | Path, linear: np.ndarray) -> None:
    """Write linear radiance as a Radiance picture, run-length coded where the format can, whole or not at all.

    Parameters
    ----------
    path : ends in .hdr
    linear : (H, W, 3), finite, 0 to 1.7e38; each channel comes back within 1/256 of its pixel's largest

    Raises
    ------
    InputError : another shape, or values that RGBE cannot hold.
    """
    pixels = np.asarray(linear)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.size == 0:
        raise InputError(
            expected="pixels (H, W, 3)", received=f"shape {pixels.shape}", remedy="give the picture as RGB"
        )
    if not ((pixels >= 0) & (pixels < 2.0**127)).all():
        raise InputError(
            expected=f"radiance from 0 to 1.7e38 for {path}",
            received="negative, larger or non-finite values",
            remedy="write an .exr, which holds them",
        )
    height, width = pixels.shape[:2]
    coded = [b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n", b"-Y %d +X %d\n" % (height, width)]
    for row in range(0, height, ROWS_PER_BLOCK):
        rgbe = _rgbe(pixels[row : row + ROWS_PER_BLOCK])
        coded.append(_compressed(rgbe) if MIN_RLE_WIDTH <= width <= MAX_RLE_WIDTH else rgbe.tobytes())
    write_bytes(path, b"".join(coded))
