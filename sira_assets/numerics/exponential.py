"""Moments of a decaying exponential that are 0/0 at the origin, with values and gradients exact there.

Notation: x >= 0; P_l Legendre polynomials. Each function is int_0^1 P_l(1 - 2t) e^{-xt} dt = e^{-x/2} i_l(x/2), i_l the
modified spherical Bessel function: l = 0 phi1, l = 1 odd1, l = 2 even2. Near 0 the closed forms, and more so their
derivatives, cancel; there stands the ascending series of i_l, all of whose terms are positive (DLMF 10.53.3).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

# x at which series and closed form meet: the closed form loses one bit there for phi1, two for odd1 and even2, and the
# last term kept of the series, in (x / 2)^2, is below eps.
_SWITCH = (1.0, 4.0, 8.0)
_TERMS = ((7, 4), (11, 7), (17, 11))  # double, single precision


def horner(x: Tensor, coefficients: Sequence[float | Tensor]) -> Tensor:
    """Polynomial sum_k coefficients[k] x^k; coefficients are numbers or tensors that broadcast with x."""
    result = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        result = result * x + c
    return result


def _ascending(order: int, terms: int) -> list[float]:
    """Coefficients in y = z^2 of i_l(z) / z^l: 2^{-k} / (k! (2l + 2k + 1)!!)."""
    coefficients, value = [], 1.0
    for odd in range(3, 2 * order + 2, 2):
        value /= odd
    for k in range(terms):
        coefficients.append(value)
        value *= 0.5 / ((k + 1) * (2 * order + 2 * k + 3))
    return coefficients


_SERIES = [[_ascending(order, n) for n in terms] for order, terms in enumerate(_TERMS)]


def _split(x: Tensor, order: int) -> tuple[Tensor, Tensor, Tensor]:
    """Where the series holds, its value there, and x held above the switch for the closed form."""
    switch = _SWITCH[order]
    small = x < switch
    half = 0.5 * torch.where(small, x, torch.zeros_like(x))
    coefficients = _SERIES[order][0 if x.dtype == torch.float64 else 1]
    series = torch.exp(-half) * half**order * horner(half * half, coefficients)
    return small, series, torch.where(small, torch.full_like(x, switch), x)


def phi1(x: Tensor) -> Tensor:
    """(1 - e^{-x}) / x for x >= 0; 1 at 0. Relative error a few eps, in value and gradient."""
    small, series, large = _split(x, 0)
    return torch.where(small, series, -torch.expm1(-large) / large)


def odd1(x: Tensor) -> Tensor:
    """int_0^1 (1 - 2t) e^{-xt} dt = (1 + e^{-x}) / x - 2 (1 - e^{-x}) / x^2 for x >= 0; x / 6 near 0."""
    small, series, large = _split(x, 1)
    ratio = (1.0 + torch.exp(-large) + 2.0 * torch.expm1(-large) / large) / large
    return torch.where(small, series, ratio)


def even2(x: Tensor) -> Tensor:
    """int_0^1 (1 - 6t + 6t^2) e^{-xt} dt = phi1(x) - 6 odd1(x) / x for x >= 0; x^2 / 60 near 0."""
    small, series, large = _split(x, 2)
    first = (1.0 + torch.exp(-large) + 2.0 * torch.expm1(-large) / large) / large
    return torch.where(small, series, (-torch.expm1(-large) - 6.0 * first) / large)
