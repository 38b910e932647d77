"""Sums of spherical gaussians.

Notation: G(w) = sum_i mu_i exp(lambda_i (w . xi_i - 1)); axis xi (M, 3) unit, sharpness lambda (M,) >= 0, amplitude
mu (M, 3) >= 0; w and n are unit directions. float32 and float64, lambda from 0 to 1e8, all arguments of one dtype. An
empty sum (M = 0) is 0.
"""

import math
from collections.abc import Callable
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.numerics.exponential import phi1
from sira_assets.numerics.sg_irradiance import irradiance_accurate, irradiance_fast
from sira_assets.numerics.vector import squared_distance

Grade = Literal["fast", "accurate"]
LOBE_IRRADIANCE: dict[Grade, Callable[[Tensor, Tensor], Tensor]] = {
    "fast": irradiance_fast,
    "accurate": irradiance_accurate,
}


def sg_evaluate(
    w: Float[Tensor, "*n 3"],
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
) -> Float[Tensor, "*n 3"]:
    """Radiance G(w). The exponent is -lambda |w - xi|^2 / 2, which keeps its digits near the axis."""
    exponent = -0.5 * sharpness * squared_distance(w.unsqueeze(-2), axis)
    return torch.exp(exponent) @ amplitude


def sg_integral(sharpness: Float[Tensor, "*m"], amplitude: Float[Tensor, "*m 3"]) -> Float[Tensor, "*m 3"]:
    """Integral of each lobe over the sphere, 2 pi mu (1 - e^{-2 lambda}) / lambda; 4 pi mu at lambda = 0."""
    return (4.0 * math.pi * phi1(2.0 * sharpness)).unsqueeze(-1) * amplitude


def product_scalars(sharpness_1: Tensor, sharpness_2: Tensor, distance_squared: Tensor) -> tuple[Tensor, Tensor]:
    """Sharpness and exponent of a product of two lobes whose axes are sqrt(distance_squared) apart.

    lambda_3 = |lambda_1 xi_1 + lambda_2 xi_2| and lambda_3 - lambda_1 - lambda_2, without cancellation (Wang et al.
    2009, All-Frequency Rendering of Dynamic, Spatially-Varying Reflectance, doi:10.1145/1618452.1618479).
    """
    summed = sharpness_1 + sharpness_2
    crossed = sharpness_1 * sharpness_2 * distance_squared
    # For opposite equal lobes the root is 0 and its gradient infinite: the floor is eps of the sharpness itself.
    floor = torch.finfo(summed.dtype).eps ** 2 * summed.detach() ** 2 + torch.finfo(summed.dtype).tiny
    sharpness = torch.sqrt(torch.maximum(summed * summed - crossed, floor))
    return sharpness, -crossed / (sharpness + summed + torch.finfo(summed.dtype).tiny)


def sg_product(
    axis_1: Float[Tensor, "*m 3"],
    sharpness_1: Float[Tensor, "*m"],
    amplitude_1: Float[Tensor, "*m 3"],
    axis_2: Float[Tensor, "*m 3"],
    sharpness_2: Float[Tensor, "*m"],
    amplitude_2: Float[Tensor, "*m 3"],
) -> tuple[Float[Tensor, "*m 3"], Float[Tensor, "*m"], Float[Tensor, "*m 3"]]:
    """The lobe that two lobes multiply to: axis, sharpness, amplitude. Exact.

    Opposite lobes of equal sharpness give sharpness 0; the axis is then of length <= 1 and of no consequence.
    """
    sharpness, exponent = product_scalars(sharpness_1, sharpness_2, squared_distance(axis_1, axis_2))
    axis = (sharpness_1.unsqueeze(-1) * axis_1 + sharpness_2.unsqueeze(-1) * axis_2) / sharpness.unsqueeze(-1)
    return axis, sharpness, torch.exp(exponent).unsqueeze(-1) * amplitude_1 * amplitude_2


def irradiance(
    normals: Float[Tensor, "*n 3"],
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
    *,
    visibility: Float[Tensor, "*n m"] | None = None,
    grade: Grade = "accurate",
) -> Float[Tensor, "*n 3"]:
    """Irradiance E(n) = int G(w) max(n . w, 0) dw; the diffuse radiance is albedo / pi times it.

    Parameters
    ----------
    normals : (..., 3) unit
    visibility : (..., M) in [0, 1], the share of each lobe's irradiance that nothing stands before; 1 if None
    grade : "accurate", within 0.01 % of a lobe's head-on value, or "fast", the published route, within 1.3 %

    Returns
    -------
    (..., 3), >= 0
    """
    cosine = (normals @ axis.mT).clamp(-1.0, 1.0)
    received = LOBE_IRRADIANCE[grade](cosine, sharpness)
    return (received if visibility is None else visibility * received) @ amplitude
