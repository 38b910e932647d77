"""Ratios of exponentials that are 0/0 at the origin, with values and gradients exact there.

Notation: x >= 0. phi1(x) = int_0^1 e^{-xt} dt = (1 - e^{-x}) / x; odd1(x) = int_0^1 (1 - 2t) e^{-xt} dt.
Below `_SWITCH` a Taylor series replaces the ratio: there the closed forms, and more so their derivatives, cancel.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

# At x = 1 the closed forms lose at most 3 bits (phi1) and 6 bits (odd1). The series' first omitted term is 1 / 19! or,
# in single precision, 1 / 12!: both below eps.
_SWITCH = 1.0
_TERMS = 18
_TERMS_SINGLE = 11


def horner(x: Tensor, coefficients: Sequence[float | Tensor]) -> Tensor:
    """Polynomial sum_k coefficients[k] x^k; coefficients are numbers or tensors that broadcast with x."""
    result = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        result = result * x + c
    return result


def _series(x: Tensor, coefficients: list[float]) -> Tensor:
    return horner(x, coefficients if x.dtype == torch.float64 else coefficients[:_TERMS_SINGLE])


_PHI1 = [(-1.0) ** k / math.factorial(k + 1) for k in range(_TERMS)]
_ODD1 = [(-1.0) ** (k + 1) * k / ((k + 1) * (k + 2) * math.factorial(k)) for k in range(_TERMS)]


def phi1(x: Tensor) -> Tensor:
    """(1 - e^{-x}) / x for x >= 0; 1 at 0. Relative error a few eps, in value and gradient."""
    small = x < _SWITCH
    large = torch.where(small, torch.full_like(x, _SWITCH), x)
    series = _series(torch.where(small, x, torch.zeros_like(x)), _PHI1)
    return torch.where(small, series, -torch.expm1(-large) / large)


def odd1(x: Tensor) -> Tensor:
    """int_0^1 (1 - 2t) e^{-xt} dt = (1 + e^{-x}) / x - 2 (1 - e^{-x}) / x^2 for x >= 0; x / 6 near 0."""
    small = x < _SWITCH
    large = torch.where(small, torch.full_like(x, _SWITCH), x)
    series = _series(torch.where(small, x, torch.zeros_like(x)), _ODD1)
    ratio = (1.0 + torch.exp(-large) + 2.0 * torch.expm1(-large) / large) / large
    return torch.where(small, series, ratio)
