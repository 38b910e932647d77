"""The command line: figures, JSON, exit statuses, one line for the user's mistakes."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tool(monkeypatch):
    """`tools/eval_chamfer.py` as a module; scripts find each other through their own folder."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import eval_chamfer

    return eval_chamfer


@pytest.fixture
def balls(tmp_path):
    """(prediction of radius 102 mm in metres, truth of radius 100 mm in millimetres, landmarks of the truth)."""
    trimesh.creation.icosphere(subdivisions=4, radius=0.102).export(tmp_path / "pred.ply")
    trimesh.creation.icosphere(subdivisions=4, radius=100.0).export(tmp_path / "gt.stl")
    marks = tmp_path / "marks.json"
    marks.write_text(json.dumps({"gt": {"nose_tip": [0, 0, 100], "chin": [0, -80, 60], "mouth_left": [20, -40, 89]}}))
    return tmp_path / "pred.ply", tmp_path / "gt.stl", marks


def test_json_names_every_choice_and_converts_units(tool, balls, capsys):
    pred, gt, marks = map(str, balls)
    arguments = [pred, gt, "--units-gt", "mm", "--units-pred", "m", "--landmarks", marks, "--samples", "4000", "--json"]
    assert tool.main(arguments) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["protocol"] == "surface"
    assert {"alignment", "distance", "region", "samples", "inner surfaces", "unit"} <= data["choices"].keys()
    faces = [m for m in data["measured"] if (m["region"], m["direction"]) == ("face", "gt to pred")]
    assert faces[0]["distances"]["mean_mm"] == pytest.approx(2.0, abs=0.2)  # less the sagitta of level 4, 0.1 mm


def test_table_and_region(tool, balls, capsys):
    pred, gt, marks = map(str, balls)
    assert tool.main([pred, gt, "--units-gt", "mm", "--units-pred", "m", "--landmarks", marks, "--region", "face"]) == 0
    out = capsys.readouterr().out
    assert "point to triangle" in out
    assert "face" in out
    assert "all  " not in out.split("protocol:")[0]


def test_a_failed_alignment_has_its_own_status(tool, balls, capsys):
    pred, gt, _ = map(str, balls)
    # Millimetres taken for metres: the scale that would mend it is no head's.
    assert tool.main([pred, gt, "--units-pred", "mm", "--units-gt", "mm", "--align", "similarity"]) == 4
    assert "alignment failed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda folder: ["nothing.ply", "gt.stl"], "no such file"),
        (lambda folder: ["broken.ply", "gt.stl"], "a triangle mesh in broken.ply"),
        (lambda folder: ["pred.ply", "."], "avatar.glb, gt/mesh.ply or mesh.ply"),
        (lambda folder: ["pred.ply", "gt.stl", "--region", "face"], "nose tip"),
        (lambda folder: ["pred.ply", "gt.stl", "--protocol", "now"], "nose base"),
        (lambda folder: ["pred.ply", "gt.stl", "--landmarks", "none.json"], "no such file"),
        (lambda folder: ["pred.ply", "gt.stl", "--pred-frame", "canonical"], "canonical_from_world"),
    ],
)
def test_mistakes_are_one_line_and_status_3(tool, balls, tmp_path, monkeypatch, capsys, make, expected):
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    monkeypatch.chdir(tmp_path)
    assert tool.main(make(tmp_path)) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert expected in error


def test_wrong_usage_is_status_2(tool, capsys):
    for arguments in ([], ["a.ply", "b.ply", "--region", "ear"], ["a.ply", "b.ply", "--samples", "0"]):
        with pytest.raises(SystemExit) as stop:
            tool.main(arguments)
        assert stop.value.code == 2
    capsys.readouterr()


def test_help_does_not_import_the_heavy_libraries():
    for name in ("eval_chamfer", "eval_avatar"):
        code = f"import sys; sys.path.insert(0, 'tools'); import {name}; {name}.parser().format_help(); "
        code += "print([m for m in ('numpy', 'open3d', 'trimesh', 'torch', 'scipy') if m in sys.modules])"
        start = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "[]"
        assert time.perf_counter() - start < 10  # seconds; a bare interpreter on a busy machine


@pytest.mark.slow
def test_mean_head_from_the_command_line(real_data, tool, capsys):
    mean, scene = str(real_data / "heads" / "ict_mean"), str(real_data / "scenes" / "james_soft")
    assert tool.main([mean, scene, "--pred-frame", "canonical", "--json", "--samples", "20000"]) == 0
    data = json.loads(capsys.readouterr().out)
    found = {(m["region"], m["direction"], m["seen"]): m["distances"] for m in data["measured"]}
    # 3,000 samples on the face with a std of 1.5 mm: two sigma are 0.05 mm.
    assert found["face", "gt to pred", "any"]["mean_mm"] == pytest.approx(1.58, abs=0.06)
    assert np.isfinite(found["face", "gt to pred", "seen"]["mean_mm"])
