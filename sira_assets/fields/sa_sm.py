"""SA-SM, the shape-and-appearance model (SIRA section 3.1).

Notation, all in network units (UNIT_M canonical metres): x a point of a head; f_def(x; z_sdf) -> (delta, gamma);
x_ref = x + delta; f_ref(x_ref) the reference signed distance; f_sdf(x) = f_ref(x + delta); r(x_ref, n, v, gamma; z_r)
-> RGB, sRGB-encoded, not physically based. z_sdf and z_r are one scene's latent codes.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sira_assets.fields.mlp import MLP, encode, encoded_size


@dataclass(frozen=True)
class ShapeConfig:
    """Sizes of SA-SM, chosen for two CPU cores (a step of 8k points in a few tenths of a second).

    Parameters
    ----------
    reference : False leaves the reference out: the first network maps (x, z_sdf) to f_sdf and gamma themselves, and
        x_ref = x (the paper's ablation, and H3D-Net's model)
    joint_appearance : False trains shapes without the renderer; a fit then begins with an untrained one
    """

    code_size: int = 64
    appearance_code_size: int = 64
    feature_size: int = 16
    deformation_width: int = 128
    deformation_depth: int = 4
    deformation_octaves: int = 4
    reference_width: int = 128
    reference_depth: int = 4
    reference_octaves: int = 5
    renderer_width: int = 192
    renderer_depth: int = 4
    renderer_octaves: int = 5
    reference: bool = True
    joint_appearance: bool = True


class ShapeAppearanceModel(nn.Module):
    """The three networks of SA-SM."""

    def __init__(self, config: ShapeConfig = ShapeConfig()):
        super().__init__()
        self.config = config
        c = config
        self.deformation = MLP(
            encoded_size(3, c.deformation_octaves) + c.code_size,
            (3 if c.reference else 1) + c.feature_size,
            width=c.deformation_width,
            depth=c.deformation_depth,
        )
        self.reference = None
        if c.reference:
            # Heads start undeformed: the reference is what they have in common.
            nn.init.normal_(self.deformation.out.weight, std=1e-3)
            sizes = {"width": c.reference_width, "depth": c.reference_depth}
            self.reference = MLP(encoded_size(3, c.reference_octaves), 1, **sizes)
        self.renderer = MLP(
            encoded_size(3, c.renderer_octaves) + 3 + 3 + c.feature_size + c.appearance_code_size,
            3,
            width=c.renderer_width,
            depth=c.renderer_depth,
        )

    def deform(
        self, x: Float[Tensor, "N 3"], z_sdf: Float[Tensor, "..."]
    ) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N G"]]:
        """delta and gamma at x; without a reference delta is zero."""
        out = self.deformation(encode(x, self.config.deformation_octaves), z_sdf)
        return (out[:, :3], out[:, 3:]) if self.config.reference else (torch.zeros_like(x), out[:, 1:])

    def reference_sdf(self, x_ref: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """f_ref: the signed distance all heads share, network units; a ball of one unit before training."""
        return self.reference(encode(x_ref, self.config.reference_octaves))[:, 0] + _ball(x_ref)

    def forward(
        self, x: Float[Tensor, "N 3"], z_sdf: Float[Tensor, "..."]
    ) -> tuple[Float[Tensor, " N"], Float[Tensor, "N 3"], Float[Tensor, "N G"]]:
        """f_sdf(x), x_ref and gamma."""
        if not self.config.reference:
            out = self.deformation(encode(x, self.config.deformation_octaves), z_sdf)
            return out[:, 0] + _ball(x), x, out[:, 1:]
        delta, gamma = self.deform(x, z_sdf)
        x_ref = x + delta
        return self.reference_sdf(x_ref), x_ref, gamma

    def render(
        self,
        x_ref: Float[Tensor, "N 3"],
        normals: Float[Tensor, "N 3"],
        view: Float[Tensor, "N 3"],
        gamma: Float[Tensor, "N G"],
        z_r: Float[Tensor, "..."],
    ) -> Float[Tensor, "N 3"]:
        """r: sRGB-encoded colour in (0, 1); `view` points from the surface to the camera."""
        inputs = torch.cat([encode(x_ref, self.config.renderer_octaves), normals, view, gamma], -1)
        return torch.sigmoid(self.renderer(inputs, z_r))


def _ball(x: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Signed distance of a ball of one unit, differentiable at its centre: where networks start from."""
    return torch.sqrt((x**2).sum(-1) + 1e-6) - 1.0


def sdf_and_gradient(
    model: ShapeAppearanceModel, x: Float[Tensor, "N 3"], z_sdf: Float[Tensor, "..."], *, differentiable: bool
) -> tuple[Float[Tensor, " N"], Float[Tensor, "N 3"], Float[Tensor, "N 3"], Float[Tensor, "N G"]]:
    """f_sdf, its gradient in x, x_ref and gamma.

    `differentiable` keeps the graph of the gradient (eikonal and normal losses); otherwise the gradient is detached.
    """
    with torch.enable_grad():
        x = x.detach().requires_grad_(True) if not x.requires_grad else x
        sdf, x_ref, gamma = model(x, z_sdf)
        (gradient,) = torch.autograd.grad(sdf.sum(), x, create_graph=differentiable, retain_graph=True)
    return sdf, gradient, x_ref, gamma
