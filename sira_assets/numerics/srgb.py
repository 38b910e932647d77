"""sRGB encoding in torch, differentiable (IEC 61966-2-1); `numerics.colour` has it in NumPy.

Notation: linear and encoded values in [0, 1]; encoding clips values outside, decoding follows the curve's own pieces.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.numerics.colour import ENCODED_TOE, LINEAR_TOE


def srgb_encode(linear: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """Encode linear values; the gradient is finite everywhere, zero outside [0, 1]."""
    x = linear.clamp(0.0, 1.0)
    return torch.where(x <= LINEAR_TOE, 12.92 * x, 1.055 * x.clamp_min(LINEAR_TOE) ** (1.0 / 2.4) - 0.055)


# d srgb_encode(x) / dx at x = 1.
SLOPE_AT_WHITE = 1.055 / 2.4


def srgb_encode_beyond(linear: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """`srgb_encode`, gone on with along its slope at white for what is brighter, so that a gradient remains."""
    return torch.where(linear > 1.0, 1.0 + SLOPE_AT_WHITE * (linear - 1.0), srgb_encode(linear))


def srgb_decode(encoded: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """The inverse of `srgb_encode`."""
    return torch.where(encoded <= ENCODED_TOE, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
