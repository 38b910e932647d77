"""Bad input: each gets one line that says what was wrong and the remedy."""

import json

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.scene.image import write_exr, write_png
from sira_assets.scene.read_scene import read_frames, read_scene
from sira_assets.scene.transforms_json import read_camera


def refused(path, match, **options):
    with pytest.raises(InputError, match=match) as error:
        read_scene(path, **options)
    text = str(error.value)
    assert "\n" not in text
    assert error.value.remedy in text
    assert len(text) < 500
    return text


def test_missing_files(scene, tmp_path):
    refused(tmp_path / "nowhere", "nothing there")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "transforms.json or cameras.npz")
    (scene.folder / "image.png").unlink()
    refused(scene.folder, "no such file")


def test_missing_mask_file_and_user_files(scene):
    refused(scene.folder, "no such file", mask=scene.folder / "no.png")
    refused(scene.folder, "no such file", landmarks=scene.folder / "no.json")
    (scene.folder / "mask.png").unlink()
    refused(scene.folder, "mask.png")
    del scene.frame["mask_path"]
    scene.save()
    refused(scene.folder, "--mask")


def test_empty_mask(scene):
    write_png(scene.folder / "mask.png", np.zeros_like(scene.mask))
    refused(scene.folder, "without a single pixel")


def test_mask_of_another_size(scene):
    write_png(scene.folder / "mask.png", scene.mask[:-1])
    assert "48x63" in refused(scene.folder, "a mask of the picture's size 48x64")


def test_nan_pixels_are_counted_and_the_first_is_named(scene):
    pixels = np.full((64, 48, 3), 0.5, np.float32)
    pixels[5, 7, 0], pixels[9, 1] = np.nan, np.inf
    write_exr(scene.folder / "image.exr", pixels)
    scene.frame["file_path"] = "image.exr"
    scene.save()
    refused(scene.folder, r"2 pixel\(s\) with NaN or inf, the first at row 5, column 7")


def test_truncated_image(scene):
    data = (scene.folder / "image.png").read_bytes()
    (scene.folder / "image.png").write_bytes(data[: len(data) // 2])
    refused(scene.folder, "whole EXR, PNG or JPEG")


@pytest.mark.parametrize("focal", [0.0, -100.0, float("nan"), float("inf"), "wide", True])
def test_singular_intrinsics(scene, focal):
    scene.data["fl_x"] = focal
    scene.save()
    refused(scene.folder, "fl_x")


def test_no_focal_length_at_all(scene):
    del scene.data["fl_x"], scene.data["fl_y"]
    scene.save()
    refused(scene.folder, "camera_angle_x")
    scene.data["camera_angle_x"] = 3.2
    scene.save()
    refused(scene.folder, "between 0 and pi")


def test_head_behind_the_camera_names_the_flip_that_fits(scene):
    """The commonest mistake: an OpenCV pose in a file whose poses are OpenGL's."""
    scene.frame["transform_matrix"] = scene.camera.world_from_camera.tolist()
    scene.save()
    assert "flip the camera's Y and Z" in refused(scene.folder, "behind the camera")


def test_head_outside_the_picture(scene):
    moved = np.eye(4)
    moved[0, 3] = 3.0
    scene.data["canonical_from_world"] = moved.tolist()
    scene.save()
    refused(scene.folder, "outside the picture")


def test_pose_that_is_not_rigid_and_similarity_that_mirrors(scene):
    pose = np.array(scene.frame["transform_matrix"])
    scene.frame["transform_matrix"] = (pose @ np.diag([2.0, 2, 2, 1])).tolist()
    scene.save()
    refused(scene.folder, "rigid")
    scene.frame["transform_matrix"] = pose.tolist()
    scene.data["canonical_from_world"] = np.diag([-1.0, 1, 1, 1]).tolist()
    scene.save()
    refused(scene.folder, "without reflection")


@pytest.mark.parametrize(
    ("place", "value"), [((0, 1), 0.05), ((2, 2), 1.01), ((3, 3), 2.0), ((3, 0), 0.1), ((1, 1), 0.0)]
)
def test_canonical_from_world_that_is_no_similarity(scene, place, value):
    matrix = np.eye(4)
    matrix[place] = value
    scene.data["canonical_from_world"] = matrix.tolist()
    scene.save()
    refused(scene.folder, "a similarity without reflection.*recompute it from landmarks")


def test_a_similarity_rounded_to_four_digits_is_one(scene):
    matrix = scene.camera.camera_from_world.round(4)
    matrix[:3, :3] *= 0.9
    scene.frame["transform_matrix"] = np.diag([1.0, -1, -1, 1]).tolist()
    scene.data["canonical_from_world"] = np.linalg.inv(matrix).tolist()
    scene.save()
    read_scene(scene.folder)


@pytest.mark.parametrize("name", ["../secret.png", "/etc/hostname", "sub/../../secret.png"])
@pytest.mark.parametrize("key", ["file_path", "mask_path"])
def test_path_that_leads_out_of_the_scene(tmp_path, scene, name, key):
    write_png(tmp_path.parent / "secret.png", scene.pixels)
    scene.frame[key] = name
    scene.save()
    refused(scene.folder, "leads out of it")


def test_link_that_leads_out_of_the_scene(tmp_path, scene):
    write_png(tmp_path.parent / "linked.png", scene.pixels)
    (scene.folder / "image.png").unlink()
    (scene.folder / "image.png").symlink_to(tmp_path.parent / "linked.png")
    refused(scene.folder, "leads out of it")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("{", "line 1"),
        ("\xff\xfe", "JSON"),
        ("[]", "frames"),
        ('{"frames": []}', "frames"),
        ('{"frames": [3]}', "frames"),
        ("[" * 100_000, "JSON"),
    ],
)
def test_broken_descriptions(scene, text, match):
    (scene.folder / "transforms.json").write_text(text, encoding="latin-1")
    refused(scene.folder, match)


