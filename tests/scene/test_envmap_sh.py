"""Spherical harmonics of a map: the convention, exactness at any size, rotation about the poles."""

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.scene.envmap import EnvironmentMap, envmap_from_sg
from sira_assets.scene.envmap_resample import envmap_resized, envmap_yawed
from sira_assets.scene.envmap_sh import envmap_sh, sh_basis
from sira_assets.scene.sg_light import SGLight


def some_directions(count, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_the_nine_polynomials():
    d = some_directions(40)
    x, y, z = d.T
    # Ramamoorthi and Hanrahan 2001, doi:10.1145/383259.383317, eq. 3: the constants have six digits there.
    expected = [
        0.282095 + 0 * x, 0.488603 * y, 0.488603 * z, 0.488603 * x,
        1.092548 * x * y, 1.092548 * y * z, 0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y),
    ]  # fmt: skip
    assert np.abs(sh_basis(d, 3) - np.stack(expected, -1)).max() < 2e-6


def test_agrees_with_scipy_up_to_band_30():
    from scipy.special import sph_harm_y

    d = some_directions(30)
    basis = sh_basis(d, 31)
    theta, phi = np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])
    for n in (1, 2, 7, 30):
        for m in range(-n, n + 1):
            theirs = sph_harm_y(n, abs(m), theta, phi) * (-1) ** abs(m)  # theirs has the Condon-Shortley phase
            real = theirs.real if m == 0 else np.sqrt(2) * (theirs.real if m > 0 else theirs.imag)
            assert np.abs(basis[:, n * n + n + m] - real).max() < 1e-12


@pytest.mark.parametrize("height", [1, 2, 5, 16])
@pytest.mark.parametrize("bands", [1, 3, 6])
def test_exact_for_maps_constant_within_pixels(height, bands):
    env = EnvironmentMap(np.random.default_rng(2).random((height, 2 * height, 3)))
    # The same integral by 12 Gauss nodes a side in every pixel, which is exact for these bands to rounding at H >= 2,
    # and to 1e-9 where one pixel spans pi.
    nodes, weights = np.polynomial.legendre.leggauss(12)
    step = np.pi / height
    theta = (step * (np.arange(height)[:, None] + 0.5 * (nodes + 1))).reshape(-1)
    phi = (step * (np.arange(2 * height)[:, None] + 0.5 * (nodes + 1))).reshape(-1)
    row = np.tile(weights * step / 2, height) * np.sin(theta)
    column = np.tile(weights * step / 2, 2 * height)
    y = np.broadcast_to(np.cos(theta)[:, None], (len(theta), len(phi)))
    w = np.stack([np.sin(theta)[:, None] * np.sin(phi), y, -np.sin(theta)[:, None] * np.cos(phi)], -1)
    fine = env.radiance.repeat(12, 0).repeat(12, 1)
    expected = np.einsum("hwk,hwc,h,w->kc", sh_basis(w, bands), fine, row, column)
    assert np.abs(envmap_sh(env, bands) - expected).max() < 1e-8


def test_a_gaussian_has_its_closed_form():
    lam, axis = 4.0, np.array([0.6, -0.48, 0.64])
    env = envmap_from_sg(SGLight(axis, lam, [1, 2, 3]), 256)
    # a_l = 2 pi int P_l(t) e^{lam (t - 1)} dt; c_lm = a_l Y_lm(axis).
    a0 = -np.expm1(-2 * lam) / lam
    a1 = (1 + np.exp(-2 * lam) - a0) / lam
    a = 2 * np.pi * np.array([a0, a1, a0 - 3 * a1 / lam])
    expected = np.concatenate([[a[0]], [a[1]] * 3, [a[2]] * 5]) * sh_basis(axis, 3)
    # Pixels hold the lobe's value at their centre: second order in pi / 256.
    assert np.abs(envmap_sh(env)[:, 0] - expected).max() < 1e-4 * a[0]
    assert np.allclose(envmap_sh(env) / envmap_sh(env)[:, :1], [1, 2, 3], rtol=1e-5)


def test_yaw_turns_the_coefficients_and_resizing_keeps_them():
    env = EnvironmentMap(np.random.default_rng(3).random((16, 32, 3)))
    before, after = envmap_sh(env, 2), envmap_sh(envmap_yawed(env, 90.0), 2)
    # +Z goes to +X and +X to -Z; l = 1 in the order y, z, x.
    assert np.allclose(after[[0, 1, 3]], before[[0, 1, 2]], atol=1e-6)
    assert np.allclose(after[2], -before[3], atol=1e-6)
    # Split into smaller pixels of the same radiance it is the same light.
    assert np.abs(envmap_sh(envmap_resized(env, 48)) - envmap_sh(env)).max() < 1e-6


def test_bad_bands_are_refused():
    env = EnvironmentMap(np.zeros((2, 4, 3)))
    assert not envmap_sh(env).any()
    for bands in (0, 65):
        with pytest.raises(InputError, match="bands"):
            envmap_sh(env, bands)
