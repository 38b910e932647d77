"""A relit asset against a truth that the renderer itself made: exact where it must be, refused where there is none."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "relight"))
from assets import ball, camera, lamp

from sira_assets.errors import InputError
from sira_assets.measure.relit import measure_relit
from sira_assets.relight.render import render_asset
from sira_assets.relight.turntable import Quality
from sira_assets.scene.camera import OPENCV_FROM_OPENGL
from sira_assets.scene.image import write_exr, write_png


def test_the_truth_itself_scores_without_end_and_a_brighter_one_by_its_gain(tmp_path):
    at, light = camera(32), lamp([0.3, 0.2, 1.0], 50.0)
    truth = render_asset(ball(level=4), at, light, shadows=False, supersample=1)
    (tmp_path / "relight").mkdir()
    (tmp_path / "relight" / "lights.json").write_text(json.dumps(light.to_dict()))
    write_exr(tmp_path / "relight" / "image.exr", 0.5 * truth.radiance)
    write_png(tmp_path / "mask.png", truth.alpha > 0)
    pose = at.world_from_camera @ OPENCV_FROM_OPENGL
    frame = {"transform_matrix": pose.tolist(), "w": 32, "h": 32, "fl_x": float(at.intrinsics[0, 0])}
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": [frame]}))
    free, cast = measure_relit(ball(level=4), tmp_path, Quality(1, 32))
    assert (free.shadows, cast.shadows) == (False, True)
    assert free.gain == pytest.approx(0.5, rel=1e-6)
    assert free.scale_invariant_psnr_db > 100  # float32
    assert free.psnr_db < 30
    # a ball shadows itself only where its facets hide from the lamp, at the terminator
    assert np.abs(cast.radiance - free.radiance).mean() < 0.01 * free.radiance.mean()


def test_a_scene_without_that_truth_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"relight/image\.exr"):
        measure_relit(ball(level=2), tmp_path)
