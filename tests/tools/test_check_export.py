"""tools/check_export.py: other programs agree on what we write, and it says so when they do not."""

import dataclasses
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "tests" / "asset")]

import check_export  # noqa: E402
from sample_avatar import avatar_of, shaded_maps  # noqa: E402

from sira_assets.asset.export_config import ExportConfig  # noqa: E402
from sira_assets.asset.write_avatar import write_avatar  # noqa: E402
from sira_assets.scene.camera import Camera  # noqa: E402


def camera() -> Camera:
    """In front of the sample, its principal point off the middle."""
    pose = np.array([[0.0, 0, -1, 3.0], [1, 0, 0, -1.0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
    return Camera(np.array([[280.0, 0, 45], [0, 280.0, 36], [0, 0, 1]]), pose, 80, 80)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    import importlib.util

    folder = tmp_path_factory.mktemp("export")
    avatar = dataclasses.replace(avatar_of(shaded_maps()), camera=camera())
    write_avatar(avatar, folder, ExportConfig(usd=importlib.util.find_spec("pxr") is not None))
    return folder


@pytest.fixture(autouse=True)
def _only_programs_of_this_python(request, monkeypatch):
    if "blender" not in request.node.name:
        monkeypatch.delenv("SIRA_BLENDER", raising=False)
    monkeypatch.delenv("SIRA_GLTF_VALIDATOR", raising=False)


def checked(capsys, *arguments) -> tuple[int, dict]:
    status = check_export.main([*map(str, arguments), "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_programs_of_other_people_agree(folder, capsys):
    status, found = checked(capsys, folder)
    assert status == 0
    read = {(r["program"], r["file"]) for r in found["readings"]}
    assert {("trimesh", "avatar.glb"), ("open3d", "avatar.glb"), ("trimesh", "avatar.obj")} <= read
    for row in found["readings"]:
        # float32 of coordinates some twenty times the head's size.
        assert row["box_error"] < 1e-6
        assert row["volume_ratio"] == pytest.approx(1, abs=1e-6)
        assert row["colour_error"] < 0.5


def spoil_flip(folder):
    path = folder / "textures" / "diffuse.png"
    with Image.open(path) as picture:
        flipped = np.array(picture)[::-1]
    Image.fromarray(flipped).save(path)


def spoil_axis(folder):
    path = folder / "avatar.obj"
    turned = []
    for line in path.read_text().splitlines():
        word = line.split()
        turned.append(" ".join(["v", word[1], word[3], word[2]]) if word[:1] == ["v"] else line)
    path.write_text("\n".join(turned) + "\n")


def spoil_unit(folder):
    path = folder / "avatar.obj"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(x if x[:2] != "v " else "v " + " ".join(f"{1000 * float(c):.9g}" for c in x.split()[1:])
                              for x in lines) + "\n")  # fmt: skip


@pytest.mark.parametrize("spoil", [spoil_flip, spoil_axis, spoil_unit])
def test_a_file_that_says_something_else_is_found(spoil, tmp_path, capsys):
    write_avatar(avatar_of(shaded_maps()), tmp_path)
    spoil(tmp_path)
    status, found = checked(capsys, tmp_path)
    assert status == 4
    assert {r["file"] for r in found["readings"] if not r["agrees"]} == {"avatar.obj"}


def test_a_quantised_file_is_left_to_programs_that_know_the_extension(tmp_path, capsys):
    write_avatar(avatar_of(shaded_maps()), tmp_path, ExportConfig(quantise=True))
    status, found = checked(capsys, tmp_path)
    assert status == 0
    assert "avatar.glb" not in {r["file"] for r in found["readings"]}
    assert found["extensions_required"] == ["KHR_mesh_quantization"]


def test_an_avatar_without_obj_is_read_by_what_is_there(tmp_path, capsys):
    write_avatar(avatar_of(shaded_maps()), tmp_path)
    (tmp_path / "avatar.obj").unlink()
    status, found = checked(capsys, tmp_path)
    assert status == 0
    assert {r["file"] for r in found["readings"]} == {"avatar.glb"}


def test_what_is_no_blender_is_said_in_its_own_last_words(folder, tmp_path, capsys):
    program = tmp_path / "blender"
    program.write_text("#!/bin/sh\necho first >&2\necho cannot start >&2\nexit 1\n")
    program.chmod(0o755)
    assert check_export.main([str(folder), "--blender", str(program)]) == 3
    assert "; received cannot start; " in capsys.readouterr().err
    program.write_text("#!/bin/sh\nexit 7\n")
    assert check_export.main([str(folder), "--blender", str(program)]) == 3
    assert "; received exit status 7; " in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--size", "--samples", "--threads"])
def test_numbers_below_one_are_usage_errors(option, capsys):
    with pytest.raises(SystemExit) as end:
        check_export.main(["avatar", option, "0"])
    assert end.value.code == 2
    assert option in capsys.readouterr().err


def test_a_folder_that_holds_no_avatar_is_refused(tmp_path, capsys):
    assert check_export.main([str(tmp_path)]) == 3
    assert "avatar.glb" in capsys.readouterr().err


@pytest.mark.slow
def test_blender_agrees_and_draws_what_we_draw(folder, tmp_path, capsys):
    if not os.environ.get("SIRA_BLENDER"):
        pytest.skip("needs SIRA_BLENDER naming Blender, or a Python with bpy")
    status, found = checked(capsys, folder, "--picture", tmp_path / "sheet.png", "--size", 80, "--samples", 64)
    assert status == 0
    drawn = {r["file"]: r for r in found["readings"] if "render_psnr_db" in r}
    # Cycles' noise at 64 samples, its multiple-scattering GGX and separable Fresnel, against our closed form.
    assert drawn["avatar.glb"]["render_psnr_db"] > 34
    assert any("Non-Color" in line for line in drawn["avatar.glb"]["pictures"] if line.startswith("Normal"))
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.size == (80 * (1 + len(drawn)), 80)