@pytest.mark.parametrize("value", [None, 3, "x", [[1, 0], [0, 1]], [[float("nan")] * 4] * 4, [[1, 2], [3]]])
def test_broken_matrices(scene, value):
    scene.frame["transform_matrix"] = value
    scene.save()
    refused(scene.folder, "transform_matrix")


def test_size_that_disagrees_and_fisheye(scene):
    scene.data["w"] = 100
    scene.save()
    refused(scene.folder, "48x64")
    scene.data.update(w=48, camera_model="OPENCV_FISHEYE")
    scene.save()
    refused(scene.folder, "undistort")
    scene.data.update(camera_model="OPENCV", k1=-5.0)
    scene.save()
    refused(scene.folder, "inverted")


def test_a_camera_alone_is_a_pinhole_or_refused(scene):
    pinhole = read_camera(scene.folder / "transforms.json")
    assert pinhole.intrinsics.tolist() == scene.camera.intrinsics.tolist()
    scene.data.update(camera_model="OPENCV", k1=-0.1)
    scene.save()
    bent = read_camera(scene.folder / "transforms.json")
    assert bent.intrinsics.tolist() == pinhole.intrinsics.tolist()
    for wrong in ({"camera_model": "OPENCV_FISHEYE"}, {"k4": 0.1}, {"k1": "much"}):
        scene.frame.update(wrong)
        scene.save()
        with pytest.raises(InputError, match=r"undistort|k1"):
            read_camera(scene.folder / "transforms.json")
        for key in wrong:
            del scene.frame[key]


def test_landmarks_that_are_not(scene, tmp_path):
    file = tmp_path / "lm.json"
    for data, match in [
        ({}, "neither"),
        ({"landmarks_2d": {"nose": [1, 2]}}, "canonical names"),
        ({"landmarks_2d": {"nose_tip": [1, 2, 3]}}, "2 numbers"),
        ({"landmarks_2d": {"nose_tip": [1, None]}}, "2 numbers"),
        ({"landmarks_2d": [[0, 0]] * 67}, "68 rows"),
        ({"landmarks_2d": {"nose_tip": [20, 30], "chin": [20, 40]}}, "at least 6"),
        ({"landmarks_m": {"nose_tip": [0, 0, 0], "chin": [0, 1, 0]}}, "not on one line"),
    ]:
        file.write_text(json.dumps(data))
        refused(scene.folder, match, landmarks=file)


def test_bare_photo_needs_mask_and_landmarks(scene, tmp_path):
    refused(scene.folder / "image.png", "--mask")
    refused(scene.folder / "image.png", "--landmarks", mask=scene.folder / "mask.png")
    for focal in (0.0, -1.0, float("nan")):
        refused(scene.folder / "image.png", "--focal-px", focal_px=focal)
    refused(scene.folder / "image.png", "--fov", fov_deg=180.0)


def test_many_views_report_the_same(scene):
    scene.data["frames"].append({**scene.frame, "file_path": "image_2.png"})
    scene.save()
    with pytest.raises(InputError, match=r"image_2\.png"):
        read_frames(scene.folder)
    # One portrait needs the first view only.
    assert read_scene(scene.folder).mask.any()
