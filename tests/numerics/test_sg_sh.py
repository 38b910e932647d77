"""Spherical harmonics of SG light: an orthonormal basis, the projection against quadrature, irradiance as published."""

import math

import numpy as np
import pytest
import torch

from sira_assets.numerics.sg import irradiance, sg_evaluate, sg_integral, sg_rotate
from sira_assets.numerics.sg_sh import sh_basis, sh_evaluate, sh_from_sg, sh_irradiance


def sphere(polar: int = 200, around: int = 64) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions and solid angles of a product rule: Gauss in z, equidistant in azimuth."""
    z, weight = np.polynomial.legendre.leggauss(polar)
    phi = 2 * np.pi * (np.arange(around) + 0.5) / around
    s = np.sqrt(1 - z * z)
    w = np.stack([np.outer(s, np.cos(phi)), np.outer(s, np.sin(phi)), np.outer(z, np.ones(around))], -1)
    return torch.tensor(w.reshape(-1, 3)), torch.tensor(np.repeat(weight, around) * 2 * np.pi / around)


def light(count: int, top: float) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(count)
    axis = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)
    sharpness = torch.logspace(-6, math.log10(top), count, dtype=torch.float64)
    return axis, sharpness, torch.rand(count, 3, generator=generator, dtype=torch.float64)


def test_the_basis_is_orthonormal():
    w, omega = sphere(8, 8)
    basis = sh_basis(w)
    # Products of two bands-2 polynomials have degree 4: the rule is exact.
    torch.testing.assert_close((basis * omega[:, None]).mT @ basis, torch.eye(9, dtype=torch.float64))


def test_the_convention_is_the_stated_one():
    w = torch.nn.functional.normalize(torch.tensor([[0.3, -0.5, 0.7]], dtype=torch.float64), dim=-1)
    x, y, z = w[0].tolist()
    # Ramamoorthi and Hanrahan 2001, equation 3: their six decimals.
    expected = [0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z]
    expected += [0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)]
    torch.testing.assert_close(sh_basis(w)[0], torch.tensor(expected, dtype=torch.float64), rtol=0, atol=1e-6)


def test_projection_against_quadrature():
    w, omega = sphere(200, 128)
    axis, sharpness, amplitude = light(7, 200.0)
    radiance = sg_evaluate(w, axis, sharpness, amplitude)
    by_sum = (sh_basis(w) * omega[:, None]).mT @ radiance
    # 128 azimuths alias a lobe of sharpness 200 by e^-40; 200 Gauss nodes resolve it to 1e-12.
    torch.testing.assert_close(sh_from_sg(axis, sharpness, amplitude), by_sum, rtol=0, atol=1e-11)
    # Band 0 holds the whole of the light.
    whole = sg_integral(sharpness, amplitude).sum(0)
    torch.testing.assert_close(sh_from_sg(axis, sharpness, amplitude)[0] * math.sqrt(4 * math.pi), whole)


def test_point_light_and_constant_light_are_their_limits():
    axis, _, amplitude = light(1, 1.0)
    point = sh_from_sg(axis, torch.tensor([1e8], dtype=torch.float64), amplitude)
    # 1 - P_2 of the lobe is 3 / lambda.
    torch.testing.assert_close(point, 2 * math.pi / 1e8 * sh_basis(axis).mT @ amplitude, rtol=4e-8, atol=0)
    constant = sh_from_sg(axis, torch.zeros(1, dtype=torch.float64), amplitude)
    torch.testing.assert_close(constant[0], amplitude[0] * math.sqrt(4 * math.pi))
    assert (constant[1:] == 0).all()
    torch.testing.assert_close(sh_irradiance(axis, constant), math.pi * amplitude)
    torch.testing.assert_close(sh_evaluate(axis, constant), amplitude)


def test_light_of_bands_up_to_two_is_known_in_full():
    w, omega = sphere(8, 8)
    coefficients = torch.randn(9, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    again = (sh_basis(w) * omega[:, None]).mT @ sh_evaluate(w, coefficients)
    torch.testing.assert_close(again, coefficients)


@pytest.mark.parametrize(("sharpness", "tolerance"), [(0.0, 1e-12), (1.0, 2.2e-4), (5.0, 1.5e-2), (30.0, 5.2e-2)])
def test_irradiance_within_the_stated_error(sharpness, tolerance):
    axis = torch.tensor([[0.48, 0.6, 0.64]], dtype=torch.float64)
    lobe = axis, torch.tensor([sharpness], dtype=torch.float64), torch.ones(1, 3, dtype=torch.float64)
    normals, _ = sphere(40, 16)
    head_on = irradiance(axis, *lobe)
    error = (sh_irradiance(normals, sh_from_sg(*lobe)) - irradiance(normals, *lobe)).abs().max() / head_on.max()
    assert error < max(tolerance, 1e-4)  # what is compared with is itself within 0.01 %


def test_turning_the_light_is_turning_the_harmonics():
    axis, sharpness, amplitude = light(5, 50.0)
    q = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)).Q
    turned = sh_from_sg(sg_rotate(q, axis), sharpness, amplitude)
    w, _ = sphere(6, 6)
    torch.testing.assert_close(sh_evaluate(w @ q.mT, turned), sh_evaluate(w, sh_from_sg(axis, sharpness, amplitude)))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_at_the_singular_points(dtype):
    axis = torch.tensor([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]] * 3, dtype=dtype, requires_grad=True)
    sharpness = torch.tensor([0.0] * 3 + [1e-8] * 3 + [1e8] * 3, dtype=dtype, requires_grad=True)
    amplitude = torch.tensor([[0.0, 1.0, 1e6]] * 9, dtype=dtype, requires_grad=True)
    value = sh_irradiance(axis.detach(), sh_from_sg(axis, sharpness, amplitude))
    for gradient in torch.autograd.grad(value.sum(), (axis, sharpness, amplitude)):
        assert torch.isfinite(gradient).all()
    empty = torch.zeros(0, 3, dtype=dtype), torch.zeros(0, dtype=dtype), torch.zeros(0, 3, dtype=dtype)
    assert torch.equal(sh_from_sg(*empty), torch.zeros(9, 3, dtype=dtype))
