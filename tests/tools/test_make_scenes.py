"""make_scenes.py: same bytes however it is run, resumes, refuses what makes no sense."""

import importlib
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "make_scenes.py"
SMALL = ("--views", "2", "--size", "32", "--samples", "8", "--quiet")


def make_scenes(*arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, str(TOOL), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOL.parent))
    return importlib.import_module("make_scenes")


@pytest.mark.slow
def test_bytes_do_not_depend_on_workers_order_or_resumption(egg, tmp_path):
    scan = ("--from-scan", egg, *SMALL)
    at_once, in_parts = tmp_path / "at_once", tmp_path / "in_parts"
    assert make_scenes("--count", 3, "--out", at_once, "--workers", 2, *scan).returncode == 0
    assert make_scenes("--count", 1, "--start", 2, "--out", in_parts, "--workers", 1, *scan).returncode == 0
    written = (in_parts / "egg_000002" / "image.exr").stat().st_mtime_ns
    assert make_scenes("--count", 3, "--out", in_parts, "--workers", 1, *scan).returncode == 0
    assert (in_parts / "egg_000002" / "image.exr").stat().st_mtime_ns == written
    first, second = contents(at_once), contents(in_parts)
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []
    assert len({bytes(v) for k, v in first.items() if k.endswith("gt/mesh.ply")}) == 3, "each in its own pose"
    assert json.loads(first["datasheet.json"])["scenes"] == 3


@pytest.mark.slow
def test_another_process_draws_the_same_heads(tmp_path):
    from data_synth.draw_scene import draw_scene
    from data_synth.scene_settings import SceneSettings
    from data_synth.write_scene import write_scene

    settings = ("--count", 1, "--start", 1, "--out", tmp_path, "--workers", 1, *SMALL)
    assert make_scenes(*settings).returncode == 0
    # After another head, with the caches warm.
    wanted = SceneSettings(views=2, size=32, samples=8)
    folders = [tmp_path / f"here_{index}" for index in (0, 1)]
    for index, folder in enumerate(folders):
        write_scene(draw_scene(wanted, index), folder)
    there, here = contents(tmp_path / "train_000001"), contents(folders[1])
    assert there.keys() == here.keys()
    assert [name for name in here if here[name] != there[name]] == []
    assert contents(folders[0])["gt/mesh.ply"] != here["gt/mesh.ply"]


@pytest.mark.slow
def test_gaussians_of_a_panorama_do_not_depend_on_the_number_of_threads(tool, tmp_path):
    import numpy as np
    import torch
    from threadpoolctl import threadpool_limits

    from sira_assets.scene.envmap import EnvironmentMap, write_envmap

    sky = np.random.default_rng(0).gamma(0.3, 1.0, (24, 48, 3)).astype(np.float32)
    sky[5, 7] += 200.0
    write_envmap(tmp_path / "sky.exr", EnvironmentMap(sky))
    before, lights, left = torch.get_num_threads(), [], []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            with threadpool_limits(threads):
                lights.append(tool.panorama_file(tmp_path / "sky.exr", quiet=True).lights)
                left.append(torch.get_num_threads())
    finally:
        torch.set_num_threads(before)
    assert lights[0] == lights[1]
    assert left == [1, 2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scan-texture", "x.png"), "--from-scan MESH with --scan-texture"),
        (("--scan-pieces", "all"), "--from-scan MESH with --scan-pieces"),
        (("--metres-per-unit", "0"), "--from-scan MESH with --metres-per-unit"),
        (("--from-scan", "EGG", "--kind", "eval"), "either --kind or --from-scan"),
        (("--from-scan", "nowhere.ply"), "no such file"),
        (("--from-scan", "EGG", "--scan-name", "a/b"), "a name of letters"),
        (("--from-scan", "EGG", "--metres-per-unit", "-1"), "a positive --metres-per-unit"),
        (("--from-scan", "EGG", "--metres-per-unit", "0.001"), "would fit a mean head"),
    ],
)
def test_scans_that_cannot_be_used_end_with_3_and_one_line(egg, tmp_path, arguments, words):
    line = [str(egg) if a == "EGG" else a for a in arguments]
    result = make_scenes("--count", 1, "--out", tmp_path / "out", *line)
    assert result.returncode == 3
    assert len(result.stderr.strip().splitlines()) == 1
    assert words in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_ctrl_c_exits_with_130_and_leaves_only_whole_scenes(tmp_path):
    command = [sys.executable, str(TOOL), "--count", "50", "--out", str(tmp_path), "--workers", "1", *SMALL]
    # A test runner started in the background has SIGINT ignored, which a child inherits.
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    begun = time.monotonic()
    while not (tmp_path / "train.json").exists() and time.monotonic() - begun < 120:
        time.sleep(0.2)
    time.sleep(3.0)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    for folder in tmp_path.glob("train_*"):
        assert (folder / "transforms.json").exists()


