"""AF-SM, the appearance-factorisation model (SIRA section 3.2).

Notation: x_ref, gamma from SA-SM's deformation; a(x_ref, gamma; z_a) diffuse albedo in (0, 1); s(x_ref, a; z_s)
specular albedo, an F0 in (0, MAX_F0); l(z_l) -> N_l spherical gaussians (axis, log sharpness, log amplitude), in the
canonical frame.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sira_assets.fields.mlp import MLP, encode, encoded_size
from sira_assets.numerics.srgb import srgb_encode

# Skin, hair, cloth and eyes reflect at most a tenth at normal incidence (index of refraction <= 1.9).
MAX_F0 = 0.1


@dataclass(frozen=True)
class AppearanceConfig:
    """Sizes of AF-SM."""

    albedo_code_size: int = 32
    specular_code_size: int = 8
    light_code_size: int = 32
    lobes: int = 12
    albedo_width: int = 128
    albedo_depth: int = 4
    albedo_octaves: int = 6
    specular_width: int = 64
    specular_depth: int = 2
    specular_octaves: int = 4
    light_width: int = 64


class AppearanceFactorModel(nn.Module):
    """The three decoders of AF-SM."""

    def __init__(self, config: AppearanceConfig = AppearanceConfig(), *, feature_size: int = 16):
        super().__init__()
        self.config = config
        c = config
        self.albedo = MLP(
            encoded_size(3, c.albedo_octaves) + feature_size + c.albedo_code_size,
            3,
            width=c.albedo_width,
            depth=c.albedo_depth,
        )
        self.specular = MLP(
            encoded_size(3, c.specular_octaves) + 3 + c.specular_code_size,
            1,
            width=c.specular_width,
            depth=c.specular_depth,
        )
        self.light = MLP(c.light_code_size, 7 * c.lobes, width=c.light_width, depth=2)
        nn.init.normal_(self.light.out.weight, std=0.02)
        self.register_buffer("axes", fibonacci_sphere(c.lobes))

    def diffuse(
        self, x_ref: Float[Tensor, "N 3"], gamma: Float[Tensor, "N G"], z_a: Float[Tensor, "..."]
    ) -> Float[Tensor, "N 3"]:
        """a: linear diffuse albedo."""
        inputs = torch.cat([encode(x_ref, self.config.albedo_octaves), gamma], -1)
        return torch.sigmoid(self.albedo(inputs, z_a) - 1.0)

    def specular_f0(
        self, x_ref: Float[Tensor, "N 3"], diffuse: Float[Tensor, "N 3"], z_s: Float[Tensor, "..."]
    ) -> Float[Tensor, " N"]:
        """s: F0; 0.04 ks with ks near 0.8 before training.

        It reads the diffuse albedo, which the paper's does not: hair, brows, lips and cloth differ from skin in both,
        and the photo shows the edges of the one and not of the other. No gradient goes back into `diffuse`.
        """
        inputs = torch.cat([encode(x_ref, self.config.specular_octaves), srgb_encode(diffuse.detach())], -1)
        out = self.specular(inputs, z_s)[:, 0]
        return MAX_F0 * torch.sigmoid(out - 0.75)

    def lobes(
        self, z_l: Float[Tensor, "B Z"]
    ) -> tuple[Float[Tensor, "B M 3"], Float[Tensor, "B M"], Float[Tensor, "B M 3"]]:
        """l: unit axes, sharpness in about (0.007, 3000) and amplitude > 0 of each scene's lobes."""
        raw = self.light(z_l).unflatten(-1, (self.config.lobes, 7))
        axis = nn.functional.normalize(self.axes + raw[..., :3], dim=-1)
        sharpness = torch.exp(1.5 + 6.5 * torch.tanh(raw[..., 3] / 4.0))
        amplitude = torch.exp(torch.clamp(raw[..., 4:] - 0.7, -16.0, 8.0))
        return axis, sharpness, amplitude


def fibonacci_sphere(count: int) -> Float[Tensor, "M 3"]:
    """`count` nearly even unit directions (Swinbank and Purser 2006, DOI 10.1256/qj.05.227)."""
    i = torch.arange(count, dtype=torch.float64) + 0.5
    y = 1.0 - 2.0 * i / count
    phi = i * torch.pi * (3.0 - 5.0**0.5)
    radius = torch.sqrt(1.0 - y**2)
    return torch.stack([radius * torch.cos(phi), y, radius * torch.sin(phi)], -1).float()
