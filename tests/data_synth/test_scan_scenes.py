"""Scenes of a scan: any five landmarks do, and what the pictures do not show the truth does not claim."""

import numpy as np
import pytest
import trimesh
from test_import_scan import CENTRE, NAMES, egg, landmarks_on_egg, open_behind, write_scan

from data_synth.cameras import look_at
from data_synth.draw_scene import draw_scene
from data_synth.render import Occluder, RayScene, RenderConfig, Surface, render
from data_synth.scan_back import without_back
from data_synth.scene_settings import SceneSettings
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight


@pytest.mark.parametrize("left_out", NAMES)
def test_a_scene_needs_no_landmark_in_particular(tmp_path, left_out):
    points = {name: point for name, point in landmarks_on_egg().items() if name != left_out}
    source = write_scan(tmp_path, *egg(2), points)
    settings = SceneSettings(kind="scan", views=1, size=16, samples=1, truth="train", scan=source)
    scene = draw_scene(settings, 0)
    assert scene.portrait.image.max() > 0
    assert set(scene.landmarks_world) == set(points)


def test_visibility_is_zero_beside_the_mask(tmp_path):
    vertices, faces = egg(3)
    open_below = faces[vertices[faces][:, :, 1].mean(1) > -0.105]
    source = write_scan(tmp_path, vertices, open_below, landmarks_on_egg())
    settings = SceneSettings(kind="scan", views=1, size=32, samples=1, scan=source, occluders=1.0)
    for index in range(4):
        scene = draw_scene(settings, index)
        mask = scene.portrait.mask
        assert (scene.full.visibility[:, mask] > 0).any()
        assert not scene.full.visibility[:, ~mask].any()


def test_what_is_held_before_the_inside_of_a_scan_is_seen():
    """A card before a shell that is open behind, from behind: nothing of the shell, all of the card."""
    box = trimesh.creation.box([0.05, 0.05, 0.01]).apply_translation([0.0, -0.03, -0.4])
    shell, card = TriangleMesh(*open_behind()), TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces))
    surface = Surface(
        shell, shell.vertices, lambda p: (np.full(p.shape, 0.5), np.zeros(len(p))), 0.4, Occluder("card", card, 0.5)
    )
    pose = look_at(np.array([0.0, -0.03, -1.0]), CENTRE, np.array([0.0, 1.0, 0.0]), 0.0)
    camera = Camera(np.array([[96.0, 0, 16], [0, 96.0, 16], [0, 0, 1]]), pose, 32, 32)
    light = SGLight([[0.0, 0.0, -1.0]], [0.5], [[1.0, 1.0, 1.0]])
    drawn = render(RayScene(surface), camera, light, np.random.default_rng(0), RenderConfig(8))
    assert drawn.mask.any()
    kept = without_back(drawn, camera, Raycaster(shell), shell)
    seen = Raycaster(card).cast(*camera.rays_world()).hit.reshape(32, 32)
    assert not kept.mask.any()
    assert not kept.image[~seen].any()
    assert (kept.image[seen] > 0).all()
