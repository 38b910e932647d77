"""Evaluation, integral and product of spherical gaussians against mpmath and quadrature, sharpness 0 to 1e8."""

import math

import mpmath
import numpy as np
import pytest
import torch

from sira_assets.numerics.exponential import odd1, phi1
from sira_assets.numerics.sg import sg_evaluate, sg_integral, sg_product
from sira_assets.numerics.vector import reflect, unit

DTYPES = [torch.float32, torch.float64]


def directions(count: int, seed: int, dtype=torch.float64) -> torch.Tensor:
    return unit(torch.randn(count, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(("function", "exact"), [
    (phi1, lambda x: -mpmath.expm1(-x) / x),
    (odd1, lambda x: (1 + mpmath.exp(-x) + 2 * mpmath.expm1(-x) / x) / x),
])  # fmt: skip
def test_exponential_ratios_and_their_slopes(function, exact, dtype):
    mpmath.mp.dps = 60
    x = torch.tensor(
        np.concatenate([np.geomspace(1e-8, 1e8, 161), [0.999, 1.0, 1.001]]), dtype=dtype, requires_grad=True
    )
    value = function(x)
    (slope,) = torch.autograd.grad(value.sum(), x)
    eps = torch.finfo(dtype).eps
    for xi, v, g in zip(x.tolist(), value.tolist(), slope.tolist(), strict=True):
        expected, derivative = exact(mpmath.mpf(xi)), mpmath.diff(exact, mpmath.mpf(xi))
        # odd1's closed form cancels 6 bits at the switch, x = 1, and its slope 3 more; phi1's 1 and 3.
        assert abs(v - expected) <= 64 * eps * abs(expected)
        assert abs(g - derivative) <= 512 * eps * abs(derivative)


@pytest.mark.parametrize("dtype", DTYPES)
def test_evaluation_keeps_its_digits_near_the_axis(dtype):
    mpmath.mp.dps = 50
    rng = np.random.default_rng(0)
    eps = torch.finfo(dtype).eps
    for sharpness in (0.0, 1e-8, 1.0, 1e3, 1e6, 1e8):
        xi = unit(torch.tensor(rng.normal(size=3), dtype=dtype))
        w = unit(xi + torch.tensor(rng.normal(size=(20, 3)) / math.sqrt(1.0 + sharpness), dtype=dtype))
        value = sg_evaluate(w, xi[None], torch.tensor([sharpness], dtype=dtype), torch.ones(1, 3, dtype=dtype))[:, 0]
        for wi, v in zip(w.tolist(), value.tolist(), strict=True):
            exact_xi, exact_w = (mpmath.matrix([mpmath.mpf(a) for a in vector]) for vector in (xi.tolist(), wi))
            cosine = (exact_xi.T * exact_w)[0] / mpmath.norm(exact_xi) / mpmath.norm(exact_w)
            exponent = mpmath.mpf(torch.tensor(sharpness, dtype=dtype).item()) * (cosine - 1)
            # The rounded unit vectors are themselves eps off unit length, which moves |w - xi|^2 by up to 2 eps^2.
            slack = 8 * eps * (1 + abs(exponent)) + 4 * sharpness * eps**2
            assert abs(v - mpmath.exp(exponent)) <= slack * mpmath.exp(exponent)


@pytest.mark.parametrize("dtype", DTYPES)
def test_integral(dtype):
    sharpness = torch.tensor([0.0, *np.geomspace(1e-8, 1e8, 65)], dtype=dtype)
    value = sg_integral(sharpness, torch.ones(66, 3, dtype=dtype))
    mpmath.mp.dps = 40
    expected = [4 * mpmath.pi] + [2 * mpmath.pi * -mpmath.expm1(-2 * mpmath.mpf(s)) / s for s in sharpness.tolist()[1:]]
    expected = torch.tensor([float(e) for e in expected], dtype=torch.float64)[:, None].expand(66, 3)
    torch.testing.assert_close(value.double(), expected, rtol=16 * torch.finfo(dtype).eps, atol=0.0)


def test_product_is_pointwise():
    one = directions(6, 0), torch.tensor([0.0, 1e-6, 0.3, 4.0, 60.0, 900.0], dtype=torch.float64)
    two = directions(6, 1), torch.tensor([1e-3, 5.0, 0.3, 70.0, 0.2, 1000.0], dtype=torch.float64)
    ones = torch.ones(6, 3, dtype=torch.float64)
    axis, sharpness, amplitude = sg_product(*one, 2 * ones, *two, 3 * ones)
    for w in directions(20, 2):
        for i in range(6):
            product = sg_evaluate(w[None], axis[i : i + 1], sharpness[i : i + 1], amplitude[i : i + 1])
            factors = [sg_evaluate(w[None], a[i : i + 1], s[i : i + 1], ones[:1]) for a, s in (one, two)]
            # Exponents reach 4000: 1e-12 is 4000 times a few eps.
            torch.testing.assert_close(product, 6 * factors[0] * factors[1], rtol=2e-12, atol=0.0)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("sharpness", [0.0, 1e-8, 1.0, 1e4, 1e8])
def test_product_of_opposite_equal_lobes_is_finite_with_finite_gradients(sharpness, dtype):
    axis = torch.tensor([[0.0, 0.0, 1.0]], dtype=dtype, requires_grad=True)
    lam = torch.tensor([sharpness], dtype=dtype, requires_grad=True)
    one = torch.ones(1, 3, dtype=dtype)
    product = sg_product(axis, lam, one, -axis.detach(), lam.detach(), one)
    assert product[1] <= 1e-6 * sharpness + 1e-18
    assert abs(product[2][0, 0] - math.exp(-2 * sharpness)) < 1e-6
    value = torch.cat([p.reshape(-1) for p in product])
    assert torch.isfinite(value).all()
    for gradient in torch.autograd.grad(product[2].sum() + product[1].sum(), (axis, lam)):
        assert torch.isfinite(gradient).all()


def test_unit_and_reflect():
    a = torch.tensor([[3.0, 0.0, 4.0], [1e-30, 0, 0], [0, 1e30, 0], [0, 0, 0]], requires_grad=True)
    expected = torch.tensor([[0.6, 0, 0.8], [1, 0, 0], [0, 1, 0], [0, 0, 0.0]])
    torch.testing.assert_close(unit(a), expected)
    assert torch.isfinite(torch.autograd.grad(unit(a[3]).sum(), a)[0]).all()
    n, v = directions(5, 3), directions(5, 4)
    torch.testing.assert_close(reflect(reflect(v, n), n), v)
    torch.testing.assert_close((reflect(v, n) * n).sum(-1), (v * n).sum(-1))
