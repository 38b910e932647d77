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

from sira_assets.numerics.exponential import phi1
from sira_assets.numerics.sg import product_scalars
from sira_assets.numerics.sg_irradiance import irradiance_accurate
from sira_assets.numerics.vector import dot, reflect, squared_distance

# The warped lobe's sharpness is 1 / (2 r^4 nv). Below this cosine (0.06 degrees from grazing) it is held.
COSINE_FLOOR = 1e-3


def fresnel(f0: Tensor, cosine: Tensor) -> Tensor:
    """Karis' fit of Schlick's Fresnel: f0 + (1 - f0) 2^{-(5.55473 c + 6.98316) c}, c = v . h in [0, 1]."""
    return f0 + (1.0 - f0) * torch.exp2(-(5.55473 * cosine + 6.98316) * cosine)


def specular_radiance(
    normals: Float[Tensor, "*n 3"],
    view: Float[Tensor, "*n 3"],
    f0: Float[Tensor, "*n"],
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
    *,
    roughness: float | Tensor,
) -> Float[Tensor, "*n 3"]:
    """Radiance reflected towards the camera by the specular lobe alone.

    D is warped to the incident side about the mirror direction (sharpness / (4 nv)) and multiplied with each light
    lobe; the product's mean cosine, its irradiance over its integral, is the nl of the visibility, so that a white
    furnace never returns more than F. F is taken at the mirror direction, where h = n.

    Parameters
    ----------
    normals, view : (..., 3) unit; view points to the camera. Surfaces seen from behind (nv < 0) count as grazing.
    f0 : (...) in [0, 1]
    roughness : 0.05 to 1

    Returns
    -------
    (..., 3), >= 0, finite
    """
    roughness = torch.as_tensor(roughness, dtype=normals.dtype, device=normals.device)
    alpha_squared = roughness**4
    k = (roughness + 1.0) ** 2 / 8.0
    n_dot_v = dot(normals, view).clamp(COSINE_FLOOR, 1.0)
    warped_sharpness = (0.5 / (alpha_squared * n_dot_v)).unsqueeze(-1)
    mirror = reflect(view, normals)

    product, exponent = product_scalars(
        warped_sharpness, sharpness, squared_distance(mirror.unsqueeze(-2), axis)
    )  # (..., m)
    light_cosine = normals @ axis.mT
    cosine = (warped_sharpness * n_dot_v.unsqueeze(-1) + sharpness * light_cosine) / product
    integral = 4.0 * math.pi * phi1(2.0 * product)
    weighted = irradiance_accurate(cosine.clamp(-1.0, 1.0), product)
    mean_cosine = weighted / integral
    masked = weighted / (mean_cosine * (1.0 - k) + k)  # int G_product n.l / (n.l (1-k) + k) dl
    reflected = (torch.exp(exponent) * masked) @ amplitude

    view_side = fresnel(f0, n_dot_v) / (4.0 * (n_dot_v * (1.0 - k) + k))
    return (view_side / (math.pi * alpha_squared)).unsqueeze(-1) * reflected
