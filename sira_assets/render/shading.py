"""Local shading of surface points by spherical gaussian light: SIRA's r_pb = r_d + r_s without shadows or bounces.

Notation: n normals, v view (towards the camera), a diffuse albedo (linear), s specular albedo as F0; light as in
`numerics.sg`. All in one frame (world).
"""

import math
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from sira_assets.numerics.sg import Grade, irradiance
from sira_assets.numerics.sg_specular import specular_radiance

# One roughness for all skin, hair and cloth (SIRA, section 3.2: "one fixed roughness"), r with GGX alpha = r^2 as in glTF.
# Skin's specular lobe, measured over faces, corresponds to r of 0.4 to 0.6 (Weyrich et al. 2006, Analysis of Human Faces
# using a Measurement-Based Skin Reflectance Model, doi:10.1145/1141911.1141987): the middle of that range.
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

    diffuse_radiance: Float[Tensor, "*n 3"]
    specular_radiance: Float[Tensor, "*n 3"]
    irradiance: Float[Tensor, "*n 3"]

    @property
    def radiance(self) -> Float[Tensor, "*n 3"]:
        """Diffuse and specular together."""
        return self.diffuse_radiance + self.specular_radiance


def shade(
    normals: Float[Tensor, "*n 3"],
    view: Float[Tensor, "*n 3"],
    diffuse: Float[Tensor, "*n 3"],
    specular_f0: Float[Tensor, "*n"],
    axis: Float[Tensor, "m 3"],
    sharpness: Float[Tensor, " m"],
    amplitude: Float[Tensor, "m 3"],
    *,
    roughness: float | Tensor = ROUGHNESS,
    grade: Grade = "fast",
) -> Shading:
    """Shade points by distant light.

    Parameters
    ----------
    normals, view : (N, 3) unit; view points from the surface to the camera
    diffuse : (N, 3) albedo in [0, 1], linear
    specular_f0 : (N,) in [0, 1]
    axis, sharpness, amplitude : the light's lobes, in the frame of the normals
    roughness : 0.05 to 1
    grade : see `numerics.sg.irradiance`
    """
    light = irradiance(normals, axis, sharpness, amplitude, grade=grade)
    specular = specular_radiance(normals, view, specular_f0, axis, sharpness, amplitude, roughness=roughness)
    return Shading(diffuse * light / math.pi, specular, light)
