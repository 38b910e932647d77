"""Cast shadows by ray casting, against scenes whose shadows are known in closed form and against dense quadrature."""

import numpy as np
import pytest

from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.render.lobe_sampling import lobe_rays
from sira_assets.render.visibility import ambient_occlusion, lobe_visibility

SHARPNESS = np.array([0.0, 0.5, 4.0, 30.0, 1e3, 1e6])
UP = np.array([0.0, 0.0, 1.0])


def ball(radius=1.0, centre=(0.0, 0.0, 0.0), subdivisions=4) -> TriangleMesh:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return TriangleMesh(mesh.vertices + np.array(centre), mesh.faces)


def quad(*corners) -> TriangleMesh:
    return TriangleMesh(np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]]))


def unit(rng, count):
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_a_convex_body_shadows_itself_nowhere():
    """Exactly 1, also for lobes on and beneath the horizon, wherever the lobe is."""
    rng = np.random.default_rng(0)
    points = unit(rng, 300)
    seen = lobe_visibility(Raycaster(ball()), points, points, unit(rng, 6), SHARPNESS, rays=16)
    np.testing.assert_array_equal(seen, 1.0)


def test_nothing_reaches_the_inside_of_a_box():
    import trimesh

    rng = np.random.default_rng(1)
    box = trimesh.creation.box((4, 5, 6))
    caster = Raycaster(TriangleMesh(box.vertices, box.faces))
    seen = lobe_visibility(caster, unit(rng, 50), unit(rng, 50), unit(rng, 6), SHARPNESS, rays=16)
    np.testing.assert_array_equal(seen, 0.0)


def test_no_lobes_and_no_points():
    caster = Raycaster(ball(subdivisions=1))
    assert lobe_visibility(caster, np.zeros((3, 3)), np.tile(UP, (3, 1)), np.zeros((0, 3)), np.zeros(0)).shape == (3, 0)
    assert lobe_visibility(caster, np.zeros((0, 3)), np.zeros((0, 3)), UP[None], np.ones(1)).shape == (0, 1)


def test_a_long_wall_hides_its_share_of_the_sky():
    """A wall whose edge stands at elevation a hides (1 - cos a) / 2 of a constant light's irradiance."""
    length = 1e4
    wall = Raycaster(quad((1, -length, -1), (1, length, -1), (1, length, 1), (1, -length, 1)))
    for distance in (0.3, 1.0, 3.0):
        point = np.array([[1.0 - distance, 0.0, 0.0]])
        seen = ambient_occlusion(wall, point, UP[None], rays=4096, offset=0.0)
        angle = np.arctan2(1.0, distance)
        # An even set of 4096 leaves below 1e-3 at a straight edge.
        np.testing.assert_allclose(seen, 0.5 * (1.0 + np.cos(angle)), atol=2e-3)


def test_a_sharp_lamp_is_seen_above_the_wall_half_at_its_edge_and_not_below():
    wall = Raycaster(quad((1, -100, -1), (1, 100, -1), (1, 100, 1), (1, -100, 1)))
    elevation = np.radians([44.0, 45.0, 46.0])
    axis = np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], 1)
    seen = lobe_visibility(wall, np.zeros((1, 3)), UP[None], axis, np.full(3, 1e6), rays=1024, offset=0.0)[0]
    assert seen[0] == 0.0
    assert seen[2] == 1.0
    # One degree is 17 widths of this lobe; 1024 rays leave a few thousandths.
    assert abs(seen[1] - 0.5) < 0.01


@pytest.mark.parametrize("sharpness", [0.0, 0.5, 4.0, 30.0])
def test_a_ball_overhead_hides_what_its_cone_holds(sharpness):
    """Head-on, the hidden share is int_{cos b}^1 u e^{lambda (u-1)} du over int_0^1; constant light: (r / d)^2."""
    caster = Raycaster(ball(1.0, (0.0, 0.0, 2.5), 5))
    u = np.linspace(0.0, 1.0, 200_001)
    density = u * np.exp(sharpness * (u - 1.0))
    cone = np.sqrt(1.0 - (1.0 / 2.5) ** 2)
    hidden = density[u > cone].sum() / density.sum()
    if sharpness == 0.0:
        assert abs(hidden - 0.16) < 1e-4
    seen = lobe_visibility(caster, np.zeros((1, 3)), UP[None], UP[None], np.array([sharpness]), rays=4096, offset=0.0)
    # 2e-3: the discrepancy of 4096 rays at a round edge, and the ball's facets (3e-4 of its area).
    assert abs(float(seen[0, 0]) - (1.0 - hidden)) < 2e-3


