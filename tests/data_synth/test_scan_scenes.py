"""Scenes of a scan: any five landmarks do, and what the pictures do not show the truth does not claim."""

import pytest
from test_import_scan import NAMES, egg, landmarks_on_egg, write_scan

from data_synth.draw_scene import draw_scene
from data_synth.scene_settings import SceneSettings


@pytest.mark.parametrize("left_out", NAMES)
def test_a_scene_needs_no_landmark_in_particular(tmp_path, left_out):
    points = {name: point for name, point in landmarks_on_egg().items() if name != left_out}
    source = write_scan(tmp_path, *egg(2), points)
    settings = SceneSettings(kind="scan", views=1, size=16, samples=1, truth="train", scan=source)
    scene = draw_scene(settings, 0)
    assert scene.renderings[0].image.max() > 0
    assert set(scene.landmarks_world) == set(points)
