"""The pose of a head from 2D landmarks: exact on the mean face from any side, robust to one bad point, never silent."""

import numpy as np
import pytest
from scene_on_disk import make_camera
from scipy.spatial.transform import Rotation

from sira_assets.errors import InputError
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M
from sira_assets.scene.pose import camera_from_canonical

NAMES = list(CANONICAL_LANDMARKS_M)
POINTS = np.array(list(CANONICAL_LANDMARKS_M.values()))
K = np.array([[1000.0, 0, 320], [0, 1000.0, 240], [0, 0, 1]])


def seen(pose, k=K):
    x = (POINTS @ pose[:3, :3].T + pose[:3, 3]) @ k.T
    return dict(zip(NAMES, x[:, :2] / x[:, 2:], strict=True))


def posed(roll, yaw, pitch, distance=1.5):
    turn = Rotation.from_euler("x", 180, degrees=True) * Rotation.from_euler("zyx", [roll, yaw, pitch], degrees=True)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), [0.02, -0.03, distance]
    return pose


@pytest.mark.parametrize("roll", [0, 45, 180, -90])
@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (40, 10), (-60, 0), (75, -10), (0, -35)])
def test_exact_pixels_give_the_exact_pose(roll, yaw, pitch):
    pose = posed(roll, yaw, pitch)
    # Stopping tolerance 1e-8 relative; poses are of order one.
    assert np.abs(camera_from_canonical(seen(pose), K) - pose).max() < 1e-5


@pytest.mark.parametrize("distance", [0.3, 1.0, 10.0])
def test_focal_length_and_distance_over_their_range(distance):
    k = np.diag([1000 * distance, 1000 * distance, 1.0]) + np.array([[0, 0, 320], [0, 0, 240], [0, 0, 0]])
    pose = posed(5, 15, 5, distance)
    found = camera_from_canonical(seen(pose, k), k)
    # Far away, depth is weakly held: the tolerance is relative to it.
    assert np.abs(found - pose).max() < 1e-4 * distance


def test_pixel_scale_does_not_matter():
    pose = posed(0, 20, 5)
    rng = np.random.default_rng(0)
    pixels = {n: u + rng.normal(size=2) for n, u in seen(pose).items()}
    half = {n: u / 2 for n, u in pixels.items()}
    a, b = camera_from_canonical(pixels, K), camera_from_canonical(half, np.diag([0.5, 0.5, 1.0]) @ K)
    assert np.abs(a - b).max() < 1e-5


def test_one_bad_landmark_moves_the_head_little():
    pose = posed(0, 10, 0)
    pixels = seen(pose)
    pixels["mouth_left"] = pixels["mouth_left"] + [40.0, 0.0]  # 60 mm off
    found = camera_from_canonical(pixels, K)
    turn = Rotation.from_matrix(found[:3, :3].T @ pose[:3, :3]).magnitude()
    assert np.degrees(turn) < 5.0  # measured 1.9; plain least squares: 14
    assert abs(found[2, 3] / 1.5 - 1) < 0.05


def test_six_landmarks_are_enough_five_are_not():
    pose = posed(0, 10, 5)
    pixels = seen(pose)
    six = {n: pixels[n] for n in NAMES[:5] + NAMES[6:7]}
    assert np.abs(camera_from_canonical(six, K) - pose).max() < 1e-4
    with pytest.raises(InputError, match="at least 6"):
        camera_from_canonical({n: pixels[n] for n in NAMES[:5]}, K)


def test_right_and_left_exchanged_is_said():
    camera = make_camera()
    pixels = dict(zip(NAMES, camera.project(POINTS)[0], strict=True))

    def other(name):
        return name.replace("right", "#").replace("left", "right").replace("#", "left")

    with pytest.raises(InputError, match="exchange right and left"):
        camera_from_canonical({other(n): u for n, u in pixels.items()}, camera.intrinsics)


def test_nonsense_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="mean face"):
        camera_from_canonical({n: rng.uniform(0, 600, 2) for n in NAMES}, K)
