"""An asset from other views and its light, against a truth that the renderer itself made."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "relight"))
from assets import ball, camera, lamp

from sira_assets.errors import InputError
from sira_assets.measure.novel_views import measure_light, measure_novel
from sira_assets.relight.cameras import rotation_about
from sira_assets.relight.turntable import Quality, Turn, render_turn
from sira_assets.scene.camera import OPENCV_FROM_OPENGL, Camera
from sira_assets.scene.envmap import envmap_from_sg, write_envmap
from sira_assets.scene.image import write_exr, write_png
from sira_assets.scene.sg_light import SGLight

QUALITY = Quality(1, 32)


def scene(folder, light, turns=(30.0, -50.0), size=40):
    """A ball of 0.1 at the origin, seen from the sides."""
    novel, frames = folder / "novel", []
    novel.mkdir()
    front = camera(size)
    for number, degrees in enumerate(turns):
        turn = np.eye(4)
        turn[:3, :3] = rotation_about(np.array([0.0, 1.0, 0.0]), degrees)
        at = Camera(front.intrinsics, turn @ front.world_from_camera, size, size)
        (frame,) = render_turn(ball(level=5), at, light, Turn(), QUALITY)
        write_exr(novel / f"view_{number}.exr", frame.render.radiance)
        write_png(novel / f"view_{number}.png", frame.render.radiance.clip(0, 1))
        write_png(novel / f"mask_{number}.png", frame.render.alpha > 0.5)
        origins, directions = at.rays_world()
        along = (origins * directions).sum(1)
        root = np.sqrt(np.maximum(along**2 - (origins**2).sum(1) + 0.1**2, 0.0))
        depth = (-along - root) * (directions @ at.world_from_camera[:3, 2])
        write_exr(novel / f"depth_{number}.exr", depth.reshape(size, size).astype(np.float32))
        pose = (at.world_from_camera @ OPENCV_FROM_OPENGL).tolist()
        names = {"file_path": f"view_{number}.png", "mask_path": f"mask_{number}.png"}
        frames.append(names | {"transform_matrix": pose})
    lens = {"w": size, "h": size, "fl_x": float(front.intrinsics[0, 0])}
    (novel / "transforms.json").write_text(json.dumps(lens | {"frames": frames}))
    pose = (front.world_from_camera @ OPENCV_FROM_OPENGL).tolist()
    (folder / "transforms.json").write_text(json.dumps(lens | {"frames": [{"transform_matrix": pose}]}))
    (folder / "gt").mkdir()
    (folder / "gt" / "lights.json").write_text(json.dumps({"type": "spherical_gaussians"} | light.to_dict()))


def test_the_truth_itself_is_the_truth_from_every_side(tmp_path):
    light = lamp([0.3, 0.2, 1.0], 20.0)
    scene(tmp_path, light)
    views = measure_novel(ball(level=5), light, tmp_path, QUALITY)
    assert [v.view for v in views] == [0, 1]
    for view in views:
        assert view.psnr_db > 60
        assert view.overlap == 1.0
        # an icosphere of level 5 lies up to 0.07 % of its radius inside the ball, more along slanted rays
        assert view.depth_error < 3e-4


def test_a_smaller_head_is_seen_in_silhouette_and_depth(tmp_path):
    light = lamp([0.3, 0.2, 1.0], 20.0)
    scene(tmp_path, light)
    small = ball(level=5)
    small.vertices[:] *= 0.9
    for view in measure_novel(small, light, tmp_path, QUALITY):
        assert view.overlap == pytest.approx(0.81, abs=0.06)  # a pixel's width of the edge is a tenth of the disc
        assert view.depth_error > 0.01
        assert view.psnr_db < view.psnr_both_db


def test_light_is_compared_as_irradiance(tmp_path):
    light = SGLight([[0, 0, 1], [1, 0, 0]], [20.0, 4.0], [[3, 2, 1], [0.5, 0.5, 1.0]])
    scene(tmp_path, light, turns=())
    same = measure_light(light, tmp_path)
    assert same.error == pytest.approx(0.0, abs=1e-6)
    double = measure_light(SGLight(light.axis, light.sharpness, 2 * light.amplitude), tmp_path)
    assert double.error == pytest.approx(1.0, rel=1e-5)
    assert double.error_after_gain == pytest.approx(0.0, abs=1e-5)
    assert double.gain == pytest.approx(0.5, rel=1e-5)
    behind = SGLight([*light.axis, [0, 0, -1]], [*light.sharpness, 1e4], [*light.amplitude, [4000.0] * 3])
    other = measure_light(behind, tmp_path)
    assert other.error > 0.3
    # what shines from behind is not seen by normals that face the camera, but for a pixel of the 64 rows
    assert other.facing_after_gain < 1e-2


def test_lobes_count_in_every_documented_form_unless_a_panorama_is_exact(tmp_path):
    light = SGLight([[0, 0, 1], [1, 0, 0]], [20.0, 4.0], [[3, 2, 1], [0.5, 0.5, 1.0]])
    scene(tmp_path, light, turns=())
    for form in (light.to_dict(), light.to_dict()["sgs"]):
        (tmp_path / "gt" / "lights.json").write_text(json.dumps(form))
        assert measure_light(light, tmp_path).error == pytest.approx(0.0, abs=1e-6)
    write_envmap(tmp_path / "gt" / "envmap.exr", envmap_from_sg(light.scaled(2.0), 64))
    assert measure_light(light, tmp_path).error == pytest.approx(0.5, rel=1e-5)
    (tmp_path / "gt" / "lights.json").write_text(json.dumps({"type": "spherical_gaussians"} | light.to_dict()))
    assert measure_light(light, tmp_path).error == pytest.approx(0.0, abs=1e-6)


def test_a_scene_without_other_views_or_light_is_refused(tmp_path):
    with pytest.raises(InputError, match="novel"):
        measure_novel(ball(level=2), lamp([0, 0, 1]), tmp_path)
    with pytest.raises(InputError, match=r"lights\.json"):
        measure_light(lamp([0, 0, 1]), tmp_path)
