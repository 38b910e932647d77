"""The identity warp: statistics of landmarks, orientation, and the named parameters."""

from dataclasses import fields, replace

import numpy as np
import pytest

from data_synth.head.identity import (
    identity_landmarks,
    jacobian_determinant,
    load_population,
    make_warp,
    named_displacement_mm,
    warp_points,
)
from data_synth.head.params import HAIR_STYLES, HeadParams, mean_params, sample_params
from data_synth.head.shape_params import NamedShape
from sira_assets.errors import InputError


def test_mean_head_is_not_warped():
    mean = load_population().mean_m
    x = np.random.default_rng(0).uniform(-0.15, 0.1, (500, 3))
    assert np.abs(warp_points(make_warp(mean_params(), mean), x) - x).max() == 0.0


def test_warp_carries_landmarks_onto_the_person():
    mean = load_population().mean_m
    for seed in range(5):
        identity = np.random.default_rng(seed).normal(size=30)
        warp = make_warp(HeadParams(seed, identity), mean)
        miss = np.linalg.norm(warp_points(warp, mean) - identity_landmarks(identity), axis=1)
        # the regulariser leaves a few tenths of a millimetre of landmarks that move by 4 mm
        assert miss.mean() < 0.6e-3


def test_landmark_statistics_are_the_populations():
    p = load_population()
    rng = np.random.default_rng(3)
    draws = np.stack([identity_landmarks(rng.normal(size=30)) for _ in range(2000)])
    # standard errors over 2000 draws: std / 45 for the mean (<= 0.1 mm), 1.6 % for the spread; 30 directions hold 97 %
    assert np.abs(draws.mean(0) - p.mean_m).max() < 4e-4
    assert np.sqrt(draws.var(0).sum()) == pytest.approx(np.sqrt((p.std_m**2).sum()), rel=0.04)


@pytest.mark.parametrize("seed", range(4))
def test_warp_keeps_orientation_at_three_sigma(seed):
    rng = np.random.default_rng(seed)
    p = load_population()
    identity = np.clip(rng.normal(size=30) * 1.5, -3, 3)
    named = dict(
        zip((f.name for f in fields(NamedShape)), rng.choice([-3.0, 3.0], len(fields(NamedShape))), strict=True)
    )
    named |= {"smile": 1.0, "mouth_open": 1.0, "brow_raise": 1.0}
    warp = make_warp(HeadParams(seed, identity, NamedShape(**named)), p.mean_m)
    x = rng.uniform([-0.13, -0.22, -0.18], [0.13, 0.13, 0.06], (6000, 3))
    x = np.vstack([x, p.mean_m[rng.integers(68, size=2000)] + rng.normal(scale=0.005, size=(2000, 3))])
    assert jacobian_determinant(warp, x).min() > 0.05


COVERED = ("sex", "age", "gaze_left", "gaze_up")  # these choose hair and colour and turn the iris


@pytest.mark.parametrize("name", [f.name for f in fields(NamedShape) if f.name not in COVERED])
def test_every_named_parameter_moves_something_by_millimetres(name):
    rng = np.random.default_rng(0)
    x = rng.uniform([-120, -215, -175], [120, 120, 50], (20000, 3))
    u = named_displacement_mm(x, replace(NamedShape(), **{name: 1.0}))
    assert 0.3 < np.linalg.norm(u, axis=1).max() < 9.0


def test_sampling_is_repeatable_and_covers_every_style():
    a, b = (sample_params(np.random.default_rng(11)) for _ in range(2))
    assert a.seed == b.seed
    assert np.array_equal(a.identity, b.identity)
    assert (a.shape, a.pigment, a.hair_style) == (b.shape, b.pigment, b.hair_style)
    rng = np.random.default_rng(0)
    assert {sample_params(rng).hair_style for _ in range(200)} == set(HAIR_STYLES)


def test_wrong_parameters_are_named():
    with pytest.raises(InputError, match="30 finite identity coefficients"):
        HeadParams(0, np.zeros(29))
    with pytest.raises(InputError, match="hair style"):
        HeadParams(0, hair_style="mullet")
