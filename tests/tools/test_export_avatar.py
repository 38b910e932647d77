"""tools/export_avatar.py: the contract of its command line, on the bundled portrait and on bad input."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sira_assets.plan.figures import write_figures
from sira_assets.scene.image import write_exr, write_png

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "scene"))
sys.path.insert(0, str(ROOT / "tests" / "plan"))
from sample_figures import figures  # noqa: E402
from scene_on_disk import HEIGHT, WIDTH, SceneOnDisk  # noqa: E402


def export(*arguments):
    command = [sys.executable, str(ROOT / "tools" / "export_avatar.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=900)


def missing(scene):
    (scene.folder / "image.png").unlink()


def empty_mask(scene):
    write_png(scene.folder / "mask.png", np.zeros((HEIGHT, WIDTH), bool))


def other_size(scene):
    write_png(scene.folder / "mask.png", np.ones((HEIGHT + 1, WIDTH), bool))


def not_finite(scene):
    pixels = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    pixels[7, 9] = np.nan
    write_exr(scene.folder / "image.exr", pixels)
    scene.frame["file_path"] = "image.exr"


def truncated(scene):
    path = scene.folder / "image.png"
    path.write_bytes(path.read_bytes()[:200])


def singular(scene):
    scene.data["fl_x"] = 0.0


def behind(scene):
    pose = np.array(scene.frame["transform_matrix"])
    scene.frame["transform_matrix"] = (pose @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()


@pytest.mark.parametrize("spoil", [missing, empty_mask, other_size, not_finite, truncated, singular, behind])
def test_bad_input_is_one_line_exit_3_and_nothing_written(tmp_path, spoil):
    folder = tmp_path / "scene"
    folder.mkdir()
    scene = SceneOnDisk(folder)
    spoil(scene)
    scene.save()
    result = export(folder, "--out", tmp_path / "out")
    assert result.returncode == 3, result.stderr
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    assert "expected" in lines[0]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene"]


def test_wrong_usage_is_exit_2():
    assert export("--quality", "perfect").returncode == 2
    assert export("--texture-size", "1").returncode == 2
    assert export("--seed", "-1").returncode == 2


def test_budgets_that_make_no_sense_are_wrong_usage():
    for words in ("soon", "0", "-5s", "60s --quality draft", "60s --texture-size 512"):
        assert export("--budget", *words.split()).returncode == 2
    refused = export("--budget", "60s", "--resume")
    assert refused.returncode == 2
    assert "cannot be gone on with" in refused.stderr


@pytest.fixture(scope="module")
def curves(tmp_path_factory):
    """A file of curves to plan with."""
    path = tmp_path_factory.mktemp("curves") / "figures.json"
    write_figures(figures(), path)
    return path


def test_a_budget_that_cannot_be_kept_is_one_line_with_the_least(tmp_path, curves):
    result = export("--budget", "1s", "--figures", curves, "--out", tmp_path / "out")
    assert result.returncode == 3, result.stderr
    assert result.stderr.startswith("error: ")
    assert len(result.stderr.strip().splitlines()) == 1
    least = float(re.search(r"(\d+) s or more", result.stderr)[1])
    assert least > 1
    assert list(tmp_path.iterdir()) == []


def test_a_dry_run_says_what_would_be_done_and_does_nothing(tmp_path, curves):
    out = tmp_path / "out"
    result = export("--budget", "3h", "--figures", curves, "--dry-run", "--json", "--out", out)
    assert result.returncode == 0, result.stderr
    plan = json.loads(result.stdout)
    assert plan["asked"] == "10800 s"
    assert 0 < plan["total_seconds"] <= 10800
    assert plan["peak_memory"] >= max(s.memory_bytes for s in figures().reference)
    assert set(plan["knobs"]) == {"geometry steps", "appearance steps", "texture size"}
    assert list(tmp_path.iterdir()) == []


def test_what_the_fit_refuses_leaves_nothing_and_json_alone_goes_to_stdout(tmp_path, curves, capsys, monkeypatch):
    from sira_assets.errors import InputError

    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import export_avatar

    def refuse(*arguments, **options):
        raise InputError(expected="light", received="none", remedy="expose")

    monkeypatch.setattr("sira_assets.pipeline.run", refuse)
    out = str(tmp_path / "out")
    plans = ["--budget", "3h", "--figures", str(curves)]
    for words, planned in (([], False), (plans, True), ([*plans, "--json"], False)):
        assert export_avatar.main([*words, "--out", out]) == 3
        said = capsys.readouterr()
        assert ("geometry" in said.out) == planned
        assert planned or said.out == ""
        assert list(tmp_path.iterdir()) == []


def test_somebodys_folder_is_not_written_over(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("years")
    result = export("--out", out)
    assert result.returncode == 3
    assert "--overwrite" in result.stderr
    assert (out / "thesis.txt").read_text() == "years"


CONTRACT = [
    "avatar.glb",
    "avatar.mtl",
    "avatar.obj",
    "envmap.exr",
    "envmap.hdr",
    "sh.json",
    "field.safetensors",
    "lights.json",
    "report.html",
    "report.json",
    *(f"renders/{n}.png" for n in ("input", "normals", "albedo", "specular", "irradiance", "final")),
    "renders/final.exr",
    *(f"textures/{n}.png" for n in ("diffuse", "specular", "normal", "irradiance")),
]


@pytest.mark.slow
def test_the_bundled_portrait_becomes_an_avatar(tmp_path):
    import trimesh

    from sira_assets.fields.fitted import load_fitted
    from sira_assets.scene.bundled import bundled_portrait
    from sira_assets.scene.exr import read_exr
    from sira_assets.scene.sg_light import SGLight

    out = tmp_path / "avatar"
    result = export("--out", out, "--quality", "draft", "--json")
    assert result.returncode == 0, result.stderr
    for name in CONTRACT:
        assert (out / name).stat().st_size > 0, name
    assert sorted(p.name for p in tmp_path.iterdir()) == ["avatar"]  # no working folder stays
    report = json.loads((out / "report.json").read_text())
    assert json.loads(result.stdout) == report
    for key in ("seconds", "peak_memory", "metrics", "decisions", "settings", "version", "seed", "metres_per_unit"):
        assert key in report
    assert report["metrics"]["final_psnr_db"] > 18.0  # half of the masked signal's power explained is about 12 dB
    portrait = bundled_portrait()
    assert read_exr(out / "renders" / "final.exr").shape == portrait.image_linear.shape
    mesh = trimesh.load(out / "avatar.glb", force="mesh", process=False)
    # A head and its shoulders, in metres, where the camera looks.
    assert 0.2 < np.ptp(mesh.vertices, axis=0).max() < 0.6
    u, depth = portrait.camera.project(np.asarray(mesh.vertices))
    assert (depth > 0).all()
    inside = portrait.mask[np.clip(u[:, 1].astype(int), 0, 511), np.clip(u[:, 0].astype(int), 0, 511)]
    assert inside.mean() > 0.4
    light = SGLight.from_dict(json.loads((out / "lights.json").read_text()))
    assert len(light) >= 1
    import torch

    assert abs(load_fitted(out / "field.safetensors").sdf(torch.zeros(1, 3))).item() < 0.1


@pytest.mark.slow
def test_a_reproducible_run_gives_the_same_bytes(tmp_path):
    from dataclasses import replace

    from small_fits import tiny_settings

    from sira_assets.delivery import deliver
    from sira_assets.pipeline import run, settings_for
    from sira_assets.scene.bundled import bundled_portrait

    unwrap = replace(tiny_settings().unwrap, methods=settings_for("draft", reproducible=True).unwrap.methods)
    settings = replace(tiny_settings(seed=3), unwrap=unwrap)
    for name in ("one", "other"):
        deliver(run(bundled_portrait(), settings), settings, tmp_path / name)
    # Reports say how many seconds it took.
    files = [p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*") if p.is_file()]
    files = [f for f in files if f.stem != "report"]
    assert len(files) > 15
    different = [str(f) for f in files if (tmp_path / "one" / f).read_bytes() != (tmp_path / "other" / f).read_bytes()]
    assert different == []
