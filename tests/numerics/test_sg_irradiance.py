"""Irradiance of one lobe against the exact value, from sharpness 0 to 1e8, in both precisions."""

import math

import mpmath
import numpy as np
import pytest
import torch

from sira_assets.numerics.sg import LOBE_IRRADIANCE, irradiance
from sira_assets.numerics.sg_reference import irradiance_exact

GRADES = ("fast", "accurate")
# Of the head-on value. The accurate fit's ripple is 0.8e-4 and E(0)'s 1.1e-5; the re-fitted route's is 0.91e-2.
TOLERANCE = {"fast": 0.93e-2, "accurate": 1e-4}


def sweep() -> tuple[np.ndarray, np.ndarray]:
    """10,000 pairs: 101 sharpnesses by 100 cosines that crowd at the edge (scaled by the lobe's width) and at +-1."""
    sharpness = np.concatenate([[0.0], np.geomspace(1e-8, 1e8, 100)])
    spread = np.concatenate(
        [np.geomspace(1e-3, 1.0, 30), 1.0 - np.geomspace(1e-9, 0.1, 10), np.linspace(0.02, 1.0, 10)]
    )
    widths = np.minimum(1.0, 8.0 / np.sqrt(sharpness + 1.0))[:, None]
    half = np.concatenate([spread[:20] * widths, np.broadcast_to(spread[20:], (len(sharpness), 30))], 1)
    return np.concatenate([half, -half], 1), sharpness[:, None]


