"""Parts of a surface to unwrappers that may hang or crash: processes side by side, under one deadline.

Notation: a part is a set of faces unwrapped together. What a process has finished when it is killed or crashes is kept.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_POLL_S = 0.02


@dataclass(frozen=True)
class Part:
    """Faces to be unwrapped together: vertices (V, 3), faces (F, 3) into them."""

    vertices: np.ndarray
    faces: np.ndarray


def split_parts(vertices: np.ndarray, faces: np.ndarray, piece: np.ndarray, most: int) -> np.ndarray:
    """(F,) number of the part each face belongs to: at most `most` faces each, small pieces together.

    A piece of more is halved across its longest side, again and again: compact parts, so that the cuts are short.

    Parameters
    ----------
    piece : (F,) int, connected piece of each face
    """
    centre = vertices[faces].mean(1)
    size = np.bincount(piece)
    stack = [np.flatnonzero(piece == number) for number in np.flatnonzero(size > most)]
    # Pieces small enough are filled into parts, the largest first, whole.
    rest = np.flatnonzero(size[piece] <= most)
    rest = rest[np.lexsort((piece[rest], -size[piece[rest]]))]
    part = np.full(len(faces), -1)
    count = filled = 0
    starts = np.flatnonzero(np.diff(piece[rest], prepend=-1)).tolist()
    for begin, end in zip(starts, [*starts[1:], len(rest)][: len(starts)], strict=True):
        if filled and filled + end - begin > most:
            count, filled = count + 1, 0
        part[rest[begin:end]] = count
        filled += end - begin
    count += bool(filled)
    while stack:
        some = stack.pop()
        if len(some) <= most:
            part[some], count = count, count + 1
            continue
        spread = np.ptp(centre[some], axis=0)
        rank = np.argsort(centre[some, spread.argmax()], kind="stable")
        stack += [some[rank[len(some) // 2 :]], some[rank[: len(some) // 2]]]
    return part


def unwrap_parts(
    method: str, parts: list[Part], seconds: float, workers: int
) -> list[tuple[np.ndarray, np.ndarray] | str]:
    """uv and faces_uv of each part by one method, or the reason why not.

    Parameters
    ----------
    method : "uvatlas" or "xatlas"
    seconds : when the time is up, what is not finished is given up
    workers : processes at once
    """
    deadline = time.monotonic() + seconds
    results: list[tuple[np.ndarray, np.ndarray] | str] = [f"not done within {seconds:.3g} s"] * len(parts)
    # Large parts first, dealt out in turn, so that the workers end together.
    order = sorted(range(len(parts)), key=lambda k: -len(parts[k].faces))
    queues = [queue for queue in (order[k::workers] for k in range(workers)) if queue]
    with tempfile.TemporaryDirectory(prefix="sira-unwrap-") as name:
        folder = Path(name)
        for number, part in enumerate(parts):
            np.savez(folder / f"in-{number}.npz", vertices=part.vertices, faces=part.faces)
        running = [_Worker(method, folder, queue) for queue in queues]
        try:
            while running and time.monotonic() < deadline:
                for worker in list(running):
                    if worker.process.poll() is None:
                        continue
                    running.remove(worker)
                    left = [k for k in worker.queue if not (folder / f"out-{k}.npz").exists()]
                    if left:
                        # The first without a result is what it died of; the others get another process.
                        results[left[0]] = worker.failure()
                        if left[1:]:
                            running.append(_Worker(method, folder, left[1:]))
                time.sleep(_POLL_S)
        finally:
            for worker in running:
                worker.process.kill()
                worker.process.wait()
        for number in range(len(parts)):
            path = folder / f"out-{number}.npz"
            if path.exists():
                with np.load(path, allow_pickle=False) as data:
                    found = np.asarray(data["uv"], np.float64), np.asarray(data["faces_uv"], np.int64)
                results[number] = _fault(*found, parts[number]) or found
    return results


class _Worker:
    """A running process and the parts it was given."""

    def __init__(self, method: str, folder: Path, queue: list[int]):
        # The package's own parent first, so that the child finds it however this process did.
        parent = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join(p for p in (parent, os.environ.get("PYTHONPATH")) if p)
        self.queue = queue
        self._log = folder / f"log-{queue[0]}.txt"
        with self._log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "sira_assets.texture.unwrap_worker", method, str(folder), *map(str, queue)],
                env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
            )

    def failure(self) -> str:
        """Why it ended, in a few words."""
        lines = self._log.read_text(errors="replace").strip().splitlines()
        return f"ended with code {self.process.returncode}" + (f" ({lines[-1][:160]})" if lines else "")


def _fault(uv: np.ndarray, faces_uv: np.ndarray, part: Part) -> str | None:
    """What is wrong with a result as a whole, if anything."""
    faces = len(part.faces)
    if faces_uv.shape != (faces, 3) or uv.ndim != 2 or not len(uv) or faces_uv.max() >= len(uv):
        return f"returned {faces_uv.shape[0]} faces of {faces}"
    if not np.isfinite(uv[faces_uv]).all():
        return f"returned {int((~np.isfinite(uv)).any(1).sum())} coordinates that are not finite"
    return None
