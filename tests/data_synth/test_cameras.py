"""Portrait cameras: rigid, framing the head, facing it, reproducible."""

import numpy as np
import pytest

from data_synth.cameras import (
    STYLES,
    CameraConfig,
    look_at,
    rotation_xyz,
    sample_cameras,
    sample_framing,
    sample_world_from_canonical,
)
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
            # Off the optical axis a head spans up to a quarter more than it does on it; the other views' distances
            # vary by 12 %, and a head is longer than wide.
            assert 0.25 < span < 1.1
            assert k > 0 or span < 1.0
            check_head_before_camera(camera, np.linalg.inv(world_from_canonical))


def test_no_view_cuts_the_head_unless_asked_to():
    x = head_points()[:300]
    for config in (CameraConfig(), CameraConfig(width=320, height=200), CameraConfig(off_centre=1.0)):
        for seed in range(100):
            rng = np.random.default_rng(seed)
            world_from_canonical = sample_world_from_canonical(rng)
            cameras = sample_cameras(rng, x, world_from_canonical, 8, config)
            size = [config.width, config.height]
            pixels = np.array([c.project(transform_points(world_from_canonical, x))[0] for c in cameras]) / size
            # Rounding, from one frame to the other; the portrait, off the axis, keeps the fill that was drawn to 0.5 %.
            assert np.abs(pixels[1:] - 0.5).max() < 0.5 + 1e-9
            assert np.abs(pixels[0] - 0.5).max() < 0.505


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
        # At arm's length the head's centre is a fifth of the distance behind the origin: yaw of 45 looks like 55.
        assert abs(yaw[0]) < 55
        yaws.append(yaw[1:])
        assert np.linalg.norm(centres, axis=1).min() > 0.25
        assert np.linalg.norm(centres, axis=1).max() < 4.5
    assert np.ptp(yaws) > 250
    assert np.diff(np.array(yaws)).min() > 0


def test_all_views_share_one_camera():
    _, cameras = draw(3)
    assert all(np.array_equal(c.intrinsics, cameras[0].intrinsics) for c in cameras)


def test_lenses_and_distances_are_those_of_portraits():
    framings = [sample_framing(np.random.default_rng(seed)) for seed in range(600)]
    assert {f.style for f in framings} == {name for name, *_ in STYLES}
    focal, distance = (np.array([getattr(f, name) for f in framings]) for name in ("focal_mm", "distance_m"))
    assert focal.min() >= 22
    assert focal.max() <= 135
    assert distance.min() >= 0.35
    assert (distance[focal > 80] > 1.0).all()
    # A head 0.25 m high never takes more of the frame than of the picture that is cut from it.
    of_frame = 0.25 * focal / (24.0 * distance)
    assert (of_frame <= np.array([f.fill for f in framings]) * (1 + 1e-9)).all()
    assert sum(share for _, share, *_ in STYLES) == pytest.approx(1.0)


def test_the_first_view_has_the_lens_that_was_drawn():
    """The field of view of the whole frame, not of the picture cut from it, is the lens's."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        world_from_canonical = sample_world_from_canonical(rng)
        state, config = rng.bit_generator.state, CameraConfig()
        scale = similarity_scale(world_from_canonical)
        framing = sample_framing(rng, config, scale * np.ptp(head_points()[:, 1]))
        rng.bit_generator.state = state
        camera = sample_cameras(rng, head_points(), world_from_canonical, 1, config)[0]
        centre = transform_points(np.linalg.inv(world_from_canonical), camera.centre_world[None])[0]
        middle = 0.5 * (head_points().min(0) + head_points().max(0))
        assert scale * np.linalg.norm(centre - middle) == pytest.approx(framing.distance_m)
        # Pixels per frame height by the lens; the picture is 256 of them, its share of the frame at most one.
        frame_px = camera.intrinsics[0, 0] * 24.0 / framing.focal_mm
        assert frame_px > 256 * 0.8  # a head seen from the side, or near, spans more than its height at its middle


def test_cut_pictures_move_the_principal_point_and_keep_the_head():
    config, off = CameraConfig(off_centre=1.0), []
    for seed in range(30):
        world_from_canonical, cameras = draw(seed, 2, config)
        assert np.array_equal(cameras[0].intrinsics, cameras[1].intrinsics)
        off.append(np.abs(cameras[0].intrinsics[:2, 2] - 128).max() / 256)
        pixels, _ = cameras[0].project(transform_points(world_from_canonical, head_points()))
        assert ((pixels >= 0) & (pixels <= 256)).all(1).mean() > 0.95
    assert np.mean(np.array(off) > 0.05) > 0.5
    centred = [draw(seed, 1, CameraConfig(off_centre=0.0))[1][0].intrinsics[:2, 2] for seed in range(5)]
    assert np.array_equal(centred, np.full((5, 2), 128.0))


def test_crops_cut_heads_only_when_asked():
    cut = []
    for seed in range(20):
        world_from_canonical, cameras = draw(seed, 1, CameraConfig(crops=1.0))
        pixels, _ = cameras[0].project(transform_points(world_from_canonical, head_points()))
        cut.append(((pixels >= 0) & (pixels <= 256)).all(1).mean())
    # Some of each head is outside and some of it, the greater part on average, inside.
    assert np.max(cut) < 1.0
    assert np.min(cut) > 0.1
    assert np.mean(cut) > 0.5


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
