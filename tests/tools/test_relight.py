"""tools/relight.py: the contract of its command line on a small avatar, and on bad input."""

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sira_assets.asset.gltf import write_glb
from sira_assets.relight import movie, turntable
from sira_assets.scene.camera import Camera
from sira_assets.scene.exr import read_exr
from sira_assets.scene.image import read_image

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "asset"))
sys.path.append(str(ROOT / "tools"))
import relight  # noqa: E402
from sample_avatar import WORLD_FROM_CANONICAL, avatar_of, smooth_maps  # noqa: E402


@pytest.fixture(scope="module")
def avatar(tmp_path_factory) -> Path:
    """An exported folder with a portrait camera of 24 x 24 pixels, in front of the head in its turned world."""
    head = np.eye(4)
    head[:3, :3] = WORLD_FROM_CANONICAL[:3, :3] / 1.3 @ np.diag([1.0, -1.0, -1.0])
    head[:3, 3] = (WORLD_FROM_CANONICAL @ [0, 0, 1.0, 1])[:3]
    camera = Camera(np.array([[90.0, 0, 12], [0, 90, 12], [0, 0, 1]]), head, 24, 24)
    folder = tmp_path_factory.mktemp("avatar")
    write_glb(dataclasses.replace(avatar_of(smooth_maps()), camera=camera), folder / "avatar.glb")
    return folder


def run(*arguments) -> int:
    return relight.main([*map(str, arguments), "--quiet"])


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.array(picture)


def test_a_still_in_each_form(avatar, tmp_path):
    assert run(avatar, "--out", tmp_path / "a.png") == 0
    assert run(avatar / "avatar.glb", "--out", tmp_path / "a.exr") == 0
    assert run(avatar, "--out", tmp_path / "both") == 0
    picture = pixels(tmp_path / "a.png")
    assert picture.shape == (24, 24, 3)
    assert picture[12, 12].max() > 0
    assert picture[0, 0].max() == 0
    assert run(avatar, "--framed", "--size", 32, "--out", tmp_path / "f.png") == 0
    assert pixels(tmp_path / "f.png")[2:-2, 2:-2].max(-1).mean() > 1.3 * picture.max(-1).mean()  # it fills the picture
    assert np.array_equal(picture, pixels(tmp_path / "both" / "relit.png"))
    linear = read_exr(tmp_path / "a.exr")
    assert np.array_equal(linear, read_exr(tmp_path / "both" / "relit.exr"))
    # the PNG is the EXR's radiance, sRGB-encoded
    assert np.abs(read_image(tmp_path / "a.png").linear - np.clip(linear, 0, 1)).max() < 0.01
    said = json.loads((tmp_path / "both" / "relight.json").read_text())
    assert said["camera"] == "the portrait's"
    assert said["shadows"] is True


def test_the_same_command_gives_the_same_bytes(avatar, tmp_path):
    for name in ("a.png", "b.png", "a.exr", "b.exr"):
        assert run(avatar, "--out", tmp_path / name) == 0
    for form in ("png", "exr"):
        assert (tmp_path / f"a.{form}").read_bytes() == (tmp_path / f"b.{form}").read_bytes()


def test_a_turntable_is_a_loop_with_its_frames(avatar, tmp_path):
    options = ("--quality", "draft", "--rotate", 5, "--fps", 10)
    assert run(avatar, *options, "--out", tmp_path / "turn") == 0
    assert sorted(p.name for p in (tmp_path / "turn" / "frames").iterdir()) == [f"{i:03d}.png" for i in range(5)]
    with Image.open(tmp_path / "turn" / "turntable.webp") as loop:
        assert loop.n_frames == 5
    assert run(avatar, "--quality", "draft", "--orbit", 3, "--background", "none", "--out", tmp_path / "o.webp") == 0
    with Image.open(tmp_path / "o.webp") as loop:
        assert loop.n_frames == 3
        assert np.asarray(loop.convert("RGBA"))[0, 0, 3] == 0


def test_light_camera_and_material_reach_the_picture(avatar, tmp_path):
    (tmp_path / "lights.json").write_text(json.dumps([{"axis": [0, 1, 0], "sharpness": 5, "amplitude": [0, 2, 0]}]))
    assert run(avatar, "--lights", tmp_path / "lights.json", "--out", tmp_path / "green.exr") == 0
    green = read_exr(tmp_path / "green.exr")
    assert green[..., 1].max() > 0.1
    assert green[..., ::2].max() == 0.0
    assert run(avatar, "--albedo-gain", 0, "--specular-scale", 0, "--out", tmp_path / "dark.exr") == 0
    assert read_exr(tmp_path / "dark.exr").max() == 0.0
    assert run(avatar, "--light-gain", 2, "--out", tmp_path / "two.exr") == 0
    assert run(avatar, "--out", tmp_path / "one.exr") == 0
    two, one = (read_exr(tmp_path / f"{n}.exr") for n in ("two", "one"))
    assert np.abs(two - 2 * one).max() < 1e-5
    frame = {"transform_matrix": np.eye(4).tolist(), "w": 30, "h": 20, "fl_x": 30.0}
    pose = np.eye(4)
    pose[:3, 3] = (WORLD_FROM_CANONICAL[:3, 3] + [0, 0, 1.0]).tolist()
    frame["transform_matrix"] = pose.tolist()
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [frame]}))
    assert run(avatar, "--camera", tmp_path / "transforms.json", "--size", 60, "--out", tmp_path / "c.png") == 0
    assert pixels(tmp_path / "c.png").shape == (40, 60, 3)


