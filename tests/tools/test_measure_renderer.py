"""measure_renderer.py: Mitsuba gets the light it should, agrees with the generator, and notices when it should not."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.scene.sg_light import SGLight

TOOLS = Path(__file__).resolve().parents[2] / "tools"


def run_tool(name: str, *arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, str(TOOLS / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


@pytest.fixture
def tool(monkeypatch):
    """The tool as a module; its folder is on the path while a test runs, as it is for a script."""
    monkeypatch.syspath_prepend(TOOLS)
    import measure_renderer

    return measure_renderer


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    made = run_tool(
        "make_scenes.py", "--count", 1, "--out", folder, "--views", 1, "--size", 40, "--workers", 1, "--quiet"
    )
    assert made.returncode == 0, made.stderr
    return folder


def test_mitsuba_sees_the_lobes_where_and_as_bright_as_they_are(tool):
    mi = tool.load_mitsuba(1)
    light = SGLight([[0.3, 0.5, 0.8], [-0.7, -0.2, 0.4]], [140.0, 3.0], [[2.0, 1.0, 0.5], [0.3, 0.4, 0.5]])
    height = tool.map_height(140.0)
    sky = mi.load_dict({"type": "envmap", "bitmap": tool.light_bitmap(mi, light, height)})
    around = light.axis[0] + np.random.default_rng(0).normal(0.0, 0.15, (200, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    point, seen = mi.SurfaceInteraction3f(), []
    for w in around:
        point.wi = mi.Vector3f(*(-w).tolist())
        seen.append(np.array(sky.eval(point)).ravel())
    # Bilinear lookup with 6 rows to a deviation is off by at most 1 / (4 * 6^2) = 0.7 % of the peak, 2 here.
    np.testing.assert_allclose(seen, light.radiance(around), atol=0.007 * 2.0)


def test_a_lobe_no_map_resolves_is_refused(tool):
    assert tool.map_height(1.0) == 256
    assert tool.map_height(800.0) == 1024
    with pytest.raises(InputError, match="sharpness"):
        tool.map_height(1e5)


def test_without_scenes_or_without_mitsuba_one_line_says_so(tmp_path):
    empty = run_tool("measure_renderer.py", tmp_path)
    assert empty.returncode == 3
    assert "make_scenes.py" in empty.stderr
    hidden = (
        f"import sys; sys.modules['mitsuba'] = None; sys.path.insert(0, {str(TOOLS)!r}); "
        f"import measure_renderer; sys.exit(measure_renderer.main([{str(tmp_path)!r}]))"
    )
    without = subprocess.run([sys.executable, "-c", hidden], capture_output=True, text=True, timeout=120, check=False)
    assert without.returncode == 3
    assert without.stderr.strip() == "error: mitsuba is not installed; it comes with: pip install 'sira-assets[dev]'"


@pytest.mark.slow
def test_a_made_scene_agrees(scenes):
    done = run_tool("measure_renderer.py", scenes, "--samples", 1024, "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout)
    (scene,) = figures["scenes"]
    assert figures["worst_db"] == scene["psnr_db"] >= 38.0
    # Noise has no bias: 1 % is several times what 64 and 1024 samples leave in the mean of some 500 pixels.
    assert abs(scene["bias"]) < 0.01


@pytest.mark.slow
def test_another_light_and_other_sampling_are_noticed(scenes, tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(next(p for p in scenes.iterdir() if p.is_dir()), scene)
    lights = scene / "gt" / "lights.json"
    light = SGLight.from_dict(json.loads(lights.read_text()))
    lights.write_text(json.dumps(light.rotated(np.diag([-1.0, 1.0, -1.0])).to_dict()))
    wrong = run_tool("measure_renderer.py", scene, "--samples", 64)
    assert wrong.returncode == 4, wrong.stdout + wrong.stderr
    assert "BELOW 38 dB" in wrong.stdout
    provenance = scene / "gt" / "provenance.json"
    data = json.loads(provenance.read_text())
    data["settings"]["supersample"] = 4
    provenance.write_text(json.dumps(data))
    refused = run_tool("measure_renderer.py", scene)
    assert refused.returncode == 3
    assert "--supersample 1" in refused.stderr


@pytest.mark.slow
def test_the_curve_rises_with_the_samples(scenes):
    done = run_tool("measure_renderer.py", scenes, "--curve", "--json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert [row["samples"] for row in rows] == [16, 32, 64, 128, 256]
    # Independent samples gain 3 dB from one to the next, 12 dB over all; stratified ones more.
    assert rows[-1]["diffuse dB"] - rows[0]["diffuse dB"] > 12.0
    assert rows[-1]["picture dB"] - rows[0]["picture dB"] > 12.0
