"""Terms of the geometry fit's loss, by changes of the deformation whose answer is known."""

import pytest
import torch
from ball_prior import ball_prior
from small_portrait import portrait
from test_fit import GEOMETRY

from sira_assets.fit.geometry import _pools
from sira_assets.fit.geometry_losses import GeometryLosses
from sira_assets.fit.shading import no_evidence

CHANGES = {
    # Features on both sides: sideways odd, up and forward even.
    "mirrored": lambda x: torch.stack([0.1 * x[:, 0], 0.2 * x[:, 0].square(), 0.3 * x[:, 0].cos()], -1),
    "turned": lambda x: torch.stack([0.1 * torch.ones_like(x[:, 0]), 0.2 * x[:, 0], 0.3 * x[:, 0].sin()], -1),
}


def lopsided(change, x) -> float:
    """The term of a change of the deformation at points x."""
    prior = ball_prior()
    fit = GeometryLosses(GEOMETRY, prior, *_pools(portrait(), GEOMETRY, "cpu"), no_evidence(prior), refine_pose=False)
    before = fit.before.deform
    fit.model.deform = lambda x, z: (before(x, z)[0] + change(x), None)
    return float(fit._lopsided(x, fit.codes()[0]).detach())


@pytest.fixture
def face():
    generator = torch.Generator().manual_seed(0)
    x = torch.rand(200, 3, generator=generator) * torch.tensor([1.0, 1.0, 0.5])
    return x + torch.tensor([-0.5, -0.9, 0.3])


def test_a_change_that_is_its_own_mirror_image_is_free(face):
    assert lopsided(CHANGES["mirrored"], face) == pytest.approx(0.0, abs=1e-12)


def test_one_that_turns_or_shears_costs_twice_its_odd_half_squared(face):
    odd = 2.0 * CHANGES["turned"](face)
    assert lopsided(CHANGES["turned"], face) == pytest.approx(float(odd.square().sum(-1).mean()), rel=1e-5)


def test_only_the_face_is_held_to_be_alike_on_both_sides(face):
    beside = face + torch.tensor([2.0, 0.0, 0.0])
    assert lopsided(CHANGES["turned"], beside) == 0.0
    behind = face * torch.tensor([1.0, 1.0, -1.0])
    assert lopsided(CHANGES["turned"], behind) == 0.0