def bad(tmp_path: Path) -> dict[str, list]:
    (tmp_path / "thing.json").write_text('{"lamp": 1}')
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.glb").write_text("no GLB")
    (tmp_path / "held").mkdir()
    (tmp_path / "held" / "thesis.txt").write_text("years")
    behind = {"transform_matrix": np.eye(4).tolist(), "w": 20, "h": 20, "fl_x": 30.0}
    behind["transform_matrix"][2][3] = -50.0
    (tmp_path / "behind.json").write_text(json.dumps({"frames": [behind]}))
    (tmp_path / "taken.png").write_text("a picture")
    (tmp_path / "folder.png").mkdir()
    return {
        "no avatar": [tmp_path / "none", "--out", tmp_path / "x.png"],
        "no avatar in it": [tmp_path / "empty", "--out", tmp_path / "x.png"],
        "not a GLB": [tmp_path / "text.glb", "--out", tmp_path / "x.png"],
        "no lights": ["AVATAR", "--lights", tmp_path / "none.json", "--out", tmp_path / "x.png"],
        "lights of another form": ["AVATAR", "--lights", tmp_path / "thing.json", "--out", tmp_path / "x.png"],
        "head behind the camera": ["AVATAR", "--camera", tmp_path / "behind.json", "--out", tmp_path / "x.png"],
        "no such frame": ["AVATAR", "--camera", tmp_path / "behind.json", "--frame", 3, "--out", tmp_path / "x.png"],
        "not a camera": ["AVATAR", "--camera", tmp_path / "thing.json", "--out", tmp_path / "x.png"],
        "roughness": ["AVATAR", "--roughness", 3, "--out", tmp_path / "x.png"],
        "a file that is there": ["AVATAR", "--out", tmp_path / "taken.png"],
        "a folder of that name": ["AVATAR", "--out", tmp_path / "folder.png", "--overwrite"],
        "a picture inside a file": ["AVATAR", "--out", tmp_path / "taken.png" / "x.png"],
        "a folder inside a file": ["AVATAR", "--out", tmp_path / "taken.png" / "x"],
        "somebody's folder": ["AVATAR", "--out", tmp_path / "held"],
        "somebody's folder, over": ["AVATAR", "--out", tmp_path / "held", "--overwrite"],
    }


def test_bad_input_is_one_line_exit_3_and_nothing_written(avatar, tmp_path, capsys):
    for what, arguments in bad(tmp_path).items():
        before = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*"))
        assert run(*[avatar if a == "AVATAR" else a for a in arguments]) == 3, what
        said = capsys.readouterr().err.strip()
        assert said.startswith("error: expected"), (what, said)
        assert "\n" not in said, (what, said)
        assert sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*")) == before, what
    assert (tmp_path / "held" / "thesis.txt").read_text() == "years"
    assert (tmp_path / "taken.png").read_text() == "a picture"


def test_overwrite_replaces_its_own(avatar, tmp_path):
    for _ in range(2):
        assert run(avatar, "--out", tmp_path / "a.png", "--overwrite") == 0
        assert run(avatar, "--out", tmp_path / "a", "--overwrite") == 0
    assert run(avatar, "--out", tmp_path / "a") == 3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "a.png"]


def test_out_may_be_the_folder_one_stands_in(avatar, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert run(avatar, "--out", ".") == 0
    assert sorted(p.name for p in (tmp_path / "here").iterdir()) == ["relight.json", "relit.exr", "relit.png"]
    assert [p.name for p in tmp_path.iterdir()] == ["here"]


def test_mp4_without_ffmpeg_is_said_before_any_work(avatar, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(movie, "ffmpeg", lambda: None)
    assert run(avatar, "--rotate", 4, "--out", tmp_path / "turn.mp4") == 3
    assert "ffmpeg" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_ffmpeg_without_h264_costs_the_mp4_alone(avatar, tmp_path, monkeypatch, capsys):
    poor = tmp_path / "ffmpeg"
    poor.write_text("#!/bin/sh\necho \"Unknown encoder 'libx264'\" >&2\nexit 1\n")
    poor.chmod(0o755)
    monkeypatch.setattr(movie, "ffmpeg", lambda: str(poor))
    assert run(avatar, "--quality", "draft", "--rotate", 3, "--out", tmp_path / "turn") == 0
    assert sorted(p.name for p in (tmp_path / "turn").iterdir()) == ["frames", "relight.json", "turntable.webp"]
    assert "note: no turntable.mp4: expected ffmpeg" in (said := capsys.readouterr().err)
    assert "libx264" in said


def test_interrupted_leaves_nothing(avatar, tmp_path, monkeypatch, capsys):
    real = turntable.light_asset
    calls = []

    def stop_at_the_second(*arguments, **options):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*arguments, **options)

    monkeypatch.setattr(turntable, "light_asset", stop_at_the_second)
    assert run(avatar, "--rotate", 4, "--quality", "draft", "--out", tmp_path / "turn.webp") == 130
    assert capsys.readouterr().err.strip() == "interrupted"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "wrong",
    [
        ["a"],
        ["a", "--out", "x.png", "--rotate", "4"],
        ["a", "--out", "x.webp"],
        ["a", "--out", "x.webp", "--rotate", "1"],
        ["a", "--out", "x.mp4", "--rotate", "4", "--background", "none"],
        ["a", "--out", "x.webp", "--rotate", "4", "--orbit", "4"],
        ["a", "--out", "x.png", "--size", "5"],
        ["a", "--out", "x.png", "--samples", "0"],
        ["a", "--out", "x.png", "--albedo-tint", "1,2"],
        ["a", "--out", "x.png", "--light-gain", "-1"],
        ["a", "--out", "x.png", "--background", "sky"],
    ],
)
def test_wrong_usage_is_exit_2(wrong, capsys):
    with pytest.raises(SystemExit) as end:
        relight.main(wrong)
    assert end.value.code == 2
    assert "usage" in capsys.readouterr().err
