"""Irradiance of one lobe: closed forms, identities, limits."""

import numpy as np
import pytest

from data_synth.render_irradiance import irradiance_per_lobe, irradiance_table

ANGLE = np.linspace(0.0, np.pi, len(irradiance_table(1.0)))
SHARPNESS = [1e-6, 1e-3, 0.3, 1.0, 7.0, 60.0, 1e3, 1e6]


@pytest.mark.parametrize("sharpness", SHARPNESS)
def test_head_on_matches_the_closed_form(sharpness):
    # The integral of exp(l (z - 1)) z over z in [0, 1] is (l - 1 + e^-l) / l^2; its series serves where that cancels.
    exact = (sharpness + np.expm1(-sharpness)) / sharpness**2 if sharpness > 0.01 else 0.5 - sharpness / 6
    assert irradiance_table(sharpness)[0] == pytest.approx(2 * np.pi * exact, rel=1e-6)


@pytest.mark.parametrize("sharpness", SHARPNESS)
def test_front_minus_back_is_the_vector_irradiance(sharpness):
    """E(n) - E(-n) = n . (integral of w L(w) dw), which is exact for every angle."""
    table = irradiance_table(sharpness)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    reach = min(2.0, 40.0 / sharpness)
    t = 0.5 * reach * (nodes + 1)
    vector = 2 * np.pi * 0.5 * reach * (weights * np.exp(-sharpness * t) * (1 - t)).sum()
    # The documented accuracy of the table is 1e-6 of its head-on value.
    assert np.abs(table - table[::-1] - np.cos(ANGLE) * vector).max() < 2e-6 * table[0]


def test_uniform_light_gives_pi_everywhere():
    assert irradiance_table(1e-6) == pytest.approx(np.full(len(ANGLE), np.pi), rel=3e-6)


def test_sharp_light_follows_the_cosine():
    table = irradiance_table(1e6)
    lit = np.maximum(np.cos(ANGLE), 0.0) * 2 * np.pi / 1e6
    # A lobe 1e-3 wide rounds the corner at the terminator by about as much.
    assert np.abs(table - lit).max() < 1e-3 * table[0]


def test_interpolation_is_exact_on_the_axis_and_turns_with_the_frame():
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(4, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    sharpness = np.array([0.2, 3.0, 50.0, 5e3])
    on_axis = np.diag(irradiance_per_lobe(axis, axis, sharpness))
    assert on_axis == pytest.approx([irradiance_table(s)[0] for s in sharpness], rel=1e-9)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    still, turned = (irradiance_per_lobe(n, a, sharpness) for n, a in ((normals, axis), (normals @ turn, axis @ turn)))
    # Linear interpolation between 1024 angles: the second derivative times h^2 / 8 is below 1e-5 of the peak.
    assert np.abs(still - turned).max() < 1e-9
