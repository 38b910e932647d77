"""Named shape, traits and expression: what each does, where, and that left and right agree."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.head.bells import REACH, Bells, bell, sum_bells
from data_synth.head.expression import SLIT, expression_mm
from data_synth.head.identity import identity_landmarks, landmark_coefficients
from data_synth.head.named import NAMES, PUSHES, SCALED, named_displacement_mm
from data_synth.head.params import HeadParams
from data_synth.head.population import load_population
from data_synth.head.shape_params import AMOUNTS, EXPRESSION, SIGMA_NAMES, NamedShape
from data_synth.head.template import load_template
from data_synth.head.traits import LOADINGS, effective_values, trait_coefficients, trait_loadings

MIRROR = np.array([-1.0, 1.0, 1.0])


def points(count: int = 20_000, seed: int = 0) -> np.ndarray:
    """Around the head, millimetres, more on the face."""
    rng = np.random.default_rng(seed)
    wide = rng.uniform([-120, -215, -175], [120, 120, 50], (count // 2, 3))
    near = load_population().mean_m[rng.integers(68, size=count // 2)] * 1e3 + rng.normal(scale=6, size=(count // 2, 3))
    return np.vstack([wide, near])


def one(name: str) -> np.ndarray:
    """Values with a single parameter at 1."""
    return np.eye(len(NAMES))[NAMES.index(name)]


def test_bell_is_close_to_the_gaussian_and_ends_smoothly():
    r = np.linspace(0.0, 5.0, 2001)
    b = bell(r**2)
    assert b[0] == 1.0
    assert (b[r >= REACH] == 0.0).all()
    # the largest gap of (1 - a/6)^6 to exp(-a) is 0.046, at a = 2
    assert np.abs(b - np.exp(-0.5 * r**2)).max() < 0.05
    assert np.abs(np.diff(b, 5)[np.abs(r[:-5] - REACH) < 0.1]).max() < 1e-9


def test_sum_of_bells_is_the_plain_sum():
    rng = np.random.default_rng(0)
    bells = Bells(rng.normal(size=(40, 3)) * 40, rng.uniform(2, 20, (40, 3)), rng.normal(size=(40, 2)))
    x = rng.normal(size=(3000, 3)) * 50
    q = ((x[:, None] - bells.centre_mm) / bells.width_mm) ** 2
    # order of summation differs: rounding of forty terms
    assert np.abs(sum_bells(bells, x) - bell(q.sum(-1)) @ bells.vector).max() < 1e-12


def test_every_parameter_has_its_place():
    assert set(PUSHES) | set(SCALED) == set(NAMES) == {*SIGMA_NAMES, *AMOUNTS}
    assert not set(PUSHES) & set(SCALED)


@pytest.mark.parametrize("name", NAMES)
def test_every_named_parameter_moves_its_part_by_millimetres(name):
    x = points()
    u = named_displacement_mm(x, one(name))
    length = np.linalg.norm(u, axis=1)
    assert 0.25 < length.max() < 9.0
    if name in PUSHES:
        # local: nothing beyond the bells
        middle = np.array([p.centre for p in PUSHES[name]])
        width = np.array([max(p.width) for p in PUSHES[name]])
        near, mirrored = (np.linalg.norm(q[:, None] - middle, axis=2) / width for q in (x, x * MIRROR))
        folded = np.minimum(near, mirrored).min(1)
        assert (length[folded > REACH] == 0.0).all()


@pytest.mark.parametrize("name", [n for n in NAMES if not n.startswith("asymmetry")])
def test_named_parameters_are_symmetric(name):
    x = points(4000)
    u, v = named_displacement_mm(x, one(name)), named_displacement_mm(x * MIRROR, one(name))
    assert np.abs(u - v * MIRROR).max() < 1e-9


def test_traits_keep_unit_variance_and_change_what_they_should():
    m = trait_loadings()
    assert ((m**2).sum(1) < 0.9).all()
    rng = np.random.default_rng(0)
    own, traits = rng.normal(size=(4000, len(NAMES))), rng.normal(size=(4000, 3))
    effective = np.stack([effective_values(a, t) for a, t in zip(own, traits, strict=True)])
    # 4000 draws: a deviation is known to 1.1 %, the largest of 64 to 3.5 times that
    assert np.abs(effective.std(0) - 1.0).max() < 0.045
    assert {n for t in LOADINGS.values() for n in t} <= set(SIGMA_NAMES)


def test_men_have_wider_jaws_and_noses_as_published():
    """Zhuang and Bradtmiller 2005, relative to face size: jaw and nose wider, eyes closer together."""
    x = [identity_landmarks(trait_coefficients() @ [s, 0, 0]) for s in (-0.85, 0.85)]

    def ratio(a: int, b: int, axis: int) -> float:
        return float((x[1][b, axis] - x[1][a, axis]) / (x[0][b, axis] - x[0][a, axis]))

    # the published ratios over the mean ratio of sizes, met to the tolerance of 0.3 mm a sigma
    assert ratio(4, 12, 0) == pytest.approx(1.094 / 1.068, abs=0.012)
    assert ratio(31, 35, 0) == pytest.approx(1.102 / 1.068, abs=0.035)
    assert ratio(36, 45, 0) < 1.0
    # a sex difference is no unusual head: within a deviation and a half
    assert np.linalg.norm(trait_coefficients()[:, 0]) < 1.5


def test_weight_widens_the_jaw_and_age_thins_the_lips():
    mean = load_population().mean_m
    heavy = identity_landmarks(landmark_coefficients(HeadParams(0, shape=NamedShape(weight=2.0))))
    assert heavy[12, 0] - heavy[4, 0] > mean[12, 0] - mean[4, 0] + 1e-3
    old = identity_landmarks(landmark_coefficients(HeadParams(0, shape=NamedShape(age=1.7))))
    assert old[51, 1] - old[62, 1] < mean[51, 1] - mean[62, 1]


def test_expression_is_none_when_neutral_and_symmetric():
    x = points(4000)
    assert np.abs(expression_mm(x, NamedShape(gaze_left=1.0, gaze_up=-1.0))).max() == 0.0
    for name in EXPRESSION[:4]:
        s = replace(NamedShape(), **{name: 1.0})
        u, v = expression_mm(x, s), expression_mm(x * MIRROR, s)
        assert 1.0 < np.abs(u).max() < 12.0
        assert np.abs(u - v * MIRROR).max() < 1e-9


def test_closed_lids_meet_and_slide_over_the_eyeball():
    t = load_template()
    e = t.lids.double().numpy()
    eye, radius = t.eyeball[:3].double().numpy(), np.exp(t.eyeball[3:].double().numpy())
    x = np.linspace(26.0, 36.0, 21)
    a = (2 * x - (e[0] + e[3])) / (e[3] - e[0])
    line = e[1] + (e[4] - e[1]) * 0.5 * (a + 1)
    upper, lower = line + e[6] * (1 - a * a) * (1 + e[7] * a), line - e[8] * (1 - a * a) * (1 + e[9] * a)

    def front(x, y):
        return eye[2] + radius[2] * np.sqrt(1 - ((x - eye[0]) / radius[0]) ** 2 - ((y - eye[1]) / radius[1]) ** 2)

    closed = NamedShape(eyes_closed=1.0)
    edges = [np.stack([x, y, front(x, y)], 1) for y in (upper, lower)]
    moved = [p + expression_mm(p, closed) for p in edges]
    assert moved[0][:, 1] - moved[1][:, 1] == pytest.approx(SLIT * (upper - lower), rel=1e-6)
    for p in moved:
        # the level of the eyeball's front is smoothed where it turns away: tenths of a millimetre
        assert np.abs(p[:, 2] - front(p[:, 0], p[:, 1])).max() < 0.3
