"""Spherical harmonics of bands 0 to 2 and what spherical gaussians project to.

Notation: Y_k, k = 0..8, real and orthonormal over the sphere, in the order (l, m) = (0,0), (1,-1), (1,0), (1,1),
(2,-2), (2,-1), (2,0), (2,1), (2,2), without the Condon-Shortley phase: proportional to 1; y, z, x; xy, yz, 3z^2 - 1,
xz, x^2 - y^2, each with a positive constant (Ramamoorthi and Hanrahan, An Efficient Representation for Irradiance
Environment Maps, SIGGRAPH 2001, doi:10.1145/383259.383317). They are polynomials of the frame's own x, y, z: the pole
is z, which in this project's frames points out of the face. Coefficients f_k = int G(w) Y_k(w) dw are (9, 3), RGB.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.numerics.exponential import even2, odd1, phi1
from sira_assets.numerics.precision import narrow, widen

_BAND = (0, 1, 1, 1, 2, 2, 2, 2, 2)
_CONSTANT = math.sqrt(1.0 / (4.0 * math.pi))
_LINEAR = math.sqrt(3.0 / (4.0 * math.pi))
_SECOND = math.sqrt(15.0 / (4.0 * math.pi))
# What the clamped cosine multiplies each band by (Ramamoorthi and Hanrahan 2001, equation 8).
_COSINE = (math.pi, 2.0 * math.pi / 3.0, math.pi / 4.0)


def _basis(w: Tensor) -> Tensor:
    x, y, z = w.unbind(-1)
    # 3 z^2 - 1 of a unit vector, as 2 z^2 - x^2 - y^2: no cancellation but the one that it has by itself.
    zonal = (0.5 / math.sqrt(3.0)) * (2.0 * z * z - x * x - y * y)
    second = [_SECOND * v for v in (x * y, y * z, zonal, x * z, 0.5 * (x - y) * (x + y))]
    return torch.stack([torch.full_like(x, _CONSTANT), _LINEAR * y, _LINEAR * z, _LINEAR * x, *second], -1)


def sh_basis(w: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 9"]:
    """Y_0 to Y_8 at unit directions; a few eps of the largest of its band."""
    dtype, (w,) = widen((w,))
    return narrow(_basis(w), dtype)


def sh_from_sg(
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
) -> Float[Tensor, "9 3"]:
    """Coefficients of a sum of spherical gaussians, exact for every sharpness >= 0.

    By Funk and Hecke f_k = z_l Y_k(xi) with z_l = 2 pi int_{-1}^{1} P_l(u) e^{lambda (u - 1)} du: z_0 = 2 pi a_0,
    a_0 = (1 - e^{-2 lambda}) / lambda; a_1 = (1 + e^{-2 lambda} - a_0) / lambda; a_2 = a_0 - 3 a_1 / lambda, which are
    0/0 at 0 and are taken from `exponential`. Each lobe within a few eps of the largest coefficient of its band.
    """
    dtype, (axis, sharpness, amplitude) = widen((axis,), (sharpness, amplitude))
    zonal = torch.stack([4.0 * math.pi * moment(2.0 * sharpness) for moment in (phi1, odd1, even2)], -1)
    return narrow((zonal[:, list(_BAND)] * _basis(axis)).mT @ amplitude, dtype)


def sh_evaluate(w: Float[Tensor, "*n 3"], coefficients: Float[Tensor, "9 3"]) -> Float[Tensor, "*n 3"]:
    """sum_k f_k Y_k(w): the light without its finer detail. It may be negative."""
    dtype, (w, coefficients) = widen((w,), (coefficients,))
    return narrow(_basis(w) @ coefficients, dtype)


def sh_irradiance(normals: Float[Tensor, "*n 3"], coefficients: Float[Tensor, "9 3"]) -> Float[Tensor, "*n 3"]:
    """Irradiance of light known by bands 0 to 2 (Ramamoorthi and Hanrahan 2001): sum_k A_l f_k Y_k(n).

    The clamped cosine's odd bands beyond 1 vanish, so what is left out begins with band 4. Worst error for one lobe, of
    its head-on value: 0.02 % for lambda = 1, 1.4 % for 5, 3.1 % for 10, 9.4 % for a point of light; above lambda = 6
    it is negative at some angles, by up to 4 %.
    """
    dtype, (normals, coefficients) = widen((normals,), (coefficients,))
    gain = torch.tensor(_COSINE, dtype=normals.dtype, device=normals.device)[list(_BAND)]
    return narrow(_basis(normals) @ (gain.unsqueeze(-1) * coefficients), dtype)
