"""Sums of spherical gaussians.

Notation: G(w) = sum_i mu_i exp(lambda_i (w . xi_i - 1)); axis xi (M, 3) unit, sharpness lambda (M,) >= 0, amplitude
mu (M, 3) >= 0; w and n are unit directions. lambda from 0 to 1e8, all arguments of one dtype: float32 and float64, or
float16 and bfloat16, which are computed in float32 (`precision`). An empty sum (M = 0) is 0. "A few eps" below is at
most 8, of the formula for the arguments as rounded, with directions normalised exactly; gradients are finite wherever
the values are.
"""

import math
from collections.abc import Callable
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.numerics.blocks import in_blocks
from sira_assets.numerics.exponential import phi1
from sira_assets.numerics.precision import narrow, widen
from sira_assets.numerics.sg_irradiance import hemisphere_integral, irradiance_accurate, irradiance_fast
from sira_assets.numerics.vector import squared_distance, unit

Grade = Literal["fast", "accurate"]
LOBE_IRRADIANCE: dict[Grade, Callable[[Tensor, Tensor], Tensor]] = {
    "fast": irradiance_fast,
    "accurate": irradiance_accurate,
}
# Beside sharpnesses of 1e-8 and above it changes an exponent by less than 1e-18.
_NOTHING = 1e-18


def sg_evaluate(
    w: Float[Tensor, "*n 3"],
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
) -> Float[Tensor, "*n 3"]:
    """Radiance G(w). The exponent is -lambda |w - xi|^2 / 2, which keeps its digits near the axis.

    Each lobe is within a few eps times 1 + |exponent| of its value for lambda 0 to 1e8.
    """
    dtype, (w, axis, sharpness, amplitude) = widen((w, axis), (sharpness, amplitude))
    exponent = -0.5 * sharpness * squared_distance(w.unsqueeze(-2), axis)
    return narrow(torch.exp(exponent) @ amplitude, dtype)


def sg_integral(sharpness: Float[Tensor, "*m"], amplitude: Float[Tensor, "*m 3"]) -> Float[Tensor, "*m 3"]:
    """Integral of each lobe over the sphere, 2 pi mu (1 - e^{-2 lambda}) / lambda; 4 pi mu at lambda = 0.

    Within a few eps for every lambda >= 0.
    """
    dtype, (sharpness, amplitude) = widen((), (sharpness, amplitude))
    return narrow((4.0 * math.pi * phi1(2.0 * sharpness)).unsqueeze(-1) * amplitude, dtype)


def sg_hemisphere_integral(
    normals: Float[Tensor, "*n 3"],
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
) -> Float[Tensor, "*n 3"]:
    """int G(w) dw over n . w > 0, without the cosine.

    Each lobe within 1.3 % of its value at n = xi for every lambda >= 0 (`sg_irradiance.hemisphere_integral`); what lies
    above n and above -n adds up to `sg_integral` within a few eps.
    """
    dtype, (normals, axis, sharpness, amplitude) = widen((normals, axis), (sharpness, amplitude))
    cosine = (normals @ axis.mT).clamp(-1.0, 1.0)
    return narrow(hemisphere_integral(cosine, sharpness) @ amplitude, dtype)


def sg_rotate(rotation: Float[Tensor, "3 3"], axis: Float[Tensor, "*m 3"]) -> Float[Tensor, "*m 3"]:
    """Axes after a rotation of the light; sharpness and amplitude stay. Unit to a few eps however often it is applied.

    `rotation` is orthonormal, in the dtype of the axes.
    """
    dtype, (axis, rotation) = widen((axis,), (rotation,))
    return narrow(unit(axis @ rotation.mT), dtype)


def product_scalars(sharpness_1: Tensor, sharpness_2: Tensor, distance_squared: Tensor) -> tuple[Tensor, Tensor]:
    """Sharpness and exponent of a product of two lobes whose axes are sqrt(distance_squared) apart.

    lambda_3 = |lambda_1 xi_1 + lambda_2 xi_2| and lambda_3 - lambda_1 - lambda_2 (Wang et al. 2009, All-Frequency
    Rendering of Dynamic, Spatially-Varying Reflectance, doi:10.1145/1618452.1618479). The exponent keeps its digits
    everywhere; the sharpness loses up to half of them for opposite lobes, where the amplitude is e^{-2 lambda} or less:
    cheap enough for every pair of point and lobe. `sg_product` has all digits of both.
    """
    summed = sharpness_1 + sharpness_2
    crossed = sharpness_1 * sharpness_2 * distance_squared
    # For opposite equal lobes the root is 0 and its gradient infinite: the floor is eps of the sharpness itself.
    floor = torch.finfo(summed.dtype).eps ** 2 * summed.detach() ** 2 + torch.finfo(summed.dtype).tiny
    sharpness = torch.sqrt(torch.maximum(summed * summed - crossed, floor))
    return sharpness, -crossed / (sharpness + summed + torch.finfo(summed.dtype).tiny)


