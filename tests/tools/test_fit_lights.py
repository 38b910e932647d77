"""The command line: lobes written, figures, the picture, exit statuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from sira_assets.scene.envmap import EnvironmentMap, read_envmap, write_envmap
from sira_assets.scene.exr import write_exr
from sira_assets.scene.sg_light import SGLight

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tool(monkeypatch):
    """`tools/fit_lights.py` as a module; scripts find each other through their own folder."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import fit_lights

    return fit_lights


@pytest.fixture
def panorama(tmp_path):
    """A grey 8 x 16 room with one lamp, as .hdr."""
    pixels = np.full((8, 16, 3), 0.2)
    pixels[2, 5] = [40.0, 30.0, 20.0]
    write_envmap(tmp_path / "room.hdr", EnvironmentMap(pixels))
    return tmp_path / "room.hdr"


def test_lobes_figures_and_the_way_back(tool, panorama, tmp_path, capsys):
    normals = np.zeros((4, 4, 3), np.float32)
    normals[1:3, 1:3] = [0, 0, 1]
    write_exr(tmp_path / "normal.exr", normals)
    wish = ["--normals", str(tmp_path / "normal.exr"), "--back", str(tmp_path / "back.exr"), "--json"]
    assert tool.main([str(panorama), "--out", str(tmp_path / "lights.json"), *wish]) == 0
    data = json.loads(capsys.readouterr().out)
    light = SGLight.from_dict(json.loads((tmp_path / "lights.json").read_text()))
    assert data["lobes"] == len(light) >= 2
    assert data["irradiance residual, RMS / mean"] <= 0.02
    assert data["on the normal map, RMS / mean"] <= 0.05
    back, env = read_envmap(tmp_path / "back.exr"), read_envmap(panorama)
    flux = [(m.radiance * m.solid_angles()[..., None]).sum((0, 1)) for m in (back, env)]
    assert flux[0] == pytest.approx(flux[1], rel=1e-5)  # float32 pixels


@pytest.mark.slow
def test_a_picture_and_a_table(tool, panorama, tmp_path, capsys):
    wish = ["--lobes", "2", "--picture", str(tmp_path / "p.png")]
    assert tool.main([str(panorama), "--out", str(tmp_path / "lights.json"), *wish]) == 0
    assert "irradiance residual" in capsys.readouterr().out
    assert (tmp_path / "p.png").stat().st_size > 10_000


@pytest.mark.slow
def test_out_of_reach_is_status_4_and_bad_input_3(tool, panorama, tmp_path, capsys):
    out = ["--out", str(tmp_path / "lights.json")]
    assert tool.main([str(panorama), *out, "--residual", "1e-5", "--max-lobes", "1"]) == 4
    assert "more than 1 lobe" in capsys.readouterr().err
    write_exr(tmp_path / "square.exr", np.ones((8, 8, 3), np.float32))
    for wrong in (
        ["square.exr"],
        ["none.exr"],
        ["room.hdr", "--residual", "-1"],
        ["room.hdr", "--normals", "room.hdr"],
    ):
        arguments = [str(tmp_path / a) if "." in a and a[0] != "-" and not a[0].isdigit() else a for a in wrong]
        assert tool.main([*arguments, *out]) == 3
        assert capsys.readouterr().err.count("\n") == 1


def test_a_folder_is_one_line(tool, tmp_path, capsys):
    assert tool.main([str(tmp_path), "--out", str(tmp_path / "lights.json")]) == 3
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "a folder" in said
