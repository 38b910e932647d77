"""The tools that draw and measure the generator's heads refuse what they cannot use in one line."""

import importlib
import json
from pathlib import Path

import pytest

from sira_assets.errors import InputError
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tool(monkeypatch):
    """A function of a tool's name that gives it as a module."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module


@pytest.mark.parametrize(
    ("name", "option"), [("draw_heads", "--seed"), ("draw_heads", "--first"), ("measure_generator", "--seed")]
)
def test_a_negative_seed_or_index_is_wrong_usage(tool, capsys, name, option):
    with pytest.raises(SystemExit) as caught:
        tool(name).main([option, "-1"])
    assert caught.value.code == 2
    assert f"{option} " in capsys.readouterr().err.splitlines()[-1]


@pytest.fixture
def in_two_units(egg, tmp_path) -> Path:
    """A head in metres with landmarks in millimetres."""
    (tmp_path / "mesh.ply").write_bytes(egg.read_bytes())
    points = {name: [1e3 * x for x in point] for name, point in CANONICAL_LANDMARKS_M.items()}
    (tmp_path / "landmarks.json").write_text(json.dumps({"landmarks_m": points}))
    return tmp_path


def test_landmarks_in_another_unit_than_the_mesh_are_refused(tool, in_two_units, capsys):
    assert tool("fit_generator").main([str(in_two_units)]) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "mm off (median)" in error
    with pytest.raises(InputError, match="mm off"):
        tool("measure_generator").mean_face_mm(in_two_units)