def test_reference_agrees_with_adaptive_quadrature_over_the_sphere():
    # An independent route: polar angle about xi, azimuth integrated in closed form, 30 digits.
    mpmath.mp.dps = 30
    for lam, c in [(0.3, -0.7), (4.0, 0.2), (50.0, -0.1), (50.0, 0.9), (2000.0, 0.01)]:
        s = math.sqrt(1 - c * c)

        def ring(u, lam=lam, c=c, s=s):
            a, b = c * u, s * mpmath.sqrt(1 - u * u)
            if a >= b:
                azimuth = 2 * mpmath.pi * a
            elif a <= -b:
                azimuth = mpmath.mpf(0)
            else:
                edge = mpmath.acos(-a / b)
                azimuth = 2 * (a * edge + b * mpmath.sin(edge))
            return mpmath.exp(lam * (u - 1)) * azimuth

        knots = sorted({-1, -s, s, 1, *(max(-1.0, 1 - k / lam) for k in (2, 8, 30))})
        expected = mpmath.quad(ring, knots)
        # 64 Gauss nodes: 1e-13 of the head-on value, here at most 2 pi / lambda.
        assert abs(irradiance_exact(c, lam) - float(expected)) < 1e-12 * 2 * math.pi / max(lam, 1.0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("grade", GRADES)
def test_within_tolerance_of_the_head_on_value_everywhere(grade, dtype):
    cosine, sharpness = sweep()
    c, lam = torch.tensor(cosine, dtype=dtype), torch.tensor(sharpness, dtype=dtype)
    value = LOBE_IRRADIANCE[grade](c, lam).double().numpy()
    exact = irradiance_exact(c.double().numpy(), lam.double().numpy())
    head_on = irradiance_exact(np.ones_like(sharpness), sharpness)
    error = np.abs(value - exact) / head_on
    assert np.isfinite(value).all()
    assert (value >= 0).all()
    assert error.max() < TOLERANCE[grade], (error.max(), np.unravel_index(error.argmax(), error.shape))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rises_with_the_cosine(dtype):
    cosine = torch.linspace(-1, 1, 4001, dtype=dtype)[:, None]
    sharpness = torch.tensor(np.concatenate([[0.0], np.geomspace(1e-8, 1e8, 60)]), dtype=dtype)
    value = LOBE_IRRADIANCE["accurate"](cosine, sharpness)
    # Rounding: neighbouring values of a flat stretch may differ by a few eps of the head-on value.
    assert (value.diff(dim=0) >= -8 * torch.finfo(dtype).eps * value[-1]).all()


@pytest.mark.parametrize("grade", GRADES)
def test_white_furnace(grade):
    # Constant light of radiance 1 on albedo 1 returns pi / pi; issue bounds 0.1 % and 0.5 %.
    normals = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    light = torch.tensor([[0.0, 0.0, 1.0]]), torch.zeros(1), torch.ones(1, 3)
    reflected = irradiance(normals, *light, grade=grade) / math.pi
    assert (reflected - 1).abs().max() < {"accurate": 1e-3, "fast": 5e-3}[grade]


@pytest.mark.parametrize("grade", GRADES)
def test_gradients_match_central_differences_in_double(grade):
    cosine, sharpness = np.meshgrid([-0.95, -0.3, -0.01, 0.02, 0.4, 0.97], [1e-6, 1e-2, 0.7, 6.0, 90.0, 1e3])
    c = torch.tensor(cosine.ravel(), requires_grad=True)
    lam = torch.tensor(sharpness.ravel(), requires_grad=True)
    f = LOBE_IRRADIANCE[grade]
    got = torch.autograd.grad(f(c, lam).sum(), (c, lam))
    with torch.no_grad():
        h = 1e-6
        by_cosine = (f(c + h, lam) - f(c - h, lam)) / (2 * h)
        step = lam * 1e-4
        by_sharpness = (f(c, lam + step) - f(c, lam - step)) / (2 * step)
    # Central differences: truncation h^2 f''' and rounding eps f / h, both below 1e-6 for c; for tiny lambda the step
    # of 1e-10 leaves eps / 1e-10 = 2e-6 times the fast route's 32-fold cancellation.
    torch.testing.assert_close(got[0], by_cosine, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(got[1], by_sharpness, rtol=1e-3, atol=2e-3 if grade == "fast" else 2e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_accurate_gradients_match_the_exact_function(dtype):
    # dE/dc and dE/dlambda of the fit against those of the exact E: the fit's own error, not rounding, decides.
    sharpness = np.geomspace(1e-3, 1e5, 33)[:, None]
    cosine = np.linspace(-0.99, 0.99, 67)[None]
    c = torch.tensor(np.broadcast_to(cosine, (33, 67)), dtype=dtype).requires_grad_()
    lam = torch.tensor(np.broadcast_to(sharpness, (33, 67)), dtype=dtype).requires_grad_()
    got = torch.autograd.grad(LOBE_IRRADIANCE["accurate"](c, lam).sum(), (c, lam))
    h, step = 1e-4 / np.sqrt(1 + sharpness), 1e-4 * sharpness
    head_on = irradiance_exact(np.ones_like(sharpness), sharpness)
    by_cosine = (irradiance_exact(cosine + h, sharpness) - irradiance_exact(cosine - h, sharpness)) / (2 * h)
    up, down = irradiance_exact(cosine, sharpness + step), irradiance_exact(cosine, sharpness - step)
    # Slope 1 % of the head-on value; relative change of lambda 0.1 % of it (measured: 0.5 % and 0.03 %).
    assert (np.abs(got[0].double().numpy() - by_cosine) / head_on).max() < 1e-2
    by_log = (up - down) / (2 * step) * sharpness
    assert (np.abs((got[1] * lam).detach().double().numpy() - by_log) / head_on).max() < 1e-3


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("grade", GRADES)
def test_gradients_are_finite_at_the_singular_points(grade, dtype):
    normals = torch.tensor([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, 0, 0.8]], dtype=dtype, requires_grad=True)
    axis = torch.tensor([[0, 0, 1.0]] * 6 + [[0, 0, -1.0]] * 6, dtype=dtype, requires_grad=True)
    lams = [0.0, 1e-8, 1.0, 31.5e-3, 1e4, 1e8] * 2
    sharpness = torch.tensor(lams, dtype=dtype, requires_grad=True)
    amplitude = torch.tensor([[0.0, 1.0, 1e6]] * 12, dtype=dtype, requires_grad=True)
    value = irradiance(normals, axis, sharpness, amplitude, grade=grade)
    assert torch.isfinite(value).all()
    for gradient in torch.autograd.grad(value.sum(), (normals, axis, sharpness, amplitude)):
        assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("grade", GRADES)
def test_no_lobe_is_darkness(grade):
    empty = torch.zeros(0, 3), torch.zeros(0), torch.zeros(0, 3)
    assert torch.equal(irradiance(torch.eye(3), *empty, grade=grade), torch.zeros(3, 3))


@pytest.mark.parametrize("grade", GRADES)
def test_invariant_under_rotation_and_linear_in_amplitude(grade):
    generator = torch.Generator().manual_seed(3)
    normals, axis = (
        torch.nn.functional.normalize(torch.randn(n, 3, generator=generator, dtype=torch.float64), dim=-1)
        for n in (40, 5)
    )
    sharpness = torch.tensor([1e-3, 0.5, 7.0, 80.0, 1e5], dtype=torch.float64)
    amplitude = torch.rand(5, 3, generator=generator, dtype=torch.float64)
    rotation = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64)).Q
    value = irradiance(normals, axis, sharpness, amplitude, grade=grade)
    turned = irradiance(normals @ rotation.T, axis @ rotation.T, sharpness, amplitude, grade=grade)
    # Rounding of the cosine, 1e-16, times the steepest slope, of order 1; the fast route cancels 32-fold.
    torch.testing.assert_close(turned, value, rtol=0, atol=1e-12)
    parts = sum(
        irradiance(normals, axis[i : i + 1], sharpness[i : i + 1], 2 * amplitude[i : i + 1], grade=grade)
        for i in range(5)
    )
    torch.testing.assert_close(parts, 2 * value, rtol=1e-13, atol=1e-13)
