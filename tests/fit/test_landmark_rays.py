"""Rays through the landmarks that a portrait was posed by."""

from dataclasses import replace

import numpy as np
import torch
from ball_prior import ball_prior
from small_portrait import portrait

from sira_assets.fields.mlp import UNIT_M
from sira_assets.fit.landmark_rays import landmark_offsets, landmark_rays
from sira_assets.fit.pose import PoseCorrection
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, transform_points
from sira_assets.scene.reduce import reduced


def posed_by_landmarks():
    """The small portrait, with the pixels of the canonical landmarks themselves."""
    given = portrait()
    places = transform_points(given.world_from_canonical, np.array(list(CANONICAL_LANDMARKS_M.values())))
    pixels, _ = given.camera.project(places)
    return replace(given, landmarks_px=dict(zip(CANONICAL_LANDMARKS_M, pixels, strict=True)))


def no_turn():
    return PoseCorrection(torch.zeros(3), torch.zeros(3))


def test_the_mean_head_has_its_landmarks_on_their_rays():
    prior = ball_prior()
    rays = landmark_rays(posed_by_landmarks(), prior)
    r, dr = landmark_offsets(rays, prior.shape, prior.z_sdf.mean, prior.z_sdf.basis, no_turn())
    # Pixels to canonical units and back in float32, a metre or so away.
    torch.testing.assert_close(r, torch.zeros(9, 3), rtol=0, atol=1e-4)
    across = (rays.directions[:, :, None] * dr).sum(1)
    torch.testing.assert_close(across, torch.zeros_like(across), rtol=0, atol=1e-4)


def test_a_corrected_pose_moves_the_offsets_as_its_matrix_moves_points():
    prior, given = ball_prior(), posed_by_landmarks()
    turn = PoseCorrection(torch.tensor([0.05, -0.03, 0.02]), torch.tensor([0.04, 0.01, -0.1]))
    moved = replace(given, canonical_from_world=turn.matrix() @ given.canonical_from_world)
    offsets = lambda p, c: landmark_offsets(  # noqa: E731
        landmark_rays(p, prior), prior.shape, prior.z_sdf.mean, prior.z_sdf.basis, c
    )[0]
    torch.testing.assert_close(offsets(given, turn), offsets(moved, no_turn()), rtol=0, atol=1e-4)
    assert offsets(given, turn).norm(dim=-1).min() > 0.01


def test_a_reduced_photo_has_the_same_rays():
    prior, given = ball_prior(), posed_by_landmarks()
    fewer = reduced(given, max(given.mask.shape) // 2)
    assert fewer.mask.shape != given.mask.shape
    one, other = landmark_rays(given, prior), landmark_rays(fewer, prior)
    torch.testing.assert_close(one.origins, other.origins)
    torch.testing.assert_close(one.directions, other.directions)
    assert one.sigma.min() * UNIT_M >= 0.002


def test_a_given_pose_has_none():
    prior = ball_prior()
    rays = landmark_rays(portrait(), prior)
    r, dr = landmark_offsets(rays, prior.shape, prior.z_sdf.mean, prior.z_sdf.basis, no_turn())
    assert len(rays) == 0
    assert r.shape == (0, 3)
    assert dr.shape == (0, 3, prior.z_sdf.basis.shape[1] + 6)
