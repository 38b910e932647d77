"""Shadows by directions that all points share: the same shares, differentiable, and interpolated over a surface."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from test_visibility import UP, ball, quad, unit

from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.render.visibility import SurfaceVisibility, lobe_visibility
from sira_assets.render.visibility_table import (
    aimed_directions,
    even_directions,
    shared_visibility,
    surface_visibility,
    visibility_table,
)
from sira_assets.scene.sg_light import SGLight


def tensor(a):
    return torch.tensor(np.asarray(a), dtype=torch.float32)


def lobes(rng, count=5):
    return unit(rng, count), np.geomspace(0.3, 300.0, count), rng.uniform(0.1, 1.0, (count, 3))


@pytest.fixture(scope="module")
def scene():
    """Points about a ball's equator that look at a second ball."""
    rng = np.random.default_rng(0)
    a, b = ball(1.0, (0, 0, 0), 4), ball(0.8, (0, 0.4, 2.0), 4)
    mesh = TriangleMesh(
        np.concatenate([a.vertices, b.vertices]),
        np.concatenate([a.faces, b.faces + len(a.vertices)]),
        np.concatenate([a.vertices, (b.vertices - [0, 0.4, 2.0]) / 0.8]),
    )
    points = unit(rng, 400)
    points[:, 2] = np.abs(points[:, 2])
    return mesh, points


def test_even_directions_stand_for_the_whole_sphere():
    shared = even_directions(256)
    torch.testing.assert_close(shared.directions.norm(dim=-1), torch.ones(256))
    # The lattice's own balance: its mean is nothing to about 1 / K.
    assert shared.directions.mean(0).abs().max() < 5e-3
    assert float(shared.solid_angle.sum()) == pytest.approx(4 * np.pi, rel=1e-6)


@pytest.mark.parametrize("sharpness", [0.5, 20.0, 3000.0])
def test_aimed_directions_sum_their_lobes(sharpness):
    """sum_k a_k G(w_k) is the lobe's integral, 2 pi (1 - e^{-2 lambda}) / lambda."""
    rng = np.random.default_rng(1)
    axis, lam = tensor(unit(rng, 2)), tensor([sharpness, 4.0])
    shared = aimed_directions(axis, lam, torch.ones(2, 3), 512)
    assert len(shared.directions) == 512
    value = (torch.exp(lam * (shared.directions @ axis.mT - 1)) * shared.solid_angle[:, None]).sum(0)
    exact = 2 * np.pi * -torch.expm1(-2 * lam) / lam
    # 3 %: the sharp lobe may have only some 8 to 100 directions of its own.
    assert ((value / exact - 1).abs() < 0.03).all()


def test_a_dark_light_leaves_its_directions_even():
    axis = tensor(unit(np.random.default_rng(2), 3))
    shared = aimed_directions(axis, torch.full((3,), 5.0), torch.zeros(3, 3), 128)
    assert len(shared.directions) == 128
    assert torch.isfinite(shared.solid_angle).all()


def test_convex_bodies_are_lit_exactly_and_closed_boxes_not_at_all():
    import trimesh

    rng = np.random.default_rng(3)
    points, light = unit(rng, 200), lobes(rng)
    np.testing.assert_array_equal(shared_visibility(Raycaster(ball()), points, points, *light), 1.0)
    box = trimesh.creation.box((4, 4, 4))
    inside = shared_visibility(Raycaster(TriangleMesh(box.vertices, box.faces)), 0.1 * points, points, *light)
    # 1 is said where a lobe gives nothing at all; elsewhere nothing arrives.
    lit = lobe_gives(points, light) > 1e-4
    assert inside[lit].max() < 1e-3


def lobe_gives(normals, light):
    """Share of its head-on irradiance that each lobe gives each normal."""
    from sira_assets.numerics.sg_irradiance import irradiance_accurate

    cosine, sharpness = tensor(normals @ light[0].T), tensor(light[1])
    return (irradiance_accurate(cosine, sharpness) / irradiance_accurate(torch.ones(1), sharpness)).numpy()


def test_shared_directions_agree_with_rays_of_each_lobe(scene):
    mesh, points = scene
    caster, light = Raycaster(mesh), lobes(np.random.default_rng(4))
    one = lobe_visibility(caster, points, points, *light[:2], rays=1024)
    other = shared_visibility(caster, points, points, *light, directions=2048)
    weight = lobe_gives(points, light)
    # Weighted by the light that is shared out: some hundred directions a lobe, an edge through many.
    assert np.sqrt((weight * (one - other) ** 2).mean()) < 0.015
    assert 0.02 < (weight * (1 - one)).sum() / weight.sum() < 0.6  # there is something to agree on


