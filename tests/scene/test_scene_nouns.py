"""Camera, canonical frame, light, portrait: their mathematics and what they refuse."""

import numpy as np
import pytest
from scene_on_disk import make_camera
from scipy.spatial.transform import Rotation

from sira_assets.errors import InputError
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import (
    CANONICAL_LANDMARKS_M,
    canonical_from_landmarks,
    similarity,
    similarity_scale,
    transform_points,
)
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.sg_light import SGLight


def random_similarity(rng, scale):
    out = np.eye(4)
    out[:3, :3] = scale * Rotation.random(random_state=rng.integers(1 << 30)).as_matrix()
    out[:3, 3] = rng.normal(size=3)
    return out


def test_rays_and_projection_are_inverse():
    camera = make_camera(yaw=0.4)
    origins, directions = camera.rays_world()
    assert np.abs(np.linalg.norm(directions, axis=1) - 1).max() < 1e-12
    pixels, depth = camera.project(origins + 1.7 * directions)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    assert np.abs(pixels - np.stack([x, y], -1).reshape(-1, 2)).max() < 1e-9
    # Depth is along the axis, so it is shorter than the ray except in the middle.
    assert depth.max() <= 1.7
    assert depth.min() < 1.69


def test_image_axes_of_the_camera():
    """From the front, the subject's left (+X) is on the picture's right, and up is a smaller row."""
    camera = make_camera(yaw=0.0)
    centre, left, up = camera.project(np.array([[0.0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]]))[0]
    assert left[0] > centre[0]
    assert up[1] < centre[1]


def test_resizing_scales_edges_not_centres():
    camera, points = make_camera(), np.random.default_rng(0).normal(size=(9, 3)) * 0.05
    doubled = camera.resized(2 * camera.width, 2 * camera.height)
    assert np.abs(doubled.project(points)[0] - 2 * camera.project(points)[0]).max() < 1e-9


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_similarity_recovers_exactly_and_never_reflects(scale):
    rng = np.random.default_rng(1)
    truth = random_similarity(rng, scale)
    points = rng.normal(size=(9, 3))
    found = similarity(points, transform_points(truth, points))
    assert np.abs(found - truth).max() < 1e-9 * scale + 1e-9
    assert similarity_scale(found) == pytest.approx(scale)
    mirrored = similarity(points, points * [-1, 1, 1])
    assert np.linalg.det(mirrored[:3, :3]) > 0


def test_similarity_without_scale_is_rigid():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(5, 3))
    found = similarity(points, 3.0 * points, with_scale=False)
    assert similarity_scale(found) == pytest.approx(1.0)


def test_canonical_frame_from_some_of_the_names():
    rng = np.random.default_rng(3)
    truth = random_similarity(rng, 0.01)
    world_from_canonical = np.linalg.inv(truth)
    names = list(CANONICAL_LANDMARKS_M)[:4]
    world = {n: transform_points(world_from_canonical, np.array(CANONICAL_LANDMARKS_M[n])) for n in names}
    assert np.abs(canonical_from_landmarks(world) - truth).max() < 1e-6
    with pytest.raises(InputError, match="three landmarks"):
        canonical_from_landmarks({n: world[n] for n in names[:2]})


def test_canonical_landmarks_stand_as_the_convention_says():
    points = {n: np.array(p) for n, p in CANONICAL_LANDMARKS_M.items()}
    for name, point in points.items():
        side = -1 if "right" in name else 1 if "left" in name else 0
        assert np.sign(np.round(point[0], 6)) == side, name
    assert points["nose_tip"][2] == max(p[2] for p in points.values())
    assert points["chin"][1] == min(p[1] for p in points.values())


