"""The renderer on a sphere: geometry, coverage, determinism, independence of the world's origin."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.render import Occluder, RayScene, RenderConfig, Surface, render
from data_synth.render_irradiance import irradiance_per_lobe
from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import OPENCV_FROM_OPENGL, Camera
from sira_assets.scene.sg_light import SGLight

RADIUS = 0.1
LIGHT = SGLight([[0.3, 0.5, 0.8], [0, 1, 0]], [30.0, 0.5], [[6, 5, 4], [0.3, 0.3, 0.4]])
ALBEDO = np.array([0.5, 0.3, 0.2])


def grey(x):
    return np.broadcast_to(ALBEDO, x.shape), np.full(len(x), 0.03)


def sphere(centre=(0, 0, 0)) -> Surface:
    import trimesh

    ball = trimesh.creation.icosphere(5, RADIUS)
    x = np.asarray(ball.vertices)
    return Surface(TriangleMesh(x + centre, ball.faces, x / RADIUS), x, grey, 0.4)


def camera(size=48, centre=(0, 0, 0)) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = np.array([0, 0, 0.6]) + centre
    focal = 2.4 * size
    return Camera([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]], pose @ OPENCV_FROM_OPENGL, size, size)


def render_sphere(config=RenderConfig(32), *, centre=(0, 0, 0), seed=0, size=48):
    return render(RayScene(sphere(centre)), camera(size, centre), LIGHT, np.random.default_rng(seed), config)


def test_maps_are_those_of_a_sphere():
    out = render_sphere()
    x, n = out.position_world[out.mask], out.normal_world[out.mask]
    # The icosphere's facets lie up to 0.04 % of the radius inside the sphere.
    assert np.linalg.norm(x, axis=1) == pytest.approx(np.full(len(x), RADIUS), rel=1e-3)
    assert np.abs(n - x / RADIUS).max() < 5e-3
    assert out.depth[out.mask] == pytest.approx(0.6 - x[:, 2], abs=1e-6)
    assert out.albedo[out.mask] == pytest.approx(np.broadcast_to(ALBEDO, x.shape), rel=1e-6)
    assert out.specular[out.mask] == pytest.approx(np.full(len(x), 0.75), rel=1e-6)
    for image in (out.image, out.albedo, out.normal_world, out.depth, out.alpha):
        assert not image[~out.mask].any()


def test_diffuse_of_a_convex_body_is_albedo_times_irradiance():
    out = render_sphere()
    normal = out.normal_world[out.mask].astype(np.float64)
    expected = ALBEDO / np.pi * (irradiance_per_lobe(normal, LIGHT.axis, LIGHT.sharpness) @ LIGHT.amplitude)
    assert np.abs(out.diffuse_unshadowed[out.mask] - expected).max() < 1e-5
    assert np.abs(out.diffuse_shading[out.mask] * ALBEDO - expected).max() < 1e-5
    # A convex body shadows nothing but what its facets hide at the horizon.
    inside = normal[:, 2] > 0.3
    assert out.diffuse_radiance[out.mask][inside] == pytest.approx(expected[inside], rel=0.02)
    assert np.array_equal(out.image, out.diffuse_radiance + out.specular_radiance)


def test_coverage_approaches_the_area_of_the_disc():
    exact = np.pi * (2.4 * 48 * np.tan(np.arcsin(RADIUS / 0.6))) ** 2
    one, sixteen = (render_sphere(RenderConfig(1, k)) for k in (1, 16))
    assert set(np.unique(one.alpha)) == {0.0, 1.0}
    assert np.array_equal(one.alpha > 0, one.mask)
    assert np.array_equal(one.mask, sixteen.mask)
    # 4 x 4 points a pixel on a disc of 1200 pixels.
    assert sixteen.alpha.sum() == pytest.approx(exact, rel=3e-3)


def test_edges_are_premultiplied():
    out = render_sphere(RenderConfig(16, 16))
    edge = (out.alpha > 0) & (out.alpha < 1)
    unshadowed = out.diffuse_unshadowed[edge] / out.alpha[edge][:, None]
    assert edge.sum() > 20
    # Divided by coverage, edge pixels are as bright as a surface there can be, and never brighter.
    assert unshadowed.max() < 1.05 * out.diffuse_unshadowed.max()


def test_same_seed_same_bytes_other_seed_other_noise():
    first, again, other = render_sphere(seed=5), render_sphere(seed=5), render_sphere(seed=6)
    assert first.image.tobytes() == again.image.tobytes()
    assert first.image.tobytes() != other.image.tobytes()


def test_a_world_far_from_the_origin_renders_the_same():
    near, far = render_sphere(), render_sphere(centre=(40.0, -70.0, 30.0))
    both = near.mask & far.mask
    # Silhouette pixels may go either way by rounding.
    assert (near.mask ^ far.mask).sum() <= 2
    assert np.median(np.abs(near.image - far.image)[both]) < 1e-5


def test_a_roof_casts_its_shadow():
    """A disc above a ball darkens its top under light from above, and only there."""
    import trimesh

    ball, roof = trimesh.creation.icosphere(4, RADIUS), trimesh.creation.cylinder(0.06, 0.005, sections=64)
    turned = np.asarray(roof.vertices)[:, [0, 2, 1]] * [1, 1, -1] + [0, 0.25, 0]
    x = np.concatenate([ball.vertices, turned])
    mesh = TriangleMesh(x, np.concatenate([ball.faces, np.asarray(roof.faces) + len(ball.vertices)]))
    light = SGLight([[0, 1, 0]], [2000.0], [[100, 100, 100]])
    out = render(RayScene(Surface(mesh, x, grey, 0.4)), camera(), light, np.random.default_rng(0), RenderConfig(32))
    on_ball = out.mask & (out.position_world[..., 1] < 0.15) & (out.diffuse_unshadowed.max(-1) > 0.01)
    radius = np.hypot(out.position_world[..., 0], out.position_world[..., 2])
    dark, bright = on_ball & (radius < 0.045), on_ball & (radius > 0.075)
    assert dark.any()
    assert bright.any()
    assert out.diffuse_radiance[dark].max() < 0.02 * out.diffuse_unshadowed[dark].min()
    assert out.diffuse_radiance[bright] == pytest.approx(out.diffuse_unshadowed[bright], rel=0.02)


def test_an_occluder_is_seen_and_casts_shadows_but_is_no_part_of_the_truth():
    """A plate between ball and camera, under light from its right."""
    import trimesh

    plate = trimesh.creation.box([0.06, 0.06, 0.01])
    plate.apply_translation([0.03, 0.02, 0.16])
    held = Occluder("plate", TriangleMesh(plate.vertices, plate.faces), np.array([0.1, 0.6, 0.1]))
    free, blocked = sphere(), replace(sphere(), occluder=held)
    light = SGLight([[0.6, 0.3, 0.75]], [300.0], [[80, 80, 80]])
    without, with_plate = (
        render(RayScene(s), camera(), light, np.random.default_rng(0), RenderConfig(32)) for s in (free, blocked)
    )
    hidden = without.mask & ~with_plate.mask
    assert 100 < hidden.sum() < 0.5 * without.mask.sum()
    assert not (with_plate.mask & ~without.mask).any()
    for name in ("diffuse_radiance", "specular_radiance", "diffuse_unshadowed", "albedo", "depth", "alpha"):
        assert not getattr(with_plate, name)[hidden].any(), name
    # What stands there is green, and darkens the ball behind it where both are seen.
    seen = with_plate.image[hidden]
    assert (seen[:, 1] > 3 * seen[:, 0]).mean() > 0.9
    both = with_plate.mask & (without.diffuse_radiance.max(-1) > 0.01)
    assert np.array_equal(with_plate.albedo[both], without.albedo[both])
    darker = with_plate.diffuse_radiance[both].max(-1) < 0.5 * without.diffuse_radiance[both].max(-1)
    assert darker.any()
    # The middle of what rays are cast in moves with the plate: hits move by single-precision rounding.
    assert with_plate.diffuse_unshadowed[both] == pytest.approx(without.diffuse_unshadowed[both], abs=3e-6)


def test_a_camera_that_looks_away_sees_black():
    away = camera()
    pose = np.array(away.world_from_camera) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    away = Camera(away.intrinsics, pose, away.width, away.height)
    out = render(RayScene(sphere()), away, LIGHT, np.random.default_rng(0), RenderConfig(8))
    assert not out.mask.any()
    assert not out.image.any()


@pytest.mark.parametrize(("directions", "supersample"), [(0, 1), (16, 0), (16, 3)])
def test_settings_that_make_no_sense_are_refused(directions, supersample):
    with pytest.raises(InputError):
        RenderConfig(directions, supersample)
