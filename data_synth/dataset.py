"""Write many scenes: in parallel, resumably, by processes here or by machines through Dask.

Notation: a scene is a function of the settings and its index alone, so that worker counts, order and interruptions
leave every byte as it is. What stands under a scene's own name is whole; what is being written starts with a dot.
"""

import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path

from data_synth.draw_scene import draw_scene
from data_synth.scene_settings import SceneSettings, scene_name
from data_synth.write_scene import is_whole, remove_partials, write_scene
from sira_assets.atomic import write_text
from sira_assets.errors import InputError
from sira_assets.scene.landmarks import read_json

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def write_dataset(
    out: str | os.PathLike,
    settings: SceneSettings,
    indices: Sequence[int],
    *,
    workers: int = 1,
    scheduler: str | None = None,
    on_scene: Callable[[str, float], None] = lambda name, seconds: None,
) -> int:
    """Write the scenes of `indices` that `out` does not hold yet.

    Parameters
    ----------
    workers : processes, one thread each
    scheduler : address of a Dask scheduler that runs the scenes instead; its workers must see `out`, and a scan's
        files, under the same paths
    on_scene : called with each scene's name and seconds as it is done (0 seconds for those already there)

    Returns
    -------
    Number of scenes newly written.

    Raises
    ------
    InputError : `out` holds a data set made with other settings, or something else under a scene's name; workers < 1;
        a worker was killed.
    """
    out = Path(out).resolve()
    if workers < 1:
        raise InputError(expected="at least one worker", received=f"{workers}", remedy="use --workers 1 or more")
    claim_folder(out, settings)
    there = {index: _is_there(out / scene_name(settings, index)) for index in indices}
    missing = [index for index in indices if not there[index]]
    for index in indices:
        if there[index]:
            on_scene(scene_name(settings, index), 0.0)
    if missing and scheduler is not None:
        from data_synth.dask_run import run_on_dask

        run_on_dask(scheduler, out, settings, missing, on_scene)
    elif missing:
        try:
            _run_in_processes(out, settings, missing, workers, on_scene)
        except BrokenProcessPool:
            raise killed_worker() from None
    remove_leftovers(out, settings, indices)
    return len(missing)


def _is_there(folder: Path) -> bool:
    """Whether a scene stands at `folder`; InputError where something else does."""
    if is_whole(folder):
        return True
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise InputError(
            expected=f"a scene, or nothing, at {folder}",
            received="a folder without transforms.json" if folder.is_dir() else "a file",
            remedy="move it away, or give another --out",
        )
    return False


def killed_worker() -> InputError:
    """What to say of a worker that ended before its scene did."""
    return InputError(
        expected="workers that live until their scenes are written",
        received="one that was killed, most likely for want of memory",
        remedy="use fewer --workers, fewer --views or a smaller --size: what is whole stays",
    )


def _run_in_processes(out: Path, settings: SceneSettings, missing: list[int], workers: int, on_scene) -> None:
    with _pool(min(workers, len(missing))) as pool:
        pending, queue = set(), iter(missing)
        while True:
            for index in queue:
                pending.add(pool.submit(write_one, out, settings, index))
                if len(pending) >= 2 * workers:
                    break
            if not pending:
                return
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                on_scene(*future.result())


def claim_folder(out: Path, settings: SceneSettings) -> None:
    """Say in `out` how its scenes of this kind are made.

    Raises
    ------
    InputError : they are made in another way, or what is said cannot be read.
    """
    path, wanted = out / f"{settings.named()}.json", settings.described()
    if not path.exists():
        write_text(path, json.dumps(wanted, indent=1) + "\n")
        return
    held = read_json(path)
    if not isinstance(held, dict):
        raise InputError(
            expected=f"a data set's settings in {path}",
            received="other JSON",
            remedy="move it away if it is another file, or give another --out",
        )
    if held != wanted:
        differing = ", ".join(f"{k} {held.get(k)}" for k, v in wanted.items() if held.get(k) != v)
        raise InputError(
            expected=f"the settings that {out} was begun with ({differing})",
            received="others",
            remedy="give the same, or another --out"
            + (" (the generator's code has changed since)" if held.get("generator") != wanted["generator"] else ""),
        )


def remove_leftovers(out: Path, settings: SceneSettings, indices: Sequence[int]) -> None:
    """Remove what killed runs had begun of this data set's own files, and of these scenes where they are whole by now.

    Two runs may share scenes; one that ends while another writes such a file of its own takes it away.
    """
    for index in indices:
        remove_partials(out / scene_name(settings, index))
    for pattern in (f".{settings.named()}-*.json", ".datasheet-*", ".preview-*.png"):
        for path in out.glob(pattern):
            path.unlink(missing_ok=True)


def write_one(out: Path, settings: SceneSettings, index: int) -> tuple[str, float]:
    """Draw and write one scene; its name and the seconds it took."""
    begin, name = time.perf_counter(), scene_name(settings, index)
    write_scene(draw_scene(settings, index), out / name)
    return name, time.perf_counter() - begin


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes with one thread each; on any error, Ctrl-C included, they are stopped at once."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    others = set(multiprocessing.active_children())
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_follow_parent)
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        pool.shutdown(wait=True, cancel_futures=True)
        raise
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end when the parent does, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
