"""Portrait cameras: rigid, framing the head, facing it, reproducible."""

import numpy as np
import pytest

from data_synth.cameras import CameraConfig, look_at, rotation_xyz, sample_cameras, sample_world_from_canonical
from sira_assets.scene.canonical import similarity_scale, transform_points
from sira_assets.scene.portrait import check_head_before_camera


def head_points() -> np.ndarray:
    """An ellipsoid about as large as a head, centred behind the face."""
    x = np.random.default_rng(0).normal(size=(2000, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True) * [0.08, 0.12, 0.1] + [0, 0.0, -0.07]


def draw(seed, views=8, config=CameraConfig()):
    rng = np.random.default_rng(seed)
    world_from_canonical = sample_world_from_canonical(rng)
    return world_from_canonical, sample_cameras(rng, head_points(), world_from_canonical, views, config)


def test_every_view_frames_the_whole_head():
    for seed in range(30):
        world_from_canonical, cameras = draw(seed)
        x_world = transform_points(world_from_canonical, head_points())
        for k, camera in enumerate(cameras):
            pixels, depth = camera.project(x_world)
            span = np.ptp(pixels, axis=0).max() / 256
            assert depth.min() > 0
            assert 0.35 < span < 0.97
            assert k > 0 or span < 0.86
            # The aim is jittered by up to 2 cm, so some of the head may leave the picture, but not much.
            inside = ((pixels >= 0) & (pixels <= 256)).all(1).mean()
            assert inside > 0.9
            check_head_before_camera(camera, np.linalg.inv(world_from_canonical))


def test_poses_and_head_motions_are_similarities():
    for seed in range(30):
        world_from_canonical, _ = draw(seed)  # Camera itself refuses poses that are not rigid
        scale = similarity_scale(world_from_canonical)
        rotation = world_from_canonical[:3, :3] / scale
        assert 0.9 <= scale <= 1.1
        assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_the_first_view_is_frontal_and_the_others_go_around():
    yaws = []
    for seed in range(20):
        world_from_canonical, cameras = draw(seed)
        centres = transform_points(np.linalg.inv(world_from_canonical), np.array([c.centre_world for c in cameras]))
        yaw = np.degrees(np.arctan2(centres[:, 0], centres[:, 2]))
        # Distances are counted from the head's centre, 7 cm behind the canonical origin.
        assert abs(yaw[0]) < 36
        yaws.append(yaw[1:])
        assert np.linalg.norm(centres, axis=1).min() > 0.45
        assert np.linalg.norm(centres, axis=1).max() < 2.5
    assert np.ptp(yaws) > 250
    assert np.diff(np.array(yaws)).min() > 0


def test_all_views_share_one_camera():
    _, cameras = draw(3)
    assert all(np.array_equal(c.intrinsics, cameras[0].intrinsics) for c in cameras)


def test_look_at_puts_the_target_on_the_axis_and_up_upwards():
    pose = look_at(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.5]), np.array([0.0, 1.0, 0.0]), 0.0)
    x_camera = np.linalg.inv(pose) @ [0.0, 1.0, 0.5, 1.0]
    assert x_camera[:2] == pytest.approx([0, 0], abs=1e-12)
    assert x_camera[2] > 0
    assert pose[1, 1] < 0  # the picture's y points down
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_yaw_turns_from_the_front_to_the_left():
    assert rotation_xyz(0, 90, 0) @ [0, 0, 1] == pytest.approx([1, 0, 0], abs=1e-12)
    assert rotation_xyz(-90, 0, 0) @ [0, 0, 1] == pytest.approx([0, 1, 0], abs=1e-12)


def test_one_view_is_enough():
    assert len(draw(0, views=1)[1]) == 1
