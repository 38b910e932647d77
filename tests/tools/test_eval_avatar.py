"""The command line of the avatar's figures."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tool(monkeypatch):
    """`tools/eval_avatar.py` as a module."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    monkeypatch.syspath_prepend(str(ROOT / "tests" / "measure"))
    import eval_avatar

    return eval_avatar


@pytest.mark.parametrize("what", ["none", "broken"])
def test_mistakes_are_one_line_and_status_3(tool, tmp_path, capsys, what):
    if what == "broken":
        (tmp_path / "avatar.glb").write_bytes(b"glTF")
    assert tool.main([str(tmp_path), str(tmp_path)]) == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "remedy" not in error
    assert "avatar.glb" in error


@pytest.mark.slow
def test_true_head_prints_tables_and_json(real_data, tool, tmp_path, capsys):
    from test_avatar_metrics import make_avatar

    from sira_assets.measure.truth import read_truth

    scene = real_data / "scenes" / "ict_d_soft"
    truth = read_truth(scene)
    make_avatar(tmp_path, scene, truth.mesh, truth.camera)
    assert tool.main([str(tmp_path), str(scene), "--samples", "5000", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["mask_iou"] > 0.999
    assert {p["what"] for p in data["pictures"]} == {"diffuse", "specular", "final"}
    assert data["placed"]["choices"]["alignment"] == "none, as given"
    assert tool.main([str(tmp_path), str(scene), "--samples", "2000"]) == 0
    assert "flat colour" in capsys.readouterr().out
