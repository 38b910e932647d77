"""Rays that a fit follows: how deep they go, and which are followed more often."""

import numpy as np
import pytest
import torch
from ball_prior import ball_prior
from small_portrait import portrait

from sira_assets.fit.kept_rays import KeptRays
from sira_assets.fit.pixels import pixel_rays, silhouette_band
from sira_assets.fit.pose import PoseCorrection


@pytest.fixture(scope="module")
def followed():
    """All rays of the band, and whether each is on the wrong side of the ball's silhouette."""
    p, prior = portrait(), ball_prior()
    every = pixel_rays(p, *silhouette_band(p))
    rays = KeptRays(every, torch.ones(len(every)), len(every))
    given = (prior.shape, prior.z_sdf.mean, PoseCorrection(torch.zeros(3), torch.zeros(3)))
    rays.retrace(*given)
    wrong = rays.hit != every.in_mask
    assert 0.02 < float(wrong.float().mean()) < 0.98
    return rays, wrong, given


def test_rays_on_the_wrong_side_are_followed_more_often(followed):
    rays, wrong, given = followed
    rays.attend(30.0, len(rays.every), *given)
    assert torch.equal(rays.weight, torch.where(wrong, 30.0, 1.0))


@pytest.mark.parametrize("step", [2, 3, 7])
def test_of_too_many_each_that_is_traced_stands_for_those_behind_it(followed, step):
    rays, wrong, given = followed
    rays.weight.fill_(5.0)
    rays.attend(30.0, -(-len(rays.every) // step), *given)
    stand_in = np.arange(len(rays.every)) // step * step
    assert torch.equal(rays.weight, torch.where(wrong[stand_in], 30.0, 1.0))
    # Rays come row by row, so that neighbours stand for each other: far fewer mistakes than by chance.
    chance = 2.0 * float(wrong.float().mean()) * float((~wrong).float().mean())
    assert float((wrong[stand_in] != wrong).float().mean()) < 0.5 * chance


def test_the_lowest_value_behind_a_hit_is_how_deep_it_goes(followed):
    rays, _, (model, z, pose) = followed
    rays.retrace(model, z, pose)
    grazing = rays.t.clone()
    rays.deepest(model, z, pose)
    every = rays.every
    at = every.origins + rays.t[:, None] * every.directions
    with torch.no_grad():
        f = model(at, z)[0]
    hit = rays.hit
    torch.testing.assert_close(rays.lowest[hit], f[hit], atol=1e-5, rtol=0)
    assert bool((rays.t[~hit] == grazing[~hit]).all())
    # Of a ball of one unit a ray that passes its centre at b goes 1 - b deep; samples are 0.055 apart, half a step off.
    b = torch.linalg.cross(every.origins, every.directions).norm(dim=-1)
    near = hit & (1.0 - b < 0.15)
    assert int(near.sum()) > 50
    assert float((rays.lowest + 1.0 - b)[near].abs().max()) < 0.02