@pytest.mark.parametrize(
    "arguments",
    [("--count", 0), ("--count", 1, "--size", 4), ("--count", 1, "--supersample", 3), ("--count", 1, "--workers", 0)],
)
def test_senseless_numbers_end_with_3_and_one_line(tmp_path, arguments):
    result = make_scenes(*arguments, "--out", tmp_path / "out")
    assert result.returncode == 3
    assert len(result.stderr.strip().splitlines()) == 1
    assert result.stderr.startswith("error: expected")
    assert not (tmp_path / "out").exists()


def test_a_folder_begun_with_other_settings_is_refused(tmp_path):
    from data_synth.dataset import write_dataset
    from data_synth.scene_settings import SceneSettings
    from sira_assets.errors import InputError

    assert write_dataset(tmp_path, SceneSettings(views=2), range(0)) == 0
    with pytest.raises(InputError, match="views 2"):
        write_dataset(tmp_path, SceneSettings(views=3), range(1))


@pytest.mark.parametrize("content", ["", "[1, 2]", "{", "\0"])
def test_damaged_settings_of_a_folder_are_refused_in_one_line(tmp_path, content):
    from data_synth.dataset import claim_folder
    from data_synth.scene_settings import SceneSettings
    from sira_assets.errors import InputError

    (tmp_path / "train.json").write_text(content)
    with pytest.raises(InputError, match=r"train\.json"):
        claim_folder(tmp_path, SceneSettings())
    assert (tmp_path / "train.json").read_text() == content


@pytest.mark.parametrize("name", ["train_000000", "train_000000/notes"])
def test_what_is_no_scene_under_a_scenes_name_is_refused(tmp_path, name):
    from data_synth.dataset import write_dataset
    from data_synth.scene_settings import SceneSettings
    from sira_assets.errors import InputError

    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).touch()
    with pytest.raises(InputError, match="a scene, or nothing"):
        write_dataset(tmp_path, SceneSettings(), range(1))
    assert (tmp_path / name).is_file()


@pytest.mark.slow
def test_an_empty_folder_under_a_scenes_name_becomes_the_scene(egg, tmp_path):
    (tmp_path / "egg_000000").mkdir()
    result = make_scenes("--count", 1, "--out", tmp_path, "--from-scan", egg, "--preview", "--workers", 1, *SMALL)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "egg_000000" / "transforms.json").is_file()
    assert (tmp_path / "preview.png").is_file()


def test_train_and_eval_may_share_a_folder_but_never_a_random_stream(tmp_path):
    import numpy as np

    from data_synth.dataset import write_dataset
    from data_synth.scene_settings import SceneSettings, scene_name

    kinds = ("train", "eval")
    for kind in kinds:
        write_dataset(tmp_path, SceneSettings(kind=kind), range(0))
    names = {scene_name(SceneSettings(kind=kind), 3) for kind in kinds}
    assert names == {"train_000003", "eval_000003"}
    draws = [np.random.default_rng(SceneSettings(kind=kind).stream(3)).integers(1 << 62) for kind in kinds]
    assert draws[0] != draws[1]


def test_help_is_instant():
    begin = time.perf_counter()
    result = subprocess.run(
        [sys.executable, "-X", "importtime", str(TOOL), "--help"], capture_output=True, text=True, check=True
    )
    assert "--supersample" in result.stdout
    # Whatever the machine's load, nothing heavy may be imported for it.
    for heavy in ("numpy", "torch", "open3d", "rich"):
        assert f"| {heavy}\n" not in result.stderr.replace("|   ", "| ")
    assert time.perf_counter() - begin < 30
