"""The identity warp: statistics of landmarks, orientation, exactness, and what a head is made from."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from data_synth.head.identity import (
    NAMED_SHARE,
    identity_landmarks,
    jacobian_determinant,
    landmark_coefficients,
    landmark_maps,
    make_warp,
    warp_points,
)
from data_synth.head.params import HAIR_STYLES, HeadParams, mean_params, sample_params
from data_synth.head.population import coefficients, load_population
from data_synth.head.relief_params import RELIEF_NAMES, RELIEF_SIZE
from data_synth.head.shape_params import SIGMA_NAMES, TRAITS, NamedShape, neutral, sample_shape
from sira_assets.errors import InputError


def test_mean_head_is_not_warped():
    mean = load_population().mean_m
    x = np.random.default_rng(0).uniform(-0.15, 0.1, (500, 3))
    assert np.abs(warp_points(make_warp(mean_params(), mean), x) - x).max() == 0.0


def test_coefficients_invert_the_principal_directions():
    c = np.random.default_rng(1).normal(size=30)
    assert np.abs(coefficients(identity_landmarks(c) - load_population().mean_m) - c).max() < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_warp_carries_landmarks_where_the_coefficients_say(seed):
    """Whatever the named parameters push: identity and named parameters together place the landmarks."""
    mean = load_population().mean_m
    rng = np.random.default_rng(seed)
    params = HeadParams(seed, rng.normal(size=30), neutral(sample_shape(rng)))
    miss = np.linalg.norm(
        warp_points(make_warp(params, mean), mean) - identity_landmarks(landmark_coefficients(params)), axis=1
    )
    # the regulariser is 3 % of the prior's deviation: landmarks that move by 4 mm keep a fraction of a millimetre.
    # Inner lips are a millimetre apart; what a lip parameter does to one and not to the other is partly left
    assert miss.mean() < 0.3e-3
    assert miss[:60].max() < 0.8e-3
    assert miss[60:].max() < 2.5e-3


def test_landmark_coefficients_have_unit_covariance_by_construction():
    share, named = landmark_maps()
    assert np.abs(share @ share.T + named @ named.T - np.eye(30)).max() < 1e-12
    assert np.linalg.norm(named, 2) <= np.sqrt(NAMED_SHARE) + 1e-12
    # the identity reaches every direction
    assert np.linalg.eigvalsh(share).min() > 0.5


def test_a_random_population_has_the_landmark_statistics_of_people():
    p = load_population()
    rng = np.random.default_rng(3)
    c = np.stack([landmark_coefficients(sample_params(rng)) for _ in range(600)])
    # standard errors over 600 draws: 0.04 for a mean, 3 % for a deviation; clipping at 3 sigma takes 1.3 %, and the
    # largest of 30 values is some 2.5 errors off
    assert np.abs(c.mean(0)).max() < 0.16
    assert np.abs(c.std(0) - 1.0).max() < 0.12
    draws = p.mean_m + np.einsum("nk,kij->nij", c, p.modes_m)
    spread = np.sqrt(draws.var(0).sum(1)) / np.sqrt((p.std_m**2).sum(1))
    # 30 directions hold 97 % of the variance, a landmark's own share may be less
    assert spread.min() > 0.85
    assert spread.max() < 1.12


@pytest.mark.parametrize("seed", range(4))
def test_warp_keeps_orientation_at_three_sigma(seed):
    """Every named parameter at a bound, with expression, and an identity of 1.5 sigma and more."""
    rng = np.random.default_rng(seed)
    p = load_population()
    identity = np.clip(rng.normal(size=30) * 1.5, -3, 3)
    named = dict(zip(SIGMA_NAMES, rng.choice([-3.0, 3.0], len(SIGMA_NAMES)).tolist(), strict=True))
    furrows = {"forehead_lines": 1.0, "crow_feet": 1.0}
    x = rng.uniform([-0.13, -0.22, -0.18], [0.13, 0.13, 0.06], (4000, 3))
    x = np.vstack([x, p.mean_m[rng.integers(68, size=3000)] + rng.normal(scale=0.005, size=(3000, 3))])
    still = make_warp(HeadParams(seed, identity, NamedShape(**named, **furrows)), p.mean_m)
    assert jacobian_determinant(still, x).min() > 0.02
    expression = {"smile": 1.0, "mouth_open": 1.0, "eyes_closed": 1.0, "brow_raise": 1.0}
    moved = make_warp(HeadParams(seed, identity, NamedShape(**named, **furrows, **expression)), p.mean_m)
    # closed lids leave 6 % of the opening between them
    assert jacobian_determinant(moved, x).min() > 0.0


def test_warps_compose_from_their_linear_parts():
    """Without expression the displacement is linear in identity and named parameters together."""
    mean = load_population().mean_m
    rng = np.random.default_rng(2)
    x = mean[rng.integers(68, size=200)] + rng.normal(scale=0.01, size=(200, 3))
    one = HeadParams(0, rng.normal(size=30), NamedShape(jaw_angle=1.0, nose_hump=-2.0))
    two = HeadParams(0, rng.normal(size=30), NamedShape(jaw_angle=0.5, sex=1.0))
    both = HeadParams(0, one.identity + two.identity, NamedShape(jaw_angle=1.5, nose_hump=-2.0, sex=1.0))
    u = [warp_points(make_warp(p, mean), x) - x for p in (one, two, both)]
    assert np.abs(u[0] + u[1] - u[2]).max() < 1e-12


def test_sampling_is_repeatable_bounded_and_covers_every_style():
    a, b = (sample_params(np.random.default_rng(11)) for _ in range(2))
    assert a.seed == b.seed
    assert np.array_equal(a.identity, b.identity)
    assert np.array_equal(a.relief, b.relief)
    assert (a.shape, a.pigment, a.hair_style) == (b.shape, b.pigment, b.hair_style)
    rng = np.random.default_rng(0)
    heads = [sample_params(rng) for _ in range(200)]
    assert {h.hair_style for h in heads} == set(HAIR_STYLES)
    values = np.array([[getattr(h.shape, n) for n in (*SIGMA_NAMES, *TRAITS)] for h in heads])
    # 200 draws: a deviation is known to 5 %, the largest of 66 to 2.5 times that
    assert np.abs(values).max() <= 3.0
    assert np.abs(values.std(0) - 1.0).max() < 0.2


def test_provenance_is_plain():
    record = asdict(sample_params(np.random.default_rng(0)))
    assert set(record["shape"]) >= set(SIGMA_NAMES)
    assert all(isinstance(v, float) for v in record["shape"].values())
    assert len(record["relief"].tolist()) == RELIEF_SIZE == len(set(RELIEF_NAMES))


def test_wrong_parameters_are_named():
    with pytest.raises(InputError, match="30 finite identity coefficients"):
        HeadParams(0, np.zeros(29))
    with pytest.raises(InputError, match="finite relief coefficients"):
        HeadParams(0, relief=np.full(RELIEF_SIZE, np.nan))
    with pytest.raises(InputError, match="hair style"):
        HeadParams(0, hair_style="mullet")
    with pytest.raises(InputError, match="jaw_angle within -3 and 3"):
        NamedShape(jaw_angle=3.5)
    with pytest.raises(InputError, match="smile within 0 and 1"):
        replace(NamedShape(), smile=-0.1)
