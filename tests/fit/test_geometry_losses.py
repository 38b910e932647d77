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


def losses_of_a_fit() -> GeometryLosses:
    prior = ball_prior()
    return GeometryLosses(GEOMETRY, prior, *_pools(portrait(), GEOMETRY, "cpu"), no_evidence(prior, refine_pose=False))


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


def held(covered: list[bool]) -> list[float]:
    """What a change of 0.1 everywhere costs over the right ear, the left ear, and the back of the head."""
    fit = losses_of_a_fit()
    fit.open_cover()
    fit.ears_covered.copy_(torch.tensor(covered))
    before = fit.before.deform
    fit.model.deform = lambda x, z: (before(x, z)[0] + 0.1, None)
    places = [[-0.85, -0.2, -0.7], [0.85, -0.2, -0.7], [0.0, 0.5, -0.7]]
    return [
        float(fit._anchor(torch.tensor([x] * 20000), fit.codes()[0], torch.Generator().manual_seed(1))[0].detach())
        for x in places
    ]


def test_an_ear_that_hair_covers_is_held_more_firmly():
    right, left, rest = held([True, False])
    assert left == rest
    # Besides these points are 256 at random, the same each time.
    more = (GEOMETRY.ear_hold - 1.0) * 3.0 * 0.1**2 * 20000 / (20000 + 256)
    assert right - rest == pytest.approx(more, rel=1e-4)
    assert held([False, True])[::-1][1:] == pytest.approx([right, left], rel=1e-6)
    assert len(set(held([False, False]))) == 1


def test_hair_is_looked_for_once_on_what_the_codes_make():
    fit = losses_of_a_fit()
    kept_in_state = fit.state()["ears_covered"]
    fit.edge.beyond_ears = lambda *_: torch.tensor([0.0, 0.02])
    fit.remember()
    assert kept_in_state.tolist() == [False, True]
    fit.open_networks()
    fit.edge.beyond_ears = lambda *_: torch.tensor([0.02, 0.0])
    fit.remember()
    assert kept_in_state.tolist() == [False, True]


def test_ears_are_spared_where_hair_covers_them_and_networks_are_open():
    fit, spared = losses_of_a_fit(), []
    fit.edge.spare_ears = lambda *given: spared.append(given[-1].tolist())
    fit.ears_covered.copy_(torch.tensor([True, False]))
    fit.retrace(torch.Generator().manual_seed(0))
    assert not spared
    fit.open_networks()
    fit.retrace(torch.Generator().manual_seed(0))
    assert spared == [[True, False]]
    fit.ears_covered.fill_(False)
    fit.retrace(torch.Generator().manual_seed(0))
    assert len(spared) == 1
