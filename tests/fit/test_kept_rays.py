"""Rays that a fit follows: how deep they go, and which are followed more often."""

import numpy as np
import pytest
import torch
from ball_prior import ball_prior
from small_portrait import portrait

from sira_assets.fit.kept_rays import KeptRays
from sira_assets.fit.pixels import EAR, PixelRays, on_ear, pixel_rays, silhouette_band
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


def beside_an_ear(x: float, z: float, *, in_mask: bool = True) -> PixelRays:
    """A ray downwards past a ball of one unit, nearest to it at (x, 0, z)."""
    one = torch.ones(1, dtype=torch.int64)
    origin = torch.tensor([[x, 3.0, z]])
    mask = torch.tensor([in_mask])
    return PixelRays(origin, torch.tensor([[0.0, -1.0, 0.0]]), torch.ones(1, 3), mask, mask, one, one)


def spared(rays: PixelRays) -> tuple[float, KeptRays]:
    """By how much a ray is followed elsewhere once ears are spared, along it."""
    prior = ball_prior()
    kept = KeptRays(rays, torch.ones(1), 1)
    given = (prior.shape, prior.z_sdf.mean, PoseCorrection(torch.zeros(3), torch.zeros(3)))
    kept.retrace(*given)
    nearest = kept.t.clone()
    kept.spare_ears(*given, prior.shape, prior.z_sdf.mean)
    return float(kept.t - nearest), kept


def test_a_ray_that_only_an_ear_drawn_out_would_meet_follows_what_is_next_nearest():
    # The ball's side stands in for an ear; above y = 0.22 the ear ends, and the ball is nearest just above it.
    moved, kept = spared(beside_an_ear(0.95, -0.6))
    top = EAR[1][1]
    step = 2.4 / 31
    assert not bool(kept.hit[0])
    # The nearest place is found to a few hundredths, as f is flat there; places are looked for a step apart.
    assert -(top + step) - 0.05 < moved < -top + 0.05
    at = kept.every.origins + kept.t[:, None] * kept.every.directions
    assert not bool(on_ear(at)[0])


@pytest.mark.parametrize(
    "rays",
    [
        beside_an_ear(0.95, -0.6, in_mask=False),  # background beside an ear
        beside_an_ear(0.86, -0.55),  # 2 mm off: an ear may be as large as that
        beside_an_ear(0.7, -0.6),  # a hit
        beside_an_ear(0.3, -1.2),  # behind the head
    ],
    ids=["background", "a little", "hit", "behind"],
)
def test_other_rays_stay_where_they_are(rays):
    assert spared(rays)[0] == 0.0


def test_where_all_of_a_ray_passes_the_ear_it_stays():
    rays = beside_an_ear(1.0, -0.6)
    forward = PixelRays(
        torch.tensor([[1.1, 0.0, -0.6]]),
        torch.tensor([[1.0, 0.0, 0.0]]),
        rays.rgb,
        rays.in_mask,
        rays.usable,
        *[rays.row] * 2,
    )
    prior = ball_prior()
    kept = KeptRays(forward, torch.ones(1), 1)
    given = (prior.shape, prior.z_sdf.mean, PoseCorrection(torch.zeros(3), torch.zeros(3)))
    kept.spare_ears(*given, *given[:2], reach=0.1)
    assert float(kept.t) == 0.0


def rays_past_ears(beside: list[tuple[float, float]], count: int) -> bool:
    """Whether hair covers ears, of rays past them and others that hit, `count` in all."""
    rays = [beside_an_ear(*xz) for xz in beside] + [beside_an_ear(0.2, 0.1)] * (count - len(beside))
    every = PixelRays(*(torch.cat([getattr(r, name) for r in rays]) for name in PixelRays.__dataclass_fields__))
    kept = KeptRays(every, torch.ones(count), count)
    prior = ball_prior()
    given = (prior.shape, prior.z_sdf.mean, PoseCorrection(torch.zeros(3), torch.zeros(3)))
    kept.retrace(*given)
    return bool(kept.hair_over_ears(*given))


def test_hair_covers_ears_where_the_outline_is_further_out_than_ears_are():
    out, near, behind = (1.0, -0.6), (0.88, -0.55), (0.3, -1.3)
    assert rays_past_ears([out] * 2, 200)
    assert rays_past_ears([(-1.0, -0.6)] * 2, 200)
    assert not rays_past_ears([out], 200)
    assert not rays_past_ears([near] * 50, 200)
    assert not rays_past_ears([behind] * 50, 200)
