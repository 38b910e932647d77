"""Scenes on many machines: a Dask cluster whose workers share the output's file system."""

from collections.abc import Callable
from pathlib import Path

from data_synth.scene_settings import SceneSettings, generator_fingerprint
from sira_assets.errors import InputError, MissingExtraError

CONNECT_SECONDS = 20


def run_on_dask(
    address: str, out: Path, settings: SceneSettings, indices: list[int], on_scene: Callable[[str, float], None]
) -> None:
    """Write the scenes of `indices` by the workers of the scheduler at `address`; same bytes as by processes here.

    Parameters
    ----------
    address : as Dask gives it, such as tcp://10.0.0.1:8786
    out : absolute; every worker must see it, and a scan's files, under the same path

    Raises
    ------
    MissingExtraError : Dask is not installed.
    InputError : no scheduler or no worker answers, or a worker cannot see `out`, has another generator or was killed
        over and over.
    """
    from data_synth.dataset import killed_worker

    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError:
        raise MissingExtraError("dask[distributed]", "cluster") from None
    try:
        client = Client(address, timeout=CONNECT_SECONDS)
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise InputError(
            expected=f"a Dask scheduler with workers at {address}",
            received=str(error) or type(error).__name__,
            remedy="start one with: dask scheduler, and workers with: dask worker ADDRESS --nthreads 1",
        ) from None
    with client:
        futures = [
            client.submit(write_on_worker, str(out), settings, index, generator_fingerprint(), pure=False, retries=2)
            for index in indices
        ]
        try:
            for _, result in as_completed(futures, with_results=True):
                on_scene(*result)
        except BaseException as error:
            client.cancel(futures, force=True)
            if isinstance(error, KilledWorker):
                raise killed_worker() from None
            raise


def write_on_worker(out: str, settings: SceneSettings, index: int, generator: str) -> tuple[str, float]:
    """One scene, in a worker: one thread, as in `data_synth.dataset`, so that sums are taken in the same order."""
    from data_synth.dataset import write_one
    from data_synth.one_thread import one_thread

    if not Path(out).is_dir() or generator_fingerprint() != generator:
        raise InputError(
            expected=f"workers with this generator ({generator}) that see {out}",
            received=f"generator {generator_fingerprint()}, folder {'seen' if Path(out).is_dir() else 'not seen'}",
            remedy="share the folder and the code between the machines",
        )
    import torch  # noqa: F401 - held to one thread only where it is loaded

    return one_thread(write_one)(Path(out), settings, index)
