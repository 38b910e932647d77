"""Turntables on disk: animated WebP by Pillow, MP4 by ffmpeg where it is installed."""

import io
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sira_assets.atomic import replacing, write_bytes
from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb, srgb_from_linear

WEBP_QUALITY = 85
# H.264's constant rate factor: 18 is where differences stop being seen by most (FFmpeg's H.264 encoding guide).
MP4_RATE_FACTOR = 18


def write_movie(path: str | Path, frames: Sequence[np.ndarray], *, fps: float = 18.0) -> None:
    """Write frames as a loop, whole or not at all; the suffix chooses the form.

    Parameters
    ----------
    path : ends in .webp or .mp4
    frames : (H, W, 3) or (H, W, 4) uint8 sRGB with straight alpha, all of one size; MP4 has no alpha: there they are
        laid over black
    fps : frames a second

    Raises
    ------
    InputError : another suffix, no frames, or no ffmpeg for an MP4.
    """
    path = Path(path)
    check_movie(path)
    if not len(frames):
        raise InputError(expected="at least one frame", received="none", remedy="ask for more frames")
    if path.suffix.lower() == ".webp":
        write_bytes(path, _webp(frames, fps))
    else:
        _write_mp4(path, frames, fps)


def check_movie(path: Path) -> None:
    """Raise `InputError` if a movie of this name cannot be written on this machine."""
    if path.suffix.lower() not in (".webp", ".mp4"):
        raise InputError(expected="a movie named .webp or .mp4", received=f"{path.name}", remedy="rename --out")
    if path.suffix.lower() == ".mp4" and ffmpeg() is None:
        raise InputError(
            expected="ffmpeg to write an MP4",
            received="none on the path, and no imageio-ffmpeg",
            remedy="install ffmpeg, or pip install 'sira-assets[movie]', or name the file .webp",
        )


def ffmpeg() -> str | None:
    """The ffmpeg program: the one on the path, else imageio-ffmpeg's, else None."""
    found = shutil.which("ffmpeg")
    if found:
        return found
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return None


def _webp(frames: Sequence[np.ndarray], fps: float) -> bytes:
    from PIL import Image

    pictures = [Image.fromarray(np.ascontiguousarray(frame)) for frame in frames]
    buffer = io.BytesIO()
    pictures[0].save(
        buffer,
        format="WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=max(1, round(1000.0 / fps)),
        loop=0,
        quality=WEBP_QUALITY,
        method=4,
        minimize_size=False,
    )
    return buffer.getvalue()


def _over_black(frame: np.ndarray) -> np.ndarray:
    """(H, W, 3) of a frame: colours times alpha where it has one, in linear light as everywhere."""
    if frame.shape[2] == 3:
        return frame
    linear = linear_from_srgb(frame[..., :3] / 255.0) * (frame[..., 3:] / 255.0)
    return np.rint(255.0 * srgb_from_linear(linear)).astype(np.uint8)


def _write_mp4(path: Path, frames: Sequence[np.ndarray], fps: float) -> None:
    # H.264 in 4:2:0 wants even sides: an odd one loses its last row or column.
    height, width = (side - side % 2 for side in frames[0].shape[:2])
    form = ["-f", "rawvideo", "-pixel_format", "rgb24", "-video_size", f"{width}x{height}", "-framerate", f"{fps}"]
    code = ["-c:v", "libx264", "-crf", str(MP4_RATE_FACTOR), "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    # The same frames give the same bytes: one thread, no creation time.
    same = ["-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"]
    with tempfile.TemporaryFile() as raw, replacing(path) as temporary:
        for frame in frames:
            raw.write(np.ascontiguousarray(_over_black(frame)[:height, :width]).tobytes())
        raw.seek(0)
        command = [ffmpeg(), "-y", "-loglevel", "error", *form, "-i", "-", *code, *same, str(temporary)]
        done = subprocess.run(command, stdin=raw, capture_output=True, check=False)
        if done.returncode:
            raise InputError(
                expected="ffmpeg to write an MP4 with H.264",
                received=done.stderr.decode(errors="replace").strip()[-200:],
                remedy="name the file .webp",
            )