@pytest.mark.parametrize("sharpness", [0.3, 3.0, 40.0, 600.0])
def test_agrees_with_dense_quadrature_for_any_elevation_of_the_lobe(sharpness):
    """Over balls scattered about the point; the axis from beneath the horizon to the zenith."""
    rng = np.random.default_rng(3)
    centres = unit(rng, 40) * 2.0
    parts = [ball(0.35, c, 2) for c in centres]
    offsets = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    caster = Raycaster(
        TriangleMesh(
            np.concatenate([p.vertices for p in parts]),
            np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=True)]),
        )
    )
    # Dense directions by the lobe's own inverse CDF about its axis, weighted by the cosine.
    count = 200_000
    index = np.arange(count) + 0.5
    height = 1.0 + np.log1p(-(index / count) * -np.expm1(-2.0 * sharpness)) / sharpness
    azimuth = index * np.pi * (3.0 - 5.0**0.5)
    flat = np.sqrt(np.maximum(1.0 - height**2, 0.0))
    around = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], 1)
    elevations = np.array([-0.05, 0.0, 0.05, 0.4, 1.5])
    elevations = elevations[(elevations >= 0) | (sharpness < 100)]  # beneath the horizon a sharp lobe leaves no weight
    axis = np.stack([np.cos(elevations), 0.0 * elevations, np.sin(elevations)], 1)
    seen = lobe_visibility(
        caster, np.zeros((1, 3)), UP[None], axis, np.full(len(axis), sharpness), rays=4096, offset=0.0
    )[0]
    for i, a in enumerate(axis):
        side = np.array([-a[2], 0.0, a[0]])
        w = around @ np.stack([side, np.cross(a, side), a])
        weight = np.maximum(w[:, 2], 0.0)
        lit = ~caster.occluded(np.zeros_like(w), w)
        # 2.5e-3: what 4096 rays leave at the edges of some ten balls; the tables' own error is below 5e-4.
        assert abs(seen[i] - (weight * lit).sum() / weight.sum()) < 2.5e-3, (sharpness, elevations[i])


def test_more_rays_err_less():
    caster = Raycaster(quad((0.2, -50, 0.1), (50, -50, 0.1), (50, 50, 0.1), (0.2, 50, 0.1)))
    points = np.zeros((400, 3))
    normals = np.tile(UP, (400, 1))
    axis = np.array([[0.3, 0.1, 1.0]]) / np.sqrt(1.1)
    exact = float(lobe_visibility(caster, points[:1], normals[:1], axis, [8.0], rays=16384, offset=0.0)[0, 0])
    error = [
        float(
            np.sqrt(((lobe_visibility(caster, points, normals, axis, [8.0], rays=r, offset=0.0) - exact) ** 2).mean())
        )
        for r in (16, 64, 256)
    ]
    # Better than the 1/2 of independent rays from step to step.
    assert error[1] < 0.45 * error[0]
    assert error[2] < 0.45 * error[1]
    assert error[1] < 0.03


def test_turning_everything_changes_nothing_but_the_grain():
    rng = np.random.default_rng(5)
    mesh = ball(1.0, (0.0, 0.3, 2.0), 4)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    axis, lam = unit(rng, 4), np.array([1.0, 8.0, 50.0, 400.0])
    here = lobe_visibility(Raycaster(mesh), np.zeros((1, 3)), UP[None], axis, lam, rays=512, offset=0.0)
    turned = TriangleMesh(mesh.vertices @ q.T, mesh.faces)
    there = lobe_visibility(Raycaster(turned), np.zeros((1, 3)), (q @ UP)[None], axis @ q.T, lam, rays=512, offset=0.0)
    np.testing.assert_allclose(here, there, atol=4 / 512)  # rays at an edge fall to either side by rounding


def test_the_same_seed_gives_the_same_shadows():
    caster, rng = Raycaster(ball(0.5, (0, 0, 1.0), 3)), np.random.default_rng(0)
    points, normals, axis = 0.1 * unit(rng, 50), unit(rng, 50), unit(rng, 2)
    a, b, c = (lobe_visibility(caster, points, normals, axis, [2.0, 20.0], seed=s) for s in (0, 0, 1))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


@pytest.mark.parametrize("sharpness", [0.0, 1e-8, 1e8])
def test_extreme_lobes_give_unit_rays_above_the_horizon(sharpness):
    rays = lobe_rays(sharpness, 32)
    rng = np.random.default_rng(7)
    normals = unit(rng, 200)
    for axis in (normals[0], -normals[0], *unit(rng, 3)):
        w = rays.directions(normals, axis, np.arange(200) % rays.azimuth.shape[1])
        # float32 rounding of unit vectors, and of a grazing cosine.
        np.testing.assert_allclose(np.linalg.norm(w, axis=-1), 1.0, atol=2e-6)
        assert (np.einsum("nkc,nc->nk", w, normals) > -1e-6).all()


@pytest.mark.slow
def test_true_maps_under_shadows_are_the_real_scene_s_diffuse_radiance(real_data):
    """ict_a_soft, as tools/measure_visibility.py says it: at least 42 dB; 47.7 measured, the truth's noise at 47.5."""
    import sys
    from pathlib import Path

    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
    try:
        from measure_visibility import measure
    finally:
        sys.path.pop(0)
    scene = real_data / "scenes" / "ict_a_soft"
    figures, _ = measure(scene, scene, 32, 256)
    assert figures["no shadows, dB"] < 31.0
    assert figures["32 rays per point and lobe, dB"] > 45.0
    assert figures["256 shared directions, dB"] > 45.0
    assert figures["256 shared directions, at the mesh's vertices, dB"] > 45.0
