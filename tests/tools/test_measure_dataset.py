"""Data sets survive kills, and come out the same from processes and from a Dask cluster."""

import importlib.util
import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MEASURE, MAKE = ROOT / "tools" / "measure_dataset.py", ROOT / "tools" / "make_scenes.py"
TINY = ("--size", "24", "--views", "1", "--samples", "4")


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.slow
def test_kills_at_random_moments_change_no_byte_and_leave_nothing(egg):
    line = [sys.executable, str(MEASURE), "kills", "--kills", "3", "--count", "8", *TINY, "--json", "--", "--from-scan"]
    done = subprocess.run([*line, str(egg)], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)
    assert found["differing"] == found["leftovers"] == []
    assert found["scenes"] == 8
    assert found["kills"] >= 1
    assert found["files"] > 8 * 20


def test_a_changed_byte_and_a_leftover_are_noticed(tmp_path):
    spec = importlib.util.spec_from_file_location("measure_dataset", MEASURE)
    sys.path.insert(0, str(MEASURE.parent))
    try:
        tool = importlib.util.module_from_spec(spec)
        sys.modules["measure_dataset"] = tool
        spec.loader.exec_module(tool)
    finally:
        sys.path.remove(str(MEASURE.parent))
        sys.modules.pop("measure_dataset", None)
    (tmp_path / "train_000000").mkdir()
    (tmp_path / "train_000000" / "transforms.json").write_text("{}")
    (tmp_path / ".train_000001.x.partial").mkdir()
    before = tool.contents(tmp_path)
    assert tool.scenes(tmp_path) == ["train_000000"]
    assert tool.hidden(tmp_path) == [".train_000001.x.partial"]
    (tmp_path / "train_000000" / "transforms.json").write_text("{ }")
    assert tool.contents(tmp_path) != before


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_bytes_as_processes(egg, tmp_path):
    distributed = pytest.importorskip("distributed")

    def make(out, *more):
        line = [sys.executable, str(MAKE), "--from-scan", str(egg), "--count", "3", *TINY, "--quiet", "--out", str(out)]
        return subprocess.run([*line, *more], capture_output=True, text=True, timeout=300, check=False)

    assert make(tmp_path / "processes", "--workers", "1").returncode == 0
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        done = make(tmp_path / "cluster", "--scheduler", cluster.scheduler_address)
    assert done.returncode == 0, done.stderr
    first, second = contents(tmp_path / "processes"), contents(tmp_path / "cluster")
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []


def test_a_killed_worker_is_refused_in_one_line_that_speaks_of_memory(tmp_path):
    from data_synth.dataset import write_dataset
    from data_synth.scene_settings import SceneSettings
    from sira_assets.errors import InputError

    class Deadly(SceneSettings):
        """Settings that kill the process that receives them, as a system short of memory does."""

        def __reduce__(self):
            return signal.raise_signal, (signal.SIGKILL,)

    with pytest.raises(InputError, match="killed, most likely for want of memory"):
        write_dataset(tmp_path, Deadly(), range(2), workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["train.json"]


@pytest.mark.slow
def test_a_cluster_whose_workers_are_killed_is_refused_in_the_same_words(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    import dask

    from data_synth import dask_run
    from data_synth.scene_settings import SceneSettings
    from sira_assets.errors import InputError

    monkeypatch.setattr(dask_run, "write_on_worker", lambda *arguments: signal.raise_signal(signal.SIGKILL))
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, processes=True, dashboard_address=None, silence_logs=50) as cluster,
        pytest.raises(InputError, match="killed, most likely for want of memory"),
    ):
        dask_run.run_on_dask(cluster.scheduler_address, tmp_path, SceneSettings(), [0], lambda name, seconds: None)


def test_without_dask_one_line_names_the_extra(monkeypatch, tmp_path):
    from data_synth.dask_run import run_on_dask
    from data_synth.scene_settings import SceneSettings
    from sira_assets.errors import MissingExtraError

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"sira-assets\[cluster\]") as caught:
        run_on_dask("tcp://127.0.0.1:1", tmp_path, SceneSettings(), [0], lambda name, seconds: None)
    assert "\n" not in str(caught.value)


def test_a_worker_with_another_generator_is_refused(tmp_path):
    from data_synth.dask_run import write_on_worker
    from data_synth.scene_settings import SceneSettings
    from sira_assets.errors import InputError

    with pytest.raises(InputError, match="workers with this generator"):
        write_on_worker(str(tmp_path), SceneSettings(), 0, "0" * 12)
    assert list(tmp_path.iterdir()) == []
