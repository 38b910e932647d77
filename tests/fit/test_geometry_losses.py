"""Terms of the geometry fit's loss, by changes of the deformation whose answer is known."""

import pytest
import torch
from ball_prior import ball_prior
from small_portrait import portrait
from test_fit import GEOMETRY

from sira_assets.fit.geometry import _pools
from sira_assets.fit.geometry_losses import EAR_HOLD, GeometryLosses
from sira_assets.fit.shading import no_evidence

CHANGES = {
    # Features on both sides: sideways odd, up and forward even.
    "mirrored": lambda x: torch.stack([0.1 * x[:, 0], 0.2 * x[:, 0].square(), 0.3 * x[:, 0].cos()], -1),
    "turned": lambda x: torch.stack([0.1 * torch.ones_like(x[:, 0]), 0.2 * x[:, 0], 0.3 * x[:, 0].sin()], -1),
}


def losses_of_a_fit() -> GeometryLosses:
    prior = ball_prior()
    return GeometryLosses(GEOMETRY, prior, *_pools(portrait(), GEOMETRY, "cpu"), no_evidence(prior), refine_pose=False)


def lopsided(change, x) -> float:
    """The term of a change of the deformation at points x."""
    fit = losses_of_a_fit()
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


def test_phase_b_alone_asks_for_both_sides_alike():
    fit = losses_of_a_fit()
    terms = lambda: fit.losses(torch.Generator().manual_seed(1), geometry=True, share=0.5)  # noqa: E731
    fit.retrace(torch.Generator().manual_seed(0))
    assert not {"symmetry", "anchor"} & terms().keys()
    fit.open_networks()
    assert {"symmetry", "anchor"} <= terms().keys()
    fit.open_cover()
    assert "symmetry" not in terms()


def test_phase_c_holds_what_is_seen_most_strongly_at_first():
    fit = losses_of_a_fit()
    fit.retrace(torch.Generator().manual_seed(0))
    fit.open_cover()
    before = fit.before.deform
    fit.model.deform = lambda x, z: (before(x, z)[0] + 0.1, before(x, z)[1])
    held = [
        float(fit.losses(torch.Generator().manual_seed(1), geometry=True, share=share)["anchor"].detach())
        for share in (0.0, 0.5, 1.0)
    ]
    first = GEOMETRY.hold_first
    assert held[0] / held[2] == pytest.approx(first, rel=1e-5)
    assert held[1] / held[2] == pytest.approx(first**0.5, rel=1e-5)


def test_an_ear_that_hair_covers_is_held_more_firmly():
    fit = losses_of_a_fit()
    fit.open_cover()
    fit.ears_covered.fill_(True)
    before, shift = fit.before.deform, 0.1
    fit.model.deform = lambda x, z: (before(x, z)[0] + shift, None)
    count = 20000
    held = [
        float(fit._anchor(x.expand(count, 3), fit.codes()[0], torch.Generator().manual_seed(1))[0].detach())
        for x in (torch.tensor([0.85, -0.2, -0.7]), torch.tensor([-0.85, -0.2, -0.7]), torch.tensor([0.0, 0.5, -0.7]))
    ]
    # Besides these points are 256 at random, the same each time.
    more = (EAR_HOLD - 1.0) * 3.0 * shift**2 * count / (count + 256)
    assert held[0] == held[1]
    assert held[0] - held[2] == pytest.approx(more, rel=1e-4)


def test_what_covered_ears_once_covers_them_for_good():
    fit = losses_of_a_fit()
    fit.retrace(torch.Generator().manual_seed(0))
    fit.edge.hair_over_ears = lambda *_: torch.tensor(True)
    fit.remember()
    assert bool(fit.ears_covered)
    fit.edge.hair_over_ears = lambda *_: torch.tensor(False)
    fit.remember()
    assert bool(fit.ears_covered)
    # And a fit that is gone on from knows it.
    assert fit.state()["ears_covered"] is fit.ears_covered
