"""Rays that a fit follows: how deep they go, and which are followed more often."""

import numpy as np
import pytest
import torch
from ball_prior import ball_prior
from small_portrait import portrait

from sira_assets.fit.kept_rays import KeptRays
from sira_assets.fit.pixels import EAR, PixelRays, on_ears, pixel_rays, silhouette_band
from sira_assets.fit.pose import PoseCorrection

REST = ("rgb", "in_mask", "usable", "row", "column")


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


def given() -> tuple:
    """A ball of one unit, its code and no correction of the pose."""
    prior = ball_prior()
    return prior.shape, prior.z_sdf.mean, PoseCorrection(torch.zeros(3), torch.zeros(3))


def spared(rays: PixelRays, covered=(True, True), ball=1.0) -> tuple[float, KeptRays]:
    """By how much a ray is followed elsewhere, along it, once ears are spared that had been a ball of this size."""
    kept = KeptRays(rays, torch.ones(1), 1)
    model, z, pose = given()
    kept.retrace(model, z, pose)
    nearest = kept.t.clone()
    before = lambda x, _: (x.norm(dim=-1) - ball, x, None)  # noqa: E731
    kept.spare_ears(model, z, pose, before, z, torch.tensor(covered))
    return float(kept.t - nearest), kept


@pytest.mark.parametrize(("x", "covered"), [(0.95, (False, True)), (-0.95, (True, False)), (1.6, (True, True))])
def test_a_ray_that_would_draw_an_ear_out_follows_what_is_next_nearest(x, covered):
    # The ball's side stands in for an ear; above y = 0.22 the ear ends, and the ball is nearest just above it.
    _, kept = spared(beside_an_ear(x, -0.6), covered)
    assert not bool(kept.hit[0])
    at = kept.every.origins + kept.t[:, None] * kept.every.directions
    assert not bool(on_ears(at).any())
    # Places are looked for a step apart.
    assert EAR[1][1] < float(at[0, 1]) < EAR[1][1] + 2.4 / 31


@pytest.mark.parametrize(
    ("rays", "options"),
    [
        (beside_an_ear(0.95, -0.6, in_mask=False), {}),  # background beside an ear
        (beside_an_ear(0.86, -0.55), {}),  # 2 mm off: an ear may be as large as that
        (beside_an_ear(0.78, -0.55), {"ball": 0.8}),  # a hit, though the ear was smaller
        (beside_an_ear(0.3, -1.2), {}),  # behind the head
        (beside_an_ear(0.95, -0.6), {"covered": (True, False)}),  # the other ear is covered
    ],
    ids=["background", "a little", "hit", "behind", "other"],
)
def test_other_rays_stay_where_they_are(rays, options):
    assert spared(rays, **options)[0] == 0.0


def test_where_all_of_a_ray_passes_the_ear_it_stays():
    rays = beside_an_ear(1.0, -0.6)
    outwards = torch.tensor([[1.0, 0.0, 0.0]])
    forward = PixelRays(1.1 * outwards + torch.tensor([[0.0, 0.0, -0.6]]), outwards, *(getattr(rays, n) for n in REST))
    kept = KeptRays(forward, torch.ones(1), 1)
    kept.spare_ears(*given(), *given()[:2], torch.tensor([True, True]), reach=0.1)
    assert float(kept.t) == 0.0


def beyond(beside: list[tuple[float, float]], count: int, *, in_mask: bool = True) -> list[float]:
    """Shares of rays past the right and the left ear, of some past (x, z) and others that hit, `count` in all."""
    rays = [beside_an_ear(*xz, in_mask=in_mask) for xz in beside]
    rays += [beside_an_ear(0.2, 0.1)] * (count - len(beside))
    every = PixelRays(*(torch.cat([getattr(r, name) for r in rays]) for name in PixelRays.__dataclass_fields__))
    kept = KeptRays(every, torch.ones(count), count)
    kept.retrace(*given())
    return kept.beyond_ears(*given()).tolist()


def test_hair_is_told_by_an_outline_further_out_than_ears_are():
    right, left, near, behind = (-1.0, -0.6), (1.7, -0.6), (0.88, -0.55), (0.3, -1.3)
    assert beyond([right, left, left], 100) == pytest.approx([0.01, 0.02])
    assert beyond([near] * 5 + [behind] * 5 + [(0.78, -0.55)] * 5, 100) == [0.0, 0.0]
    assert beyond([right, left], 100, in_mask=False) == [0.0, 0.0]
