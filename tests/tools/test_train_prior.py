"""The training tool from scenes to a prior that loads, stopped and resumed."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"


def tool(name, *arguments):
    command = [sys.executable, str(TOOLS / f"{name}.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


def test_asks_for_scenes(tmp_path):
    done = tool("train_prior", "--out", tmp_path / "p.safetensors")
    assert done.returncode == 2
    assert "--scenes, --scans, or both" in done.stderr


@pytest.mark.parametrize("number", ["--seed=-1", "--workers=0", "--steps=0", "--appearance-steps=-3"])
def test_numbers_that_make_no_training_are_wrong_usage(tmp_path, number, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(TOOLS))
    import train_prior

    with pytest.raises(SystemExit) as ended:
        train_prior.main(["--scenes", str(tmp_path), "--out", str(tmp_path / "p.safetensors"), number])
    assert ended.value.code == 2
    assert number.split("=")[0] in capsys.readouterr().err


def test_a_folder_without_scenes_is_bad_input(tmp_path):
    done = tool("train_prior", "--scenes", tmp_path, "--out", tmp_path / "p.safetensors", "--run", tmp_path / "run")
    assert done.returncode == 3
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_from_scenes_to_a_prior(tmp_path):
    from sira_assets.fields.prior import load_prior

    folders = [tmp_path / "two", tmp_path / "one"]  # sets of heads may lie in several folders
    for folder, start, count in ((folders[0], 0, 2), (folders[1], 2, 1)):
        few = ["--views", 2, "--size", 48, "--samples", 4, "--out", folder]
        made = tool("make_scenes", "--start", start, "--count", count, *few)
        assert made.returncode == 0, made.stderr
    out = tmp_path / "p.safetensors"
    common = ["--scenes", *folders, "--out", out, "--run", tmp_path / "run", "--steps", 4, "--quiet"]
    for extra in ([], ["--resume"]):
        done = tool("train_prior", *common, "--appearance-steps", 3, "--workers", 1, *extra)
        assert done.returncode == 0, done.stderr
    prior = load_prior(out)
    assert prior.z_sdf.basis.shape == (64, 2)  # three heads span two directions
    facts = json.loads((tmp_path / "run" / "description.json").read_text())
    assert facts["scenes"] == 3
    assert facts["processes"] == 1
    other = tool("train_prior", *common, "--seed", 1, "--appearance-steps", 3, "--workers", 1, "--resume")
    assert other.returncode == 3
    assert "this very run" in other.stderr
