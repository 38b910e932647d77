"""tools/measure_export.py finds nothing torn, and would see it if there were."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tools"))

import measure_export  # noqa: E402


def measured(*arguments):
    command = [sys.executable, str(ROOT / "tools" / "measure_export.py"), *arguments, "--json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stdout + run.stderr
    return json.loads(run.stdout)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("what", ["kills", "full"])
def test_an_export_is_whole_or_absent(what):
    for found in measured(what, "--trials", "6"):
        assert found["torn"] == found["mixed"] == found["missing"] == 0
        assert found["trials"] == 6
        if what == "full":
            assert found["refused"] + found["writes"] == 6
            assert found["hidden"] == 0


def test_faults_are_seen(tmp_path):
    truth = ({"a": b"one", "b/c": b"two"}, {"a": b"1", "b/c": b"2"})
    made = measure_export.Bench((), None, truth, tmp_path)
    assert made.faults(whole=True) == (0, 0, 2)
    (made.target / "b").mkdir(parents=True)
    (made.target / "a").write_bytes(b"one")
    (made.target / "b" / "c").write_bytes(b"two")
    (made.target / "b" / ".c-x").write_bytes(b"t")
    assert made.faults(whole=True) == (0, 0, 0)
    (made.target / "b" / "c").write_bytes(b"2")
    assert made.faults(whole=True) == (0, 1, 0)
    assert made.faults(whole=False) == (0, 0, 0)
    (made.target / "b" / "c").write_bytes(b"t")
    assert made.faults(whole=False) == (1, 0, 0)
    (tmp_path / ".avatar-x").mkdir()
    (tmp_path / ".avatar-x" / ".inner").touch()
    assert measure_export.leftovers(tmp_path) == 2
    assert measure_export.leftovers(tmp_path) == 0


def test_a_large_disk_is_not_filled(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(measure_export, "MAX_DISK", 1)
    assert measure_export.main(["full", "--folder", str(tmp_path)]) == 3
    assert "small" in capsys.readouterr().err
