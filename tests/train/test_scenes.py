"""Training samples are drawn from what the scene's readers read, and follow the files they were drawn from."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sira_assets.errors import InputError
from sira_assets.fields.mlp import UNIT_M
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M
from sira_assets.scene.image import write_png
from sira_assets.train.scenes import SampleConfig, load_samples, sample_files, sample_scene, scenes_digest

sys.path.append(str(Path(__file__).resolve().parents[1] / "scene"))
from scene_on_disk import HEIGHT, WIDTH, SceneOnDisk

FEW = SampleConfig(surface=20, near=20, far=10, pixels_per_view=2000)
NINE = {name: list(point) for name, point in CANONICAL_LANDMARKS_M.items()}


@pytest.fixture
def scene(tmp_path) -> SceneOnDisk:
    """A ball in front of the camera, in a folder of scenes; its picture is red on the left and green on the right."""
    folder = tmp_path / "set" / "ball"
    (folder / "gt").mkdir(parents=True)
    made = SceneOnDisk(folder)
    made.pixels[:, : WIDTH // 2], made.pixels[:, WIDTH // 2 :] = (200, 0, 0), (0, 200, 0)
    write_png(folder / "image.png", made.pixels)
    trimesh.creation.icosphere(3, radius=0.12).export(folder / "gt" / "mesh.ply")
    (folder / "gt" / "landmarks.json").write_text(json.dumps({"landmarks_m": NINE}))
    return made


def projected(scene: SceneOnDisk, samples) -> np.ndarray:
    """Pixels (P, 2) at which the pinhole sees the samples' surface points."""
    return scene.camera.project(samples.pixels.astype(np.float64) * UNIT_M)[0]


def test_samples_lie_behind_the_mask_s_pixels_in_their_colours(scene):
    samples = sample_scene(scene.folder, FEW, 0)
    u = projected(scene, samples)
    assert len(u) > 100
    assert scene.mask[u[:, 1].astype(int), u[:, 0].astype(int)].all()
    assert np.array_equal(samples.pixel_rgb[:, 0] > 0, u[:, 0] < WIDTH / 2)


def test_a_lens_that_bends_lines_is_undone(scene):
    """In the picture a straight edge off the middle is straight; what the pinhole saw of it is bent."""
    scene.data["k1"] = 2.0
    scene.save()
    trimesh.creation.icosphere(3, radius=0.25).export(scene.folder / "gt" / "mesh.ply")
    scene.pixels[:, :8], scene.pixels[:, 8:] = (200, 0, 0), (0, 200, 0)
    write_png(scene.folder / "image.png", scene.pixels)
    write_png(scene.folder / "mask.png", np.ones_like(scene.mask))
    samples = sample_scene(scene.folder, FEW, 0)
    focal = scene.camera.intrinsics[0, 0]
    x, y = ((projected(scene, samples) - [WIDTH / 2, HEIGHT / 2]) / focal).T
    edge = (8 - WIDTH / 2) / focal
    lens = x * (1.0 + 2.0 * (x**2 + y**2))
    red = samples.pixel_rgb[:, 0] > samples.pixel_rgb[:, 1]
    sure = np.abs(lens - edge) > 1.0 / focal  # resampling mixes neighbours
    assert np.array_equal(red[sure], (lens < edge)[sure])
    assert (red != (x < edge)).any()


@pytest.mark.parametrize(
    "landmarks",
    [{"landmarks_3d": NINE}, {name: {"xyz_m": point, "pixel": [1, 2]} for name, point in NINE.items()}],
)
def test_landmarks_may_come_in_any_documented_form(scene, landmarks):
    (scene.folder / "gt" / "landmarks.json").write_text(json.dumps(landmarks))
    np.testing.assert_allclose(sample_scene(scene.folder, FEW, 0).anchors * UNIT_M, list(NINE.values()), atol=1e-8)


def test_what_a_scan_to_train_on_lacks_is_said_in_one_line(scene):
    del scene.frame["mask_path"]
    scene.save()
    with pytest.raises(InputError, match="mask_path"):
        sample_scene(scene.folder, FEW, 0)
    for landmarks in ({"landmarks_2d": {"chin": [1, 2]}}, {}, []):
        (scene.folder / "gt" / "landmarks.json").write_text(json.dumps(landmarks))
        with pytest.raises(InputError, match="3D landmarks"):
            sample_scene(scene.folder, FEW, 0)


def test_other_pictures_are_other_samples_and_another_set(scene):
    folders = [scene.folder.parent]
    before, digest = sample_files(folders, FEW, 0), scenes_digest(folders)
    assert sample_files(folders, FEW, 0) == before
    write_png(scene.folder / "image.png", scene.pixels[:, ::-1])
    assert sample_files(folders, FEW, 0) != before
    assert scenes_digest(folders) != digest
    mask, before = scene.folder / "mask.png", sample_files(folders, FEW, 0)
    os.utime(mask, ns=(0, 0))
    assert sample_files(folders, FEW, 0) != before


def test_a_copied_set_is_the_same_set(scene, tmp_path):
    shutil.copytree(scene.folder.parent, tmp_path / "copy", copy_function=shutil.copyfile)
    assert scenes_digest([tmp_path / "copy"]) == scenes_digest([scene.folder.parent])


@pytest.mark.slow
def test_samples_are_kept_where_they_are_said_to_be(scene):
    folders = [scene.folder.parent]
    stored = load_samples(folders, config=FEW, seed=0, workers=1)
    assert stored.paths == sample_files(folders, FEW, 0)
    np.testing.assert_array_equal(stored[0].pixel_rgb, sample_scene(scene.folder, FEW, 0).pixel_rgb)
