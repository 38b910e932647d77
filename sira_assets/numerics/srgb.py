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


def srgb_decode(encoded: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """The inverse of `srgb_encode`."""
    return torch.where(encoded <= ENCODED_TOE, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
