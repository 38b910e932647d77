"""Rigs of lamps: what holds of every draw."""

import numpy as np
import pytest

from data_synth.light_colour import balanced, daylight, planckian
from data_synth.light_rigs import MOST_LOBES, RIGS, SHARPNESS_RANGE, sample_rig
from data_synth.lights import Lamp, Rig, face_luminance, sample_exposure, sample_white_balance
from data_synth.render_irradiance import irradiance_per_lobe
from data_synth.render_source import LUMINANCE
from sira_assets.mesh.triangle_mesh import TriangleMesh


def xy(rgb):
    """CIE 1931 chromaticity of linear Rec. 709, by the matrix that IEC 61966-2-1 prints."""
    matrix = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = np.asarray(rgb) @ np.transpose(matrix)
    return xyz[..., :2] / xyz.sum(-1, keepdims=True)


def test_every_draw_is_two_to_eight_lobes_within_the_stated_sharpness():
    seen = set()
    for seed in range(300):
        rig = sample_rig(np.random.default_rng(seed))
        light = rig.light()
        seen.add(rig.name)
        assert 2 <= len(light) <= MOST_LOBES
        # Draws at a range's own ends may leave it by rounding.
        assert light.sharpness.min() >= SHARPNESS_RANGE[0] * (1 - 1e-12)
        assert light.sharpness.max() <= SHARPNESS_RANGE[1] * (1 + 1e-12)
        assert light.amplitude.min() >= 0
        assert np.isfinite(light.amplitude).all()
        assert np.linalg.norm(light.axis, axis=1) == pytest.approx(np.ones(len(light)))
    assert seen == {name for name, *_ in RIGS}


def test_white_lights_have_the_chromaticities_of_the_standard_illuminants():
    # CIE A (2856 K) is Planckian; D50, D65 and D75 lie on the daylight locus at 5003, 6504 and 7504 K. Four digits are
    # printed, the matrix has four too; Krystek's 1e-4 in u and v is up to four times that in x and y.
    assert xy(planckian(2856.0)) == pytest.approx([0.4476, 0.4074], abs=5e-4)
    printed = [[0.3457, 0.3585], [0.3127, 0.3290], [0.2990, 0.3149]]
    assert xy(daylight(np.array([5003.0, 6504.0, 7504.0]))) == pytest.approx(np.array(printed), abs=3e-4)
    assert daylight(6504.0) == pytest.approx(np.ones(3), abs=3e-3)


def test_warmer_light_is_redder_and_no_colour_is_negative():
    for locus in (planckian, daylight):
        colours = locus(1e6 / np.linspace(20, 700, 100))
        assert colours @ LUMINANCE == pytest.approx(np.ones(100))
        assert colours.min() >= 0
        assert (np.diff(colours[:, 0]) >= -1e-12).all()
        assert (np.diff(colours[:, 2]) <= 1e-12).all()


def test_full_white_balance_makes_white_neutral_and_none_leaves_it():
    white = planckian(2800.0)
    assert balanced(white, white, 1.0) == pytest.approx(np.ones(3))
    assert balanced(white, white, 0.0) == pytest.approx(white)
    # Halfway, luminance stays and blue lies between.
    half = balanced(white, white, 0.5)
    assert half @ LUMINANCE == pytest.approx(1.0)
    assert white[2] < half[2] < 1.0


def test_white_balance_looks_past_gels():
    white, red = planckian(5000.0), np.array([4.0, 0.1, 0.1])
    rig = Rig("two", (Lamp(0, 0, 10.0, 1.0, white), Lamp(30, 0, 10.0, 1.0, red, gel=True)))
    assert rig.white() == pytest.approx(white)
    lamps = rig.white_balanced(1.0).lamps
    assert lamps[0].colour == pytest.approx(np.ones(3))
    assert lamps[1].colour[0] > 5 * lamps[1].colour[1]
    assert Rig("gels", (Lamp(0, 0, 10.0, 1.0, red, gel=True),)).white() == pytest.approx(np.ones(3))


def test_exposures_and_balances_keep_to_their_ranges():
    rng = np.random.default_rng(0)
    levels = np.array([sample_exposure(rng, 0.3) for _ in range(4000)])
    # Half of 0.13, and 0.36 times 2^0.6; a sixth of all lies beyond the usual range, give or take four standard errors.
    assert levels.min() >= 0.065
    assert levels.max() <= 0.546
    beyond = ((levels < 0.13) | (levels > 0.36)).mean()
    assert beyond == pytest.approx(0.16, abs=4 * np.sqrt(0.16 * 0.84 / 4000))
    balances = np.array([sample_white_balance(rng) for _ in range(1000)])
    assert balances.min() == 0.0
    assert balances.max() == 1.0
    assert 0.6 < balances.mean() < 0.9


def test_shares_of_the_rigs_sum_to_one():
    assert sum(share for *_, share in RIGS) == pytest.approx(1.0)


def test_the_same_seed_draws_the_same_rig():
    first, again = (sample_rig(np.random.default_rng(11)).light() for _ in range(2))
    assert np.array_equal(first.amplitude, again.amplitude)
    assert np.array_equal(first.axis, again.axis)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "axis"),
    [(0, 0, [0, 0, 1]), (90, 0, [1, 0, 0]), (0, 90, [0, 1, 0]), (-90, 0, [-1, 0, 0]), (180, 0, [0, 0, -1])],
)
def test_azimuth_turns_to_the_left_and_elevation_up(azimuth, elevation, axis):
    light = Rig("one", (Lamp(azimuth, elevation, 10.0, 1.0, np.ones(3)),)).light()
    assert light.axis[0] == pytest.approx(axis, abs=1e-12)


@pytest.mark.parametrize("sharpness", [0.05, 3.0, 700.0])
def test_power_is_the_luminance_of_the_irradiance_head_on(sharpness):
    light = Rig("one", (Lamp(30.0, 20.0, sharpness, 0.7, np.array([2.0, 1.0, 0.5])),)).light()
    irradiance = irradiance_per_lobe(light.axis, light.axis, light.sharpness) @ light.amplitude
    assert irradiance[0] @ LUMINANCE == pytest.approx(0.7, rel=1e-6)


def test_exposure_scales_with_the_light_and_favours_light_skin():
    rng = np.random.default_rng(2)
    mesh = TriangleMesh(rng.normal(size=(30, 3)), np.arange(30).reshape(10, 3))
    albedo, face = rng.uniform(0.1, 0.6, (30, 3)), np.arange(30) < 20
    light = sample_rig(rng).light()
    bright = face_luminance(mesh, albedo, light.scaled(3.0), face)
    assert bright == pytest.approx(3.0 * face_luminance(mesh, albedo, light, face))
    dark, pale = (sample_exposure(np.random.default_rng(4), luminance) for luminance in (0.06, 0.5))
    assert 0.02 < dark < pale < 0.7
