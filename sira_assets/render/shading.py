"""Shading of surface points by spherical gaussian light: SIRA's r_pb = r_d + r_s, shadowed where visibility is given.

Notation: n normals, v view (towards the camera), a diffuse albedo (linear), s specular albedo as F0; light as in
`numerics.sg`. All in one frame (world).
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.numerics.precision import narrow, widen
from sira_assets.numerics.sg import Grade, irradiance
from sira_assets.numerics.sg_specular import specular_radiance

# One roughness for skin, hair and cloth, as SIRA fixes one; GGX alpha = r^2 = 0.25, r as in glTF. Faces were measured
# by Weyrich et al. (Analysis of Human Faces using a Measurement-Based Skin Reflectance Model, SIGGRAPH 2006,
# doi:10.1145/1141911.1141987); for real-time use d'Eon and Luebke (GPU Gems 3, chapter 14, 2007) draw one value from
# them, a microfacet slope m = 0.3, which in these terms is r = sqrt(m) = 0.55. Rounded to what asset tools default to.
ROUGHNESS = 0.5


@dataclass(frozen=True)
class Shading:
    """What reaches the camera from N points, linear radiance.

    Parameters
    ----------
    diffuse_radiance : (N, 3) albedo / pi times irradiance
    specular_radiance : (N, 3)
    irradiance : (N, 3)
    """

    diffuse_radiance: Float[Tensor, "n 3"]
    specular_radiance: Float[Tensor, "n 3"]
    irradiance: Float[Tensor, "n 3"]

    @property
    def radiance(self) -> Float[Tensor, "n 3"]:
        """Diffuse and specular together."""
        return self.diffuse_radiance + self.specular_radiance


def shade(
    normals: Float[Tensor, "n 3"],
    view: Float[Tensor, "n 3"],
    diffuse: Float[Tensor, "n 3"],
    specular_f0: Float[Tensor, " n"] | None,
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
    *,
    roughness: float = ROUGHNESS,
    visibility: Float[Tensor, "n m"] | None = None,
    grade: Grade = "accurate",
) -> Shading:
    """Shade points by distant light.

    Parameters
    ----------
    normals, view : (N, 3) unit; view points from the surface to the camera
    diffuse : (N, 3) albedo in [0, 1], linear
    specular_f0 : (N,) in [0, 1]; None is a surface that reflects nothing, while 0 still does at grazing angles
    axis, sharpness, amplitude : the light's lobes, in the frame of the normals
    roughness : 0.05 to 1
    visibility : (N, M) in [0, 1], the share of each lobe's light that nothing stands before; 1 if None
    grade : see `numerics.sg.irradiance` and `numerics.sg_specular.specular_radiance`
    """
    reflecting = () if specular_f0 is None else (specular_f0,)
    directions, numbers = (normals, view, axis), (diffuse, sharpness, amplitude, *reflecting)
    dtype, (normals, view, axis, diffuse, sharpness, amplitude, *reflecting) = widen(directions, numbers)
    light = irradiance(normals, axis, sharpness, amplitude, visibility=visibility, grade=grade)
    specular = torch.zeros_like(light)
    for f0 in reflecting:
        specular = specular_radiance(
            normals, view, f0, axis, sharpness, amplitude, roughness=roughness, visibility=visibility, grade=grade
        )
    return Shading(*(narrow(part, dtype) for part in (diffuse * light / math.pi, specular, light)))