def test_an_even_table_widens_lobes_that_it_cannot_resolve():
    wall = Raycaster(quad((1, -100, -1), (1, 100, -1), (1, 100, 1), (1, -100, 1)))
    table = visibility_table(wall, np.zeros((1, 3)), tensor(UP[None]), even_directions(256), offset=0.0)
    elevation = np.radians(np.linspace(5, 85, 41))
    axis = tensor(np.stack([np.cos(elevation), 0 * elevation, np.sin(elevation)], 1))
    seen = table.share(torch.zeros(1, dtype=torch.int64), axis, torch.full((41,), 1e5))[0]
    # From hidden to lit without steps, although no direction may lie within the lobe: steps of 2 degrees of 11.
    assert seen[0] < 0.1
    assert seen[-1] > 0.95
    assert (seen[1:] - seen[:-1]).abs().max() < 0.2


def test_gradients_are_those_of_differences(scene):
    mesh, points = scene
    points = points[:60]
    light = lobes(np.random.default_rng(5), 3)
    even = even_directions(128)
    shared = replace(even, directions=even.directions.double(), solid_angle=even.solid_angle.double())
    table = visibility_table(Raycaster(mesh), points, torch.tensor(points), shared)
    axis, sharpness = (
        torch.tensor(light[0], requires_grad=True),
        torch.tensor([1.0, 9.0, 40.0]).double().requires_grad_(),
    )
    weight = torch.tensor(np.random.default_rng(6).normal(size=(60, 3)))
    rows = torch.arange(60)

    def value(a, s):
        return (weight * table.share(rows, a, s)).sum()

    value(axis, sharpness).backward()
    step = 1e-5
    for leaf in (axis, sharpness):
        for i in range(leaf.numel()):
            moved = [leaf.detach().clone() for _ in range(2)]
            moved[0].view(-1)[i] += step
            moved[1].view(-1)[i] -= step
            with torch.no_grad():
                ends = [value(m, sharpness) if leaf is axis else value(axis, m) for m in moved]
            difference = float(ends[0] - ends[1]) / (2 * step)
            # Central differences in float64 at a step of 1e-5: 1e-10 of third derivatives of some 1e3.
            assert float(leaf.grad.view(-1)[i]) == pytest.approx(difference, rel=1e-5, abs=1e-6)


def test_the_order_of_points_is_nothing_to_them(scene):
    mesh, points = scene
    table = visibility_table(Raycaster(mesh), points, tensor(points), even_directions(100))
    axis, sharpness = tensor(unit(np.random.default_rng(7), 4)), torch.full((4,), 6.0)
    every = table.share(torch.arange(400), axis, sharpness)
    some = torch.tensor([7, 399, 0, 7])
    torch.testing.assert_close(table.share(some, axis, sharpness), every[some])


def test_shares_at_vertices_are_read_between_them(scene):
    mesh, _ = scene
    share = mesh.vertices[:, :2].astype(np.float32) + 3.0  # linear in position: read exactly
    surface, caster = SurfaceVisibility(mesh, share), Raycaster(mesh)
    rng = np.random.default_rng(8)
    face, weights = rng.integers(len(mesh.faces), size=500), rng.dirichlet(np.ones(3), 500)
    points = (mesh.vertices[mesh.faces[face]] * weights[..., None]).sum(1)
    # float32 rays and closest points: 1e-6 of a size of 4.
    np.testing.assert_allclose(surface.at(face, weights), points[:, :2] + 3.0, atol=5e-6)
    np.testing.assert_allclose(surface.near(caster, points), points[:, :2] + 3.0, atol=2e-5)


def test_the_light_is_turned_into_the_head_s_frame(scene):
    mesh, _ = scene
    rng = np.random.default_rng(9)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = 1.3 * q, (0.1, 0.2, 0.3)
    light = SGLight(*lobes(rng))
    turned = SGLight(light.axis @ q, light.sharpness, light.amplitude)  # canonical = q world
    a = surface_visibility(mesh, light, np.eye(4), directions=96).share
    b = surface_visibility(mesh, turned, pose, directions=96).share
    np.testing.assert_allclose(a, b, atol=2e-2)  # rays at an edge fall to either side by rounding: one of some 50


def test_no_lobes():
    light = np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))
    caster = Raycaster(ball(subdivisions=1))
    assert shared_visibility(caster, np.zeros((3, 3)), np.tile(UP, (3, 1)), *light).shape == (3, 0)
