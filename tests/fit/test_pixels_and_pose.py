"""Rays of a portrait in the canonical frame, the silhouette band, and the pose correction."""

from dataclasses import replace

import numpy as np
import torch
from small_portrait import portrait

from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import load_prior
from sira_assets.fit.pixels import CUT_Y_M, face_weight, mask_rays, on_ears, pixels_per_metre, silhouette_band
from sira_assets.fit.pose import PoseCorrection, corrected, rotation_matrix
from sira_assets.scene.canonical import transform_points


def test_rays_pass_through_what_projects_to_their_pixels():
    p = portrait()
    rays = mask_rays(p)
    x_canonical = (rays.origins + 9.0 * rays.directions).double().numpy() * UNIT_M
    u, depth = p.camera.project(transform_points(p.world_from_canonical, x_canonical))
    assert (depth > 0).all()
    # float32 rays of length 0.9 m seen with a focal length of 192 px
    np.testing.assert_allclose(u[:, 0], rays.column.numpy() + 0.5, atol=1e-3)
    np.testing.assert_allclose(u[:, 1], rays.row.numpy() + 0.5, atol=1e-3)
    assert len(rays) == p.mask.sum()


def test_scale_of_the_picture_is_focal_length_over_depth():
    p = portrait(scale=1.3)
    # One canonical metre at depth 1 canonical metre, focal length 192 px, whatever the world's scale.
    assert abs(pixels_per_metre(p) - 192.0) < 1e-6


def test_band_hugs_the_edge_and_leaves_out_the_cut_below_the_chin():
    p = portrait()
    rows, columns = silhouette_band(p)
    outside = ~p.mask[rows, columns]
    assert outside.any()
    assert (~outside).any()
    # The plane z = 0 stands one metre away and is centred 5 cm above the picture's centre.
    y = -0.05 - (rows + 0.5 - 48) / 192.0
    assert (y[outside] > CUT_Y_M - 1e-6).all()


def test_faces_are_drawn_more_often():
    p = portrait()
    weight = face_weight(mask_rays(p))
    assert set(weight.tolist()) <= {1.0, 3.0}
    assert (weight == 3.0).any()


def test_pose_correction_is_a_rigid_motion_of_rays():
    w, u = torch.tensor([0.1, -0.2, 0.05]), torch.tensor([0.3, 0.1, -0.2])
    correction = PoseCorrection(w, u)
    r = rotation_matrix(w.double())
    torch.testing.assert_close(r @ r.T, torch.eye(3, dtype=torch.float64), atol=1e-14, rtol=0)
    torch.testing.assert_close(r @ w.double(), w.double(), atol=1e-14, rtol=0)  # the axis stays
    o, d = torch.randn(20, 3), torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)
    o2, d2 = corrected(correction, o, d)
    # the correction as a matrix in metres says the same as the correction of rays in network units
    x = (o + 2.0 * d).double().numpy() * UNIT_M
    moved = transform_points(correction.matrix(), x) / UNIT_M
    np.testing.assert_allclose((o2 + 2.0 * d2).numpy(), moved, atol=1e-5)


def test_rays_keep_their_digits_where_networks_run_in_bfloat16():
    correction = PoseCorrection(torch.tensor([0.1, -0.2, 0.05]), torch.tensor([0.3, 0.1, -0.2]))
    o, d = 12.0 * torch.randn(20, 3), torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)
    with torch.autocast("cpu", torch.bfloat16):
        low = corrected(correction, o, d)
    for a, b in zip(low, corrected(correction, o, d), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_rotation_has_a_gradient_at_zero():
    w = torch.zeros(3, requires_grad=True)
    rotation_matrix(w)[0, 1].backward()
    torch.testing.assert_close(w.grad, torch.tensor([0.0, 0.0, -1.0]))


def test_what_was_not_exposed_says_nothing_and_what_is_merely_dark_does():
    p = portrait()
    rows, columns = np.nonzero(p.mask)
    image = np.full_like(p.image_linear, 0.5)
    image[rows[0], columns[0]] = 0.0
    image[rows[1], columns[1]] = (0.0, 0.001, 0.0)  # three 8-bit steps in one channel
    usable = mask_rays(replace(p, image_linear=image)).usable
    assert not usable[0]
    assert usable[1:].all()


def test_ears_are_on_both_sides_and_nothing_else_is_one():
    prior = load_prior()
    ears = torch.tensor([[0.88, -0.2, -0.7], [-0.88, -0.2, -0.7], [1.9, 0.1, -0.8]])
    rest = torch.tensor([[0.0, -0.3, 0.4], [0.7, -0.2, 0.0], [0.8, 0.5, -0.6], [0.85, -0.2, -1.3], [0.6, -0.2, -0.7]])
    assert on_ears(ears).tolist() == [[False, True], [True, False], [False, True]]
    assert not bool(on_ears(rest).any())
    # Whatever of the shipped mean head lies further out than 7.6 cm, brows and below, is ear.
    grid = torch.cartesian_prod(
        torch.linspace(0.7, 1.2, 50), torch.linspace(-0.7, 0.2, 60), torch.linspace(-1.4, 0.4, 90)
    )
    with torch.no_grad():
        f, x_ref, _ = prior.shape(grid, prior.z_sdf.mean)
    outer = (f < 0) & (x_ref[:, 0] > 0.76)
    assert int(outer.sum()) > 500
    assert bool(on_ears(x_ref[outer])[:, 1].all())
