"""Which surface the photo says nothing of."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from ball_prior import ball_prior
from scipy import ndimage
from small_portrait import portrait

from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fit.appearance import _seen_surface, unlit_head
from sira_assets.fit.appearance_losses import AppearanceFitConfig
from sira_assets.fit.geometry import GeometryFitConfig, fit_geometry
from sira_assets.fit.pixels import mask_rays, pixel_rays, pixels_per_metre
from sira_assets.fit.seen_surface import BESIDE_M, _unseen, cut_region, hidden_surface, visible_surface
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.render.tracing import TraceConfig, sphere_trace
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import transform_points

TO_CAMERA = np.array([0.0, 0.0, 1.0])


def point_at(p, row, column, depth=1.0):
    """The canonical point that this pixel sees at this depth (the camera's unit)."""
    k = p.camera.intrinsics
    seen = np.array([(column + 0.5 - k[0, 2]) / k[0, 0], (row + 0.5 - k[1, 2]) / k[1, 1], 1.0]) * depth
    world = transform_points(p.camera.world_from_camera, seen[None])
    return transform_points(p.canonical_from_world, world)


def unseen(p, row, column, normal=TO_CAMERA, depth=1.0, cut=None):
    cut = np.zeros_like(p.mask) if cut is None else cut
    away, beside = _unseen(p, point_at(p, row, column, depth), np.asarray(normal)[None], cut)
    return bool(away[0]), bool(beside[0])


def test_a_pixel_of_the_mask_sees_what_faces_it():
    p = portrait()
    assert unseen(p, 45, 48) == (False, False)
    assert unseen(p, 45, 48, -TO_CAMERA) == (True, False)
    assert unseen(p, 45, 48, 0.0 * TO_CAMERA) == (False, False)  # no direction: nothing to doubt it by


@pytest.mark.parametrize(("row", "column"), [(45, 5), (3, 48), (200, 48), (45, -900)])
def test_beside_the_mask_and_beyond_the_picture_nothing_is_seen(row, column):
    assert unseen(portrait(), row, column) == (False, True)


def test_behind_the_camera_nothing_is_seen():
    assert unseen(portrait(), 45, 48, depth=-1.0)[1]


def test_a_hole_is_bridged_and_the_masks_edge_has_room():
    p = portrait()
    mask = p.mask.copy()
    mask[40:44, 46:50] = False
    assert unseen(replace(p, mask=mask), 42, 48) == (False, False)
    left = int(np.flatnonzero(p.mask[45])[0])
    assert [unseen(p, 45, left - k)[1] for k in (1, 2, 3, 4)] == [False, False, True, True]


def triangles(fit):
    return extract_mesh(unlit_head(fit, ball_prior()), ExtractConfig(cell_m=0.004))


@pytest.fixture(scope="module")
def fitted():
    p = portrait()
    config = GeometryFitConfig(steps_appearance=1, steps_codes=1, steps_networks=1, steps_cover=0)
    fit = fit_geometry(p, ball_prior(), config)
    return p, fit, triangles(fit)


def test_pixels_see_what_sphere_tracing_finds(fitted):
    p, fit, mesh = fitted
    seen = visible_surface(p, fit, Raycaster(mesh))
    rays = mask_rays(replace(p, canonical_from_world=fit.canonical_from_world))
    low, high = (torch.as_tensor(b / UNIT_M, dtype=torch.float32) for b in BOUNDS_M)
    sdf = lambda x: fit.shape(x, fit.z_sdf)[0]  # noqa: E731
    traced = sphere_trace(sdf, rays.origins, rays.directions, low, high, TraceConfig(tolerance=1e-6))
    # A row of pixels at the silhouette may meet the surface and miss its triangles, or the other way round.
    number = lambda r: set((1000 * r.row + r.column).tolist())  # noqa: E731
    ours, theirs = number(seen.rays), number(rays.select(torch.nonzero(traced.hit)[:, 0]))
    assert len(ours ^ theirs) <= 0.01 * len(theirs)
    at = {int(1000 * r + c): k for k, (r, c) in enumerate(zip(rays.row, rays.column, strict=True))}
    same = torch.tensor([at[int(1000 * r + c)] for r, c in zip(seen.rays.row, seen.rays.column, strict=True)])
    there = traced.hit[same]
    x = rays.origins[same] + traced.t[same, None] * rays.directions[same]
    off = (seen.x - x).norm(dim=-1)[there]
    # Single precision at two units from the camera; where a ray grazes, its hit is as loose as f over the slope.
    assert float(off.median()) < 1e-5
    assert float(off.quantile(0.99)) < 1e-3
    assert float(sdf(seen.x).detach().abs().quantile(0.99)) < 1e-4
    torch.testing.assert_close(seen.normals.norm(dim=-1), torch.ones(len(seen)))


def test_a_random_part_of_the_pixels_keeps_the_pictures_order(fitted):
    p, fit, mesh = fitted
    some = visible_surface(p, fit, Raycaster(mesh), at_most=200, generator=torch.Generator().manual_seed(0))
    assert 50 < len(some) < 200  # the ball leaves some of the mask bare
    place = 1000 * some.rays.row + some.rays.column
    assert bool((place[1:] > place[:-1]).all())


def test_a_triangle_that_is_not_of_the_surface_keeps_its_points(fitted):
    p, fit, _ = fitted
    # A wall through the ball, as a cap is: a step is taken only where it leads nearer to the zero set.
    centre = transform_points(p.canonical_from_world, p.camera.world_from_camera[None, :3, 3])[0]
    wall = TriangleMesh(np.array([[-2.0, -2, -0.01], [2, -2, -0.01], [0, 3, -0.01]]), np.array([[0, 1, 2]]))
    seen = visible_surface(p, fit, Raycaster(wall))
    assert len(seen) == int(p.mask.sum())
    cast = Raycaster(wall).cast(np.broadcast_to(centre, (len(seen), 3)), -seen.view.double().numpy())
    t = torch.as_tensor(cast.t / UNIT_M)
    before = torch.as_tensor(centre / UNIT_M) - t[:, None] * seen.view
    sdf = lambda x: fit.shape(x.float(), fit.z_sdf)[0].detach()  # noqa: E731
    assert bool((sdf(seen.x).abs() <= sdf(before).abs() + 1e-5).all())


def test_nobody_in_the_picture_is_seen_nowhere(fitted):
    p, fit, mesh = fitted
    away = replace(mesh, vertices=mesh.vertices + np.array([0.0, 0.0, 50.0]))
    seen = visible_surface(p, fit, Raycaster(away))
    assert len(seen) == 0


def test_along_a_cut_the_masks_edge_has_no_room():
    p = portrait()
    left = int(np.flatnonzero(p.mask[45])[0])
    cut = np.zeros_like(p.mask)
    cut[:, : left + 1] = True
    assert [unseen(p, 45, left - k, cut=cut)[1] for k in (-1, 0, 1, 2)] == [False, True, True, True]


def finer(p, times):
    """The same camera with so many times as many pixels a side; its mask is everything, the picture black."""
    k = p.camera.intrinsics * np.array([[times], [times], [1.0]])
    size = times * p.camera.width
    camera = Camera(k, p.camera.world_from_camera, size, size)
    every = np.ones((size, size), bool)
    return replace(p, image_linear=np.zeros((size, size, 3), np.float32), mask=every, camera=camera, saturated=~every)


@pytest.fixture(scope="module", params=[1, 8])
def outlined(request, fitted):
    """A portrait whose mask is what its camera sees of the fitted ball, at two resolutions; pixels of 6 mm; the fit."""
    p, fit, mesh = fitted
    p = finer(replace(p, canonical_from_world=fit.canonical_from_world), request.param)
    rays = pixel_rays(p, *np.nonzero(p.mask))
    cast = Raycaster(mesh).cast(UNIT_M * rays.origins.double().numpy(), rays.directions.double().numpy())
    return replace(p, mask=cast.hit.reshape(p.mask.shape)), round(0.006 * pixels_per_metre(p)), fit, Raycaster(mesh)


def last_pixels(outlined, mask):
    """Pixels of a mask that are along a cut."""
    p, _, fit, caster = outlined
    return mask & cut_region(replace(p, mask=mask), fit, caster)


def test_where_a_mask_cuts_through_the_head_its_last_pixels_are_mixed(outlined):
    whole = outlined[0].mask
    middle = int(np.nonzero(whole.any(1))[0].mean())
    mask = whole & (np.arange(len(whole))[:, None] <= middle)
    expected = np.zeros_like(mask)
    expected[middle] = mask[middle]
    # The straight edge to its ends, and nothing of the outline but where the two meet.
    found = last_pixels(outlined, mask)
    assert expected.sum() > 20
    assert (found & ~expected).sum() <= 2
    assert (expected & ~found).sum() <= 2


def test_what_is_beyond_a_cut_is_of_its_region_and_what_is_beside_the_head_is_not(outlined):
    p, _, fit, caster = outlined
    middle = int(np.nonzero(p.mask.any(1))[0].mean())
    mask = p.mask & (np.arange(len(p.mask))[:, None] <= middle)
    region = cut_region(replace(p, mask=mask), fit, caster)
    assert region[middle + 1][p.mask[middle + 1]].mean() > 0.95
    assert not region[~p.mask].any()


def test_a_mask_that_ends_just_before_the_pictures_border_is_cut(outlined):
    p, _, fit, caster = outlined
    # The picture's border goes through the ball, and the mask ends two columns before it.
    width = int(np.quantile(np.nonzero(p.mask.any(0))[0], 0.85))
    camera = Camera(p.camera.intrinsics, p.camera.world_from_camera, width, p.camera.height)
    mask = p.mask[:, :width].copy()
    mask[:, -2:] = False
    cropped = replace(p, image_linear=p.image_linear[:, :width], mask=mask, camera=camera, saturated=~p.mask[:, :width])
    found = mask & cut_region(cropped, fit, caster)
    assert found[:, -3].sum() >= 0.95 * mask[:, -3].sum() > 10


@pytest.mark.parametrize("share", [-1.0, -0.5, 0.0, 0.5])
def test_an_outline_that_is_met_within_a_strip_is_no_cut(outlined, share):
    """Beside the mask a strip of the ball narrower than 6 mm (two pixels at least) remains, or none."""
    p, strip = outlined[:2]
    away = ndimage.distance_transform_edt(p.mask) - ndimage.distance_transform_edt(~p.mask)
    grown = round(share * max(0.6 * strip, 3.0))
    assert not last_pixels(outlined, away > -grown).any()


def test_a_wider_strip_is_a_cut(outlined):
    p, strip = outlined[:2]
    inside = ndimage.distance_transform_edt(p.mask) > max(2 * strip, 8)
    assert last_pixels(outlined, inside).sum() > 0.9 * (inside & ~ndimage.binary_erosion(inside)).sum()


def test_a_hole_and_the_pictures_border_are_no_cuts(outlined):
    holed = outlined[0].mask.copy()
    row, column = np.argwhere(holed).mean(0).astype(int)
    holed[row - 5 : row + 6, column - 5 : column + 6] = False
    assert not last_pixels(outlined, holed).any()
    assert not last_pixels(outlined, np.ones_like(holed)).any()


def test_hidden_points_are_on_both_sides_of_the_head(fitted):
    p, fit, mesh = fitted
    seen = visible_surface(p, fit, Raycaster(mesh))
    x_ref, gamma = hidden_surface(
        p, fit, mesh, seen, np.zeros_like(p.mask), torch.Generator().manual_seed(0), count=500
    )
    assert len(x_ref) == len(gamma) == 1000
    x_ref, near = x_ref[:500], x_ref[500:]
    # The ball's deformation is all but none, so that a point's place in the reference is its own.
    gap = torch.cdist(near, seen.x).min(1).values * UNIT_M
    assert float(gap.max()) < 1.2 * BESIDE_M
    assert float((torch.cdist(x_ref, seen.x).min(1).values * UNIT_M > BESIDE_M).float().mean()) > 0.5
    # Most of the ball's back, and of its front what this mask, narrower than the ball, leaves out.
    behind = x_ref[:, 2] < 0
    assert 0.5 < float(behind.float().mean()) < 1.0


def test_the_appearance_fit_learns_nothing_from_pixels_along_a_cut_unless_they_are_most(fitted):
    p, fit, mesh = fitted
    seen = visible_surface(p, fit, Raycaster(mesh))
    cut = np.zeros_like(p.mask)
    cut[: int(seen.rays.row.float().quantile(0.3))] = True

    def learnt_from(cut):
        config, generator = AppearanceFitConfig(), torch.Generator().manual_seed(0)
        rays = _seen_surface(p, fit, Raycaster(mesh), cut, config, generator).rays
        return set(zip(rays.row.tolist(), rays.column.tolist(), strict=True))

    everything = set(zip(seen.rays.row.tolist(), seen.rays.column.tolist(), strict=True))
    assert learnt_from(cut) == {(row, column) for row, column in everything if not cut[row, column]}
    assert learnt_from(np.ones_like(cut)) == everything
