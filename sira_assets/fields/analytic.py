"""Analytic heads: exact surfaces and materials that stand in for a fitted head in tests and examples."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class SphereHead:
    """A sphere with a smooth, position-dependent material.

    Parameters
    ----------
    radius_m, centre_m : canonical metres
    """

    radius_m: float = 0.1
    centre_m: tuple[float, float, float] = (0.0, 0.0, -0.05)

    def sdf(self, x_canonical: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """Exact signed distance."""
        return torch.linalg.norm(x_canonical - x_canonical.new_tensor(self.centre_m), dim=-1) - self.radius_m

    def material(self, x_canonical: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
        """Albedos that vary linearly with position, so that interpolation can be checked exactly."""
        return linear_material(x_canonical)


@dataclass(frozen=True)
class EllipsoidHead:
    """An axis-aligned ellipsoid; its field is a first-order distance (exact zero set, Lipschitz bound 1 near it).

    f(x) = k0 (k0 - 1) / k1 with k0 = |x / r|, k1 = |x / r^2| (Quilez's bound); exact on the surface.
    """

    radii_m: tuple[float, float, float] = (0.075, 0.11, 0.095)
    centre_m: tuple[float, float, float] = (0.0, -0.01, -0.07)

    def sdf(self, x_canonical: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """First-order signed distance."""
        x = x_canonical - x_canonical.new_tensor(self.centre_m)
        radii = x.new_tensor(self.radii_m)
        k0 = torch.linalg.norm(x / radii, dim=-1)
        k1 = torch.linalg.norm(x / radii**2, dim=-1).clamp_min(1e-6)
        return k0 * (k0 - 1.0) / k1

    def material(self, x_canonical: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
        """See `linear_material`."""
        return linear_material(x_canonical)


def linear_material(x_canonical: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
    """Diffuse albedo 0.5 + x (per axis, canonical metres, times 1) and F0 = 0.04 (1 + x_y), both linear in position."""
    return (0.5 + x_canonical).clamp(0.0, 1.0), 0.04 * (1.0 + x_canonical[:, 1]).clamp(0.0, 2.0)