def _product(axis_1: Tensor, sharpness_1: Tensor, axis_2: Tensor, sharpness_2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Axis, sharpness and exponent of a product, each with all its digits.

    lambda_1 xi_1 + lambda_2 xi_2 is taken as half of (lambda_1 - lambda_2) (xi_1 - xi_2) + (lambda_1 + lambda_2)
    (xi_1 + xi_2): neither part loses digits, and for unit axes the two stand at right angles, so neither does the sum.
    """
    apart, together = axis_1 - axis_2, axis_1 + axis_2
    summed = sharpness_1 + sharpness_2
    vector = 0.5 * ((sharpness_1 - sharpness_2).unsqueeze(-1) * apart + summed.unsqueeze(-1) * together)
    axis = unit(vector)
    # v . v/|v| is |v|, with a finite gradient where v = 0.
    sharpness = (vector * axis).sum(-1)
    # Two lobes of sharpness 0: 0 / 0, whose square, in the gradient, must not underflow either.
    crossed = sharpness_1 * sharpness_2 * (apart * apart).sum(-1)
    return axis, sharpness, -crossed / (sharpness + summed + _NOTHING)


def sg_product(
    axis_1: Float[Tensor, "*m 3"],
    sharpness_1: Float[Tensor, "*m"],
    amplitude_1: Float[Tensor, "*m 3"],
    axis_2: Float[Tensor, "*m 3"],
    sharpness_2: Float[Tensor, "*m"],
    amplitude_2: Float[Tensor, "*m 3"],
) -> tuple[Float[Tensor, "*m 3"], Float[Tensor, "*m"], Float[Tensor, "*m 3"]]:
    """The lobe that two lobes multiply to: axis, sharpness, amplitude. Exact (Wang et al. 2009).

    Amplitude within a few eps times 1 + |exponent| of its value, sharpness within a few eps of its own or, for opposite
    lobes of nearly equal sharpness, of lambda_1 + lambda_2. Where they cancel, sharpness is 0 and the axis the zero
    vector, which `sg_evaluate` takes for what it is: a constant.
    """
    directions, numbers = (axis_1, axis_2), (sharpness_1, sharpness_2, amplitude_1, amplitude_2)
    dtype, (axis_1, axis_2, sharpness_1, sharpness_2, amplitude_1, amplitude_2) = widen(directions, numbers)
    axis, sharpness, exponent = _product(axis_1, sharpness_1, axis_2, sharpness_2)
    amplitude = torch.exp(exponent).unsqueeze(-1) * amplitude_1 * amplitude_2
    return narrow(axis, dtype), narrow(sharpness, dtype), narrow(amplitude, dtype)


def sg_inner_product(
    axis_1: Float[Tensor, "*m 3"],
    sharpness_1: Float[Tensor, "*m"],
    amplitude_1: Float[Tensor, "*m 3"],
    axis_2: Float[Tensor, "*m 3"],
    sharpness_2: Float[Tensor, "*m"],
    amplitude_2: Float[Tensor, "*m 3"],
) -> Float[Tensor, "*m 3"]:
    """int G_1(w) G_2(w) dw over the sphere, lobe by lobe. Exact; a few eps times 1 + |exponent| of the value."""
    directions, numbers = (axis_1, axis_2), (sharpness_1, sharpness_2, amplitude_1, amplitude_2)
    dtype, (axis_1, axis_2, sharpness_1, sharpness_2, amplitude_1, amplitude_2) = widen(directions, numbers)
    _, sharpness, exponent = _product(axis_1, sharpness_1, axis_2, sharpness_2)
    value = 4.0 * math.pi * phi1(2.0 * sharpness) * torch.exp(exponent)
    return narrow(value.unsqueeze(-1) * amplitude_1 * amplitude_2, dtype)


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
    grade : "accurate", within 0.01 % of a lobe's head-on value, or "fast", the published route, within 0.92 %

    Returns
    -------
    (..., 3), >= 0
    """
    dtype, (normals, axis, sharpness, amplitude) = widen((normals, axis), (sharpness, amplitude))
    lobe_irradiance = LOBE_IRRADIANCE[grade]

    def block(normals, seen, axis, sharpness, amplitude):
        received = lobe_irradiance((normals @ axis.mT).clamp(-1.0, 1.0), sharpness)
        return (received if seen is None else seen * received) @ amplitude

    seen = None if visibility is None else visibility.to(normals.dtype).reshape(normals[..., 0].numel(), len(sharpness))
    points = normals.reshape(-1, 3), seen
    value = in_blocks(block, points, (axis, sharpness, amplitude), pairs=len(sharpness))
    return narrow(value.reshape(normals.shape), dtype)