def test_camera_refuses_what_is_no_camera():
    camera = make_camera()
    for k in (np.zeros((3, 3)), np.full((3, 3), np.nan), np.eye(4)):
        with pytest.raises(InputError, match="--focal-px"):
            Camera(k, camera.world_from_camera, 4, 4)
    for pose in (2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan), np.eye(3)):
        with pytest.raises(InputError, match="pose"):
            Camera(camera.intrinsics, pose, 4, 4)
    with pytest.raises(ValueError, match="read-only"):
        camera.intrinsics[0, 0] = 1.0


def test_light_is_linear_and_turns_with_its_axes():
    rng = np.random.default_rng(4)
    light = SGLight(rng.normal(size=(3, 3)), [1.0, 10.0, 200.0], rng.random((3, 3)))
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turn = Rotation.random(random_state=5).as_matrix()
    assert light.rotated(turn).radiance(directions @ turn.T) == pytest.approx(light.radiance(directions), abs=1e-12)
    assert light.scaled(3.0).radiance(directions) == pytest.approx(3.0 * light.radiance(directions))
    # At its axis a lobe gives its amplitude.
    one = SGLight([0, 0, 2], 7.0, [1, 2, 3])
    assert one.radiance(np.array([0.0, 0, 1])).tolist() == pytest.approx([1.0, 2.0, 3.0])
    again = SGLight.from_dict(light.to_dict())
    assert np.array_equal(again.sharpness, light.sharpness)
    assert again.axis == pytest.approx(light.axis, abs=1e-15)


@pytest.mark.parametrize(
    "lobe",
    [
        ([0, 0, 0], 1.0, [1, 1, 1]),
        ([0, 0, 1], 0.0, [1, 1, 1]),
        ([0, 0, 1], 1.0, [-1, 1, 1]),
        ([0, 0, 1], np.nan, [1] * 3),
    ],
)
def test_light_refuses(lobe):
    with pytest.raises(InputError, match=r"lights\.json"):
        SGLight(*lobe)


def test_light_file_of_another_form():
    for data in ({"lights": []}, [{"axis": [0, 0, 1]}], {"sgs": 3}):
        with pytest.raises(InputError, match="sgs"):
            SGLight.from_dict(data)


@pytest.mark.parametrize(
    "wrong",
    [
        {"axis": [0, 1]},
        {"axis": [[0, 0, 1], [0, 1]]},
        {"axis": "up"},
        {"amplitude": [1, 1]},
        {"sharpness": "soft"},
        {"sharpness": [1, 2]},
        {"sharpness": 10**400},
    ],
)
def test_a_misshapen_lobe_is_said(wrong):
    with pytest.raises(InputError, match=r"lobes|sgs") as said:
        SGLight.from_dict({"sgs": [{"axis": [0, 0, 1], "sharpness": 2.0, "amplitude": [1, 1, 1], **wrong}]})
    assert "\n" not in str(said.value)


def test_portrait_gives_the_inverse_similarity():
    camera = make_camera()
    matrix = np.diag([0.9, 0.9, 0.9, 1.0])
    image = np.zeros((camera.height, camera.width, 3), np.float32)
    mask = np.ones(image.shape[:2], bool)
    portrait = Portrait(image, mask, camera, matrix, ~mask)
    assert portrait.world_from_canonical @ matrix == pytest.approx(np.eye(4), abs=1e-12)


def test_bundled_portrait_is_whole_and_looks_at_the_camera():
    from sira_assets.scene.bundled import bundled_portrait
    from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

    portrait = bundled_portrait()
    assert portrait.mask.shape == (512, 512)
    # The head fills 147 x 176 pixels of the picture.
    rows, columns = np.nonzero(portrait.mask)
    assert (np.ptp(columns), np.ptp(rows)) == pytest.approx((147, 176), abs=3)
    pixels, depth = portrait.camera.project(np.array(list(CANONICAL_LANDMARKS_M.values())))
    assert portrait.mask[tuple(pixels.astype(int).T[::-1])].all()
    assert depth.mean() == pytest.approx(2.1, abs=0.2)
    assert "assumed" in portrait.warnings[0]
