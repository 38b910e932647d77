"""Material at every point: in range at the extremes, smooth enough to be learnt, the same for the same seed."""

from dataclasses import fields, replace

import numpy as np
import pytest

from data_synth.head.cloth import HIGHEST_MM, cloth_layer
from data_synth.head.cover_params import GARMENTS, HEADWEAR, PATTERNS, Groom, Pigment
from data_synth.head.cover_sampling import sample_dress, sample_groom, sample_pigment, sample_style
from data_synth.head.eyes import eye_colour
from data_synth.head.material import KS_RANGE, Region, evaluate_material, region_of
from data_synth.head.params import mean_params, sample_params
from data_synth.head.shape_params import NamedShape

pytestmark = pytest.mark.slow  # the scalp's distance takes seconds, once a process

# limits of every strength that is not 0 to 1
PIGMENT_LIMITS = {"melanin": (0.008, 0.32), "haemoglobin": (0.006, 0.05), "scattering": (0.7, 1.6)}


@pytest.fixture(scope="module")
def points():
    """Points on and about a head-like ellipsoid with a neck, metres."""
    rng = np.random.default_rng(0)
    d = rng.normal(size=(1500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    head = np.array([0, -0.01, -0.07]) + d * [0.078, 0.12, 0.1]
    face = rng.uniform([-0.06, -0.11, -0.01], [0.06, 0.06, 0.045], (1500, 3))
    bust = rng.uniform([-0.16, -0.225, -0.16], [0.16, -0.1, -0.02], (800, 3))
    return np.concatenate([head, face, bust])


def _corner(bits: np.ndarray, colour: float) -> Pigment:
    values = {}
    for f, bit in zip(fields(Pigment), bits, strict=True):
        low, high = PIGMENT_LIMITS.get(f.name, (0.0, 1.0))
        values[f.name] = (colour,) * 3 if f.name == "iris" else (high if bit else low)
    return Pigment(**values)


def test_every_corner_of_the_pigments_is_physical(points):
    rng = np.random.default_rng(1)
    size = len(fields(Pigment))
    corners = [np.zeros(size, bool), np.ones(size, bool), *(rng.random((4, size)) < 0.5)]
    for k, bits in enumerate(corners):
        groom = Groom(beard="full", beard_mm=15.0) if k % 2 else Groom()
        params = replace(mean_params("short"), pigment=_corner(bits, 0.005 if k % 2 else 0.4), groom=groom)
        diffuse, specular = evaluate_material(points[k::5], params)
        assert np.isfinite(diffuse).all()
        assert diffuse.min() > 0
        assert diffuse.max() < 1
        assert 0.04 * KS_RANGE[0] <= specular.min()
        assert specular.max() <= 0.04 * KS_RANGE[1] + 1e-12


def test_material_is_continuous_enough_to_be_learnt(points):
    params = sample_params(np.random.default_rng(3))
    step = 2e-5
    moved = points + step * np.array([0.6, 0.48, 0.64])
    a, s = evaluate_material(points, params)
    b, t = evaluate_material(moved, params)
    # the steepest things: a pupil's rim, 0.4 albedo over 0.4 mm with a cubic's slope of 1.5 times that; a white
    # hair among dark ones, 0.5 over 0.5 mm in the same way
    per_mm = np.abs(b - a).max(1) / (1e3 * step)
    assert per_mm.max() < 5.0
    assert np.quantile(per_mm, 0.99) < 1.3
    assert np.abs(t - s).max() / (1e3 * step) < 0.2


def test_same_parameters_same_bytes_other_seed_other_person(points):
    params = sample_params(np.random.default_rng(8))
    a, _ = evaluate_material(points, params)
    assert a.tobytes() == evaluate_material(points, params)[0].tobytes()
    b, _ = evaluate_material(points, replace(params, seed=params.seed + 1))
    assert np.abs(a - b).max() > 0.01


def test_a_part_is_evaluated_as_in_the_whole(points):
    """An exact function of the point: what else is asked for does not matter (up to the rounding of one product)."""
    params = sample_params(np.random.default_rng(9))
    whole, part = evaluate_material(points, params)[0], evaluate_material(points[1::7], params)[0]
    # plane_noise is a matrix product, whose summation order may depend on its size; the lids are single precision
    assert np.abs(whole[1::7] - part).max() < 1e-4


def test_gaze_moves_the_iris_the_way_it_says():
    x = np.array([[side * (31.7 + dx), 0.0, 11.0] for side in (-1, 1) for dx in np.linspace(-9, 9, 181)])
    for gaze in (-1.0, 1.0):
        params = replace(mean_params(), shape=NamedShape(gaze_left=gaze))
        dark = eye_colour(x, params).mean(1) < 0.01
        # the pupil lies towards the subject's left (+x) in both eyes
        for side in (-1, 1):
            own = dark & (np.sign(x[:, 0]) == side)
            assert own.any()
            assert np.sign(x[own, 0].mean() - side * 31.7) == gaze


@pytest.mark.parametrize("garment", GARMENTS)
def test_garments_cover_the_bust_only(points, garment):
    base = mean_params()
    for neckline in (0.0, 1.0):
        for pattern in PATTERNS[:: 1 if garment == "shirt" else 4]:
            params = replace(base, dress=replace(base.dress, garment=garment, neckline=neckline, pattern=pattern))
            layer = cloth_layer(points * 1e3, params)
            assert layer.cover.min() >= 0
            assert layer.cover.max() <= 1
            assert not layer.cover[points[:, 1] > 1e-3 * HIGHEST_MM].any()
            assert 0 <= layer.thickness.min() <= layer.thickness.max() < 30
            shoulder = np.array([[85.0, -215.0, -60.0]])
            assert (cloth_layer(shoulder, params).cover[0] > 0.9) == (garment != "none")


@pytest.mark.parametrize("headwear", HEADWEAR)
def test_regions_name_what_lies_on_top(points, headwear):
    base = mean_params("short")
    params = replace(base, dress=replace(base.dress, headwear=headwear), groom=Groom(beard="full"))
    region = region_of(points, params)
    assert set(np.unique(region)) <= {int(r) for r in Region}
    # the middle of the upper lip, the left iris, a point on the bust
    known = np.array([[0.0, -0.064, 0.033], [0.0317, 0.001, 0.0115], [0.085, -0.215, -0.06]])
    assert region_of(known, params).tolist() == [int(Region.LIPS), int(Region.EYE), int(Region.CLOTH)]


def test_combinations_are_those_of_people():
    rng = np.random.default_rng(2)
    men, women, old, young = [], [], [], []
    for _ in range(400):
        age = rng.uniform(-1.7, 1.7)
        shape = NamedShape(age=age)
        male = bool(rng.random() < 0.5)
        pigment, groom = sample_pigment(rng, shape, male), sample_groom(rng, shape, male)
        style, length = sample_style(rng, shape, male, pigment.melanin)
        dress = sample_dress(rng, style)
        assert 0.7 < length < 1.4
        assert not (style in ("bun", "afro") and dress.headwear != "none")
        (men if male else women).append((style, groom, pigment))
        (old if age > 0.8 else young).append(pigment.grey)
    assert all(g.beard == "none" and p.stubble == 0 for _, g, p in women)
    assert 0.3 < np.mean([g.beard != "none" for _, g, _ in men]) < 0.6
    hanging = ("bob", "long", "wavy")
    assert np.mean([s in hanging for s, *_ in women]) > 4 * np.mean([s in hanging for s, *_ in men])
    assert np.mean(old) > np.mean(young) + 0.2
    # very dark skin goes with dark hair and eyes, light skin with any
    dark = [p for _, _, p in men + women if p.melanin > 0.15]
    light = [p for _, _, p in men + women if p.melanin < 0.03]
    assert min(p.hair_melanin for p in dark) > 0.6
    assert max(p.iris[2] for p in dark) < max(p.iris[2] for p in light)
    assert np.ptp([p.hair_melanin for p in light]) > 0.6
