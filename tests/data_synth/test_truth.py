"""Truth beyond the pictures: distances against known solids, visibility against the rendering, regions in place."""

import numpy as np
import pytest

from data_synth.cameras import look_at
from data_synth.render import RayScene, RenderConfig, Surface, render
from data_synth.render_irradiance import irradiance_per_lobe
from data_synth.truth import SDF_NEAR, region_map, sample_signed_distance, visibility_maps
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight

CENTRE = np.array([0.2, -0.1, 0.3])


def box(centre=CENTRE, half=0.1) -> TriangleMesh:
    import trimesh

    solid = trimesh.creation.box(extents=[2 * half] * 3)
    return TriangleMesh(np.asarray(solid.vertices) + centre, np.asarray(solid.faces))


def distance_to_box(points, half=0.1):
    """The signed distance to an axis-aligned cube in closed form."""
    q = np.abs(points - CENTRE) - half
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(1), 0.0)


def test_signed_distance_of_a_box_is_its_closed_form():
    points, distance, known = sample_signed_distance(box(), box(), np.random.default_rng(0))
    assert known.all()
    # Single precision of coordinates below a metre: 6e-8, far inside the 0.1 mm that is promised.
    assert np.abs(distance - distance_to_box(points.astype(np.float64))).max() < 3e-7
    assert (distance < 0).any()
    assert np.abs(distance[:SDF_NEAR]).mean() < 0.01


def test_overlapping_pieces_are_inside_where_either_is():
    a, b = box(), box(CENTRE + np.array([0.05, 0.0, 0.0]))
    both = TriangleMesh(np.concatenate([a.vertices, b.vertices]), np.concatenate([a.faces, b.faces + 8]))
    points, distance, _ = sample_signed_distance(both, both, np.random.default_rng(0))
    expected = np.minimum(distance_to_box(points), distance_to_box(points - np.float32([0.05, 0, 0])))
    clear = np.abs(expected) > 1e-6
    assert np.array_equal(distance[clear] < 0, expected[clear] < 0)


@pytest.fixture(scope="module")
def two_spheres():
    """A ball that shades another one: half the light of some lobes is hidden."""
    import trimesh

    ball = trimesh.creation.icosphere(4)
    x, f = np.asarray(ball.vertices), np.asarray(ball.faces)
    mesh = TriangleMesh(np.concatenate([0.1 * x, 0.06 * x + [0.02, 0.14, 0.08]]), np.concatenate([f, f + len(x)]))
    colour = np.array([0.6, 0.4, 0.3])

    def material(p):
        return np.broadcast_to(colour, p.shape), np.zeros(len(p))

    rays = RayScene(Surface(mesh, mesh.vertices, material, 0.4))
    pose = look_at(np.array([0.0, 0.1, 1.0]), np.array([0.0, 0.04, 0.0]), np.array([0.0, 1.0, 0.0]), 0.0)
    camera = Camera(np.array([[110.0, 0, 24], [0, 110.0, 24], [0, 0, 1]]), pose, 48, 48)
    light = SGLight(
        [[0, 1, 0.4], [1, 0.2, 0.3], [0, 0.3, 1]], [60.0, 8.0, 0.5], np.array([[3, 2, 1], [1, 2, 3], [1, 1, 1]])
    )
    return rays, camera, light, colour


def test_lobe_visibility_explains_the_shadowed_rendering(two_spheres):
    rays, camera, light, colour = two_spheres
    picture = render(rays, camera, light, np.random.default_rng(0), RenderConfig(256))
    visibility = visibility_maps(rays, camera, light, np.random.default_rng(1), 256)
    assert visibility.min() >= 0
    assert visibility.max() <= 1
    normals = picture.normal_world[picture.mask].astype(np.float64)
    irradiance = irradiance_per_lobe(normals, light.axis, light.sharpness)
    explained = colour / np.pi * ((irradiance * visibility[:, picture.mask].T) @ light.amplitude)
    error = explained - picture.diffuse_radiance[picture.mask]
    unshadowed = picture.diffuse_unshadowed[picture.mask]
    assert (picture.diffuse_radiance[picture.mask] < 0.7 * unshadowed).any(), "something must be in shadow"
    # Two Monte Carlo estimates with 256 stratified directions: each is within a few per cent of what light there is,
    # and the mean over the picture without bias.
    assert np.sqrt(np.mean(error**2)) < 0.02 * unshadowed.mean()
    assert abs(error.mean()) < 0.002 * unshadowed.mean()


def test_a_convex_body_hides_nothing_from_itself():
    mesh = box(np.zeros(3))
    flat = TriangleMesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))  # true face normals
    rays = RayScene(Surface(flat, flat.vertices, lambda p: (np.ones_like(p), np.zeros(len(p))), 0.4))
    pose = look_at(np.array([0.4, 0.5, 0.8]), np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0)
    camera = Camera(np.array([[80.0, 0, 16], [0, 80.0, 16], [0, 0, 1]]), pose, 32, 32)
    light = SGLight([[0, 1, 0.2], [1, 0, 1]], [200.0, 1.0], np.ones((2, 3)))
    visibility = visibility_maps(rays, camera, light, np.random.default_rng(0), 32)
    region = region_map(rays, camera, lambda c: (c[:, 1] > 0.0999).astype(int))
    lit = region < 255
    assert np.all(visibility[:, lit] == 1.0)
    assert set(np.unique(region)) == {0, 1, 255}
