"""Vectors whose gradients stay finite.

Notation: a, b (..., 3); all functions broadcast and keep dtype and device.
"""

import torch
from jaxtyping import Float
from torch import Tensor


def dot(a: Float[Tensor, "... 3"], b: Float[Tensor, "... 3"]) -> Float[Tensor, "..."]:
    """Scalar product over the last axis."""
    return (a * b).sum(-1)


def squared_distance(a: Float[Tensor, "... 3"], b: Float[Tensor, "... 3"]) -> Float[Tensor, "..."]:
    """|a - b|^2 from the difference.

    For unit vectors a . b - 1 = -|a - b|^2 / 2, which keeps its digits where a . b rounds to 1.
    """
    difference = a - b
    return (difference * difference).sum(-1)


def unit(a: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """a / |a|, and 0 with a finite gradient for a = 0.

    The largest component is divided out first, so that squares neither overflow nor underflow: lengths from the
    smallest normal number to the largest finite one.
    """
    scale = a.detach().abs().amax(-1, keepdim=True)
    scale = torch.where(scale > 0, scale, torch.ones_like(scale))
    scaled = a / scale
    squared = (scaled * scaled).sum(-1, keepdim=True)
    # For a != 0 the scaled length is at least 1; only a = 0 reaches the other branch.
    return scaled * torch.rsqrt(torch.where(squared > 0.5, squared, torch.ones_like(squared)))


def reflect(v: Float[Tensor, "... 3"], n: Float[Tensor, "... 3"]) -> Float[Tensor, "... 3"]:
    """Mirror direction 2 (v . n) n - v of a direction v that points away from the surface."""
    return 2.0 * dot(v, n).unsqueeze(-1) * n - v
