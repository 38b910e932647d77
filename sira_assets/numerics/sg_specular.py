"""Specular reflection of spherical gaussian light by a rough surface, in closed form.

Notation: n normal, v direction to the camera, l to the light, all unit; r roughness (GGX alpha = r^2); f0 reflectance
at normal incidence. The BRDF is D F V with D = exp(2/r^4 (n . h - 1)) / (pi r^4), Karis' spherical-gaussian Schlick F
and Smith's visibility V = 1 / (4 (nl (1-k) + k) (nv (1-k) + k)), k = (r + 1)^2 / 8: "simplified Disney" (Karis, Real
Shading in Unreal Engine 4, 2013; as SG: Wang et al. 2009, doi:10.1145/1618452.1618479).
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.numerics.blocks import in_blocks
from sira_assets.numerics.ggx_albedo import directional_albedo
from sira_assets.numerics.precision import narrow, widen
from sira_assets.numerics.sg import Grade, product_scalars
from sira_assets.numerics.sg_irradiance import integral_and_mean_cosine
from sira_assets.numerics.vector import dot, reflect, squared_distance, unit

# The warped lobe's sharpness is 1 / (2 r^4 nv). Below this cosine (0.06 degrees from grazing) it is held.
COSINE_FLOOR = 1e-3


def fresnel(f0: Tensor, cosine: Tensor) -> Tensor:
    """Karis' fit of Schlick's Fresnel: f0 + (1 - f0) 2^{-(5.55473 c + 6.98316) c}, c = v . h in [0, 1]."""
    return f0 + (1.0 - f0) * torch.exp2(-(5.55473 * cosine + 6.98316) * cosine)


def _masked(cosine: Tensor, sharpness: Tensor, k: float) -> Tensor:
    """int G nl / (nl (1 - k) + k) dl of a unit lobe, with nl in the denominator its mean over the lobe."""
    integral, mean_cosine = integral_and_mean_cosine(cosine.clamp(-1.0, 1.0), sharpness)
    return integral * mean_cosine / (mean_cosine * (1.0 - k) + k)


def specular_lobe(
    normals: Float[Tensor, "*n 3"],
    view: Float[Tensor, "*n 3"],
    f0: Float[Tensor, "*n"],
    *,
    roughness: float,
) -> tuple[Float[Tensor, "*n 3"], Float[Tensor, "*n"], Float[Tensor, "*n"]]:
    """The published BRDF's D F V as one lobe over the light's directions: axis, sharpness, amplitude.

    D's lobe in the half vector (sharpness 2 / r^4, amplitude 1 / (pi r^4)) warped about the mirror direction, where its
    sharpness is divided by 4 nv (Wang et al. 2009), F and V taken there. Reflected radiance is the integral of this
    lobe times the light times nl. Roughness 0.05 to 1; nv is held at 0.001. How far that is from the true GGX surface
    is shown in docs/light.md.
    """
    dtype, (normals, view, f0) = widen((normals, view), (f0,))
    alpha_squared = float(roughness) ** 4
    k = (roughness + 1.0) ** 2 / 8.0
    n_dot_v = dot(normals, view).clamp(COSINE_FLOOR, 1.0)
    masked = n_dot_v * (1.0 - k) + k
    amplitude = fresnel(f0, n_dot_v) / (4.0 * math.pi * alpha_squared * masked * masked)
    parts = unit(reflect(view, normals)), 0.5 / (alpha_squared * n_dot_v), amplitude
    return tuple(narrow(part, dtype) for part in parts)


def specular_radiance(
    normals: Float[Tensor, "n 3"],
    view: Float[Tensor, "n 3"],
    f0: Float[Tensor, " n"],
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
    *,
    roughness: float,
    visibility: Float[Tensor, "n m"] | None = None,
    grade: Grade = "accurate",
) -> Float[Tensor, "n 3"]:
    """Radiance reflected towards the camera by the specular lobe alone.

    D is warped to the incident side about the mirror direction (sharpness / (4 nv)) and multiplied with each light
    lobe; the product's mean cosine, its irradiance over its integral, is the nl of the visibility, so that a white
    furnace never returns more than F. F is taken at the mirror direction, where h = n.

    Parameters
    ----------
    normals, view : (N, 3) unit; view points to the camera. Surfaces seen from behind (nv < 0) count as grazing.
    f0 : (N,) in [0, 1]
    roughness : 0.05 to 1
    visibility : (N, M) in [0, 1], the share of each lobe that nothing stands before; 1 if None
    grade : "fast" is the published BRDF as it stands; "accurate" gives its lobe the energy of the GGX surface that
        viewers render (`ggx_albedo`), of which the published one keeps a half at nv = 0.3 and a tenth at 0.05

    Returns
    -------
    (N, 3), >= 0, finite
    """
    roughness = float(roughness)  # a NumPy scalar would lift the tensors to double
    directions, numbers = (normals, view, axis), (f0, sharpness, amplitude)
    dtype, (normals, view, axis, f0, sharpness, amplitude) = widen(directions, numbers)

    def block(*arguments):
        return _specular_radiance(*arguments, roughness, grade)

    points = normals, view, f0, None if visibility is None else visibility.to(normals.dtype)
    return narrow(in_blocks(block, points, (axis, sharpness, amplitude), pairs=len(sharpness)), dtype)


def _specular_radiance(
    normals: Tensor,
    view: Tensor,
    f0: Tensor,
    visibility: Tensor | None,
    axis: Tensor,
    sharpness: Tensor,
    amplitude: Tensor,
    roughness: float,
    grade: Grade,
) -> Tensor:
    alpha_squared = roughness**4
    k = (roughness + 1.0) ** 2 / 8.0
    n_dot_v = dot(normals, view).clamp(COSINE_FLOOR, 1.0)
    lobe_sharpness = 0.5 / (alpha_squared * n_dot_v)
    mirror = reflect(view, normals)

    distance_squared = squared_distance(mirror.unsqueeze(-2), axis)  # (n, m)
    product, exponent = product_scalars(lobe_sharpness.unsqueeze(-1), sharpness, distance_squared)
    cosine = (0.5 / alpha_squared + sharpness * (normals @ axis.mT)) / product  # lobe_sharpness nv = 1 / (2 alpha^2)
    reflected = torch.exp(exponent) * _masked(cosine, product, k)
    reflected = (reflected if visibility is None else visibility * reflected) @ amplitude

    if grade == "fast":
        gain = fresnel(f0, n_dot_v) / (4.0 * math.pi * alpha_squared * (n_dot_v * (1.0 - k) + k))
    else:
        gain = directional_albedo(n_dot_v, f0, roughness) / _masked(n_dot_v, lobe_sharpness, k)
    return gain.unsqueeze(-1) * reflected
