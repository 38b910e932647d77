"""Shadows in the appearance fit: what it needs of them, and what clipped pixels say."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sira_assets.fit.appearance_losses import colour_error
from sira_assets.fit.decision import FitDecision
from sira_assets.fit.pixels import PixelRays
from sira_assets.fit.required import Evidence, needed_lobes, needed_shadows
from sira_assets.fit.seen_surface import SurfacePoints
from sira_assets.numerics.srgb import srgb_decode, srgb_encode


def points(rgb, usable) -> SurfacePoints:
    n = len(rgb)
    normals = torch.tensor([[0.0, 0.0, 1.0]]).expand(n, 3)
    flags, index = torch.ones(n, dtype=torch.bool), torch.arange(n)
    rays = PixelRays(normals, normals, rgb, flags, usable, index, index)
    return SurfacePoints(normals, normals, normals, normals, normals, rays)


def test_clipped_channels_ask_for_white_or_brighter_only():
    rgb = torch.tensor([[1.0, 0.5, 1.0]])
    linear = torch.tensor([[3.0, 0.2, 0.5]], requires_grad=True)
    error = colour_error(linear, points(rgb, torch.tensor([False])))
    expected = (abs(float(srgb_encode(torch.tensor(0.2))) - 0.5) + 1.0 - float(srgb_encode(torch.tensor(0.5)))) / 3
    assert float(error.detach()) == pytest.approx(expected, abs=1e-6)
    error.backward()
    assert float(linear.grad[0, 0]) == 0.0  # brighter than white is right
    assert float(linear.grad[0, 2]) < 0.0  # darker is not


def test_too_bright_a_model_is_pulled_back_where_the_photo_is_not_clipped():
    """The encoding ends at white; the error goes on, with the slope it has there."""
    linear = torch.tensor([[1.0 - 1e-4, 1.0 + 1e-4, 4.0]], requires_grad=True)
    error = colour_error(linear, points(torch.full((1, 3), 0.9), torch.tensor([True])))
    error.backward()
    slope = 3 * linear.grad[0]
    torch.testing.assert_close(slope, torch.full((3,), 1.055 / 2.4), rtol=1e-3, atol=0.0)


def test_squared_errors_weigh_the_few_pixels_that_are_far_off():
    rgb = torch.full((4, 3), 0.5)
    off = torch.tensor([0.0, 0.01, 0.01, 0.3])[:, None].expand(4, 3)
    seen = points(rgb, torch.ones(4, dtype=torch.bool))
    linear = srgb_decode(rgb + off)
    assert float(colour_error(linear, seen)) == pytest.approx(0.08, abs=1e-6)
    expected = 0.08 + 12 * (2 * 0.01**2 + 0.3**2) / 4
    assert float(colour_error(linear, seen, squared=12.0)) == pytest.approx(expected, rel=1e-5)
    # Of a clipped channel, being brighter still costs nothing.
    clipped = points(torch.ones(1, 3), torch.tensor([False]))
    assert float(colour_error(torch.full((1, 3), 5.0), clipped, squared=12.0)) == 0.0


def evidence(visibility) -> Evidence:
    light = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]), torch.tensor([10.0, 10.0]), torch.ones(2, 3)
    flags = torch.ones(6, dtype=torch.bool)
    return Evidence(points(torch.zeros(6, 3), flags), light, visibility)


def test_shadows_that_hide_nothing_are_left_out_and_those_that_do_are_not():
    kept, cast, (decision,) = needed_shadows(evidence(torch.ones(6, 2)))
    assert not cast
    assert kept.visibility is None
    assert decision == FitDecision("shadows", "none", "the head itself hides 0 % of the light on the seen surface")
    half = torch.ones(6, 2)
    half[:3, 0] = 0.0
    kept, cast, (decision,) = needed_shadows(evidence(half))
    assert cast
    assert decision.chosen == "cast"
    assert kept.visibility is not None


def test_without_shadows_in_the_fit_there_is_no_decision_about_them():
    assert needed_shadows(evidence(None))[1:] == (False, ())


def test_a_lobe_that_stands_behind_the_head_is_left_out():
    hidden = torch.ones(6, 2)
    hidden[:, 1] = 0.0
    kept, decision = needed_lobes(evidence(hidden), sought=2, merging=0.0)
    assert decision.chosen == "1 of 2"
    assert kept.visibility.shape == (6, 1)
    kept, decision = needed_lobes(replace(evidence(None)), sought=2, merging=0.0)
    assert decision.chosen == "2 of 2"
    kept, decision = needed_lobes(replace(evidence(None)), sought=5, merging=0.0013)
    assert decision.chosen == "2 of 5"
    assert "0.0013" in decision.evidence


def test_evidence_is_a_part_of_the_points_with_their_own_shares():
    many = points(torch.zeros(100, 3), torch.ones(100, dtype=torch.bool))
    shares = torch.arange(200.0).view(100, 2)
    some = Evidence.of(many, evidence(None).lobes, shares, at_most=30)
    np.testing.assert_array_equal(some.visibility.numpy(), shares[::3].numpy())
    assert len(some.points) == 34
