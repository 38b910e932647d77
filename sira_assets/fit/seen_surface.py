"""The fitted surface as the photo sees it, and as it does not.

Notation: as in fields/sa_sm.py; network units, canonical frame.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.sa_sm import sdf_and_gradient
from sira_assets.fit.geometry import GeometryFit
from sira_assets.fit.pixels import PixelRays, mask_rays
from sira_assets.render.tracing import sphere_trace
from sira_assets.scene.portrait import Portrait


@dataclass(frozen=True)
class SurfacePoints:
    """What the camera sees of the fitted surface, one row a pixel, in network units and the canonical frame."""

    x: Tensor
    normals: Tensor
    view: Tensor
    x_ref: Tensor
    gamma: Tensor
    rays: PixelRays

    def __len__(self) -> int:
        return len(self.x)

    def rows(self, index: Tensor) -> "SurfacePoints":
        """Some of the points."""
        tensors = (self.x, self.normals, self.view, self.x_ref, self.gamma)
        return SurfacePoints(*(t[index] for t in tensors), self.rays.select(index))


def visible_surface(
    portrait: Portrait,
    geometry: GeometryFit,
    *,
    at_most: int | None = None,
    generator: torch.Generator | None = None,
    chunk: int = 16384,
) -> SurfacePoints:
    """Trace the mask's pixels (a random `at_most` of them, in the picture's order); those that miss are left out."""
    posed = replace(portrait, canonical_from_world=geometry.canonical_from_world)
    rays = mask_rays(posed, device=geometry.z_sdf.device)
    if at_most is not None and len(rays) > at_most:
        chosen = torch.randperm(len(rays), generator=generator, device=rays.origins.device)[:at_most]
        rays = rays.select(chosen.sort().values)
    low, high = (rays.origins.new_tensor(b / UNIT_M) for b in BOUNDS_M)
    with torch.no_grad():
        hits = sphere_trace(lambda x: geometry.shape(x, geometry.z_sdf)[0], rays.origins, rays.directions, low, high)
    rays = rays.select(torch.nonzero(hits.hit)[:, 0])
    x = rays.origins + hits.t[hits.hit, None] * rays.directions
    parts: list[list[Tensor]] = [[], [], []]
    for piece in x.split(chunk):
        _, gradient, x_ref, gamma = sdf_and_gradient(geometry.shape, piece, geometry.z_sdf, differentiable=False)
        for column, value in zip(parts, (nn.functional.normalize(gradient, dim=-1), x_ref, gamma), strict=True):
            column.append(value.detach())
    normals, x_ref, gamma = (torch.cat(column) for column in parts)
    return SurfacePoints(x, normals, -rays.directions, x_ref, gamma, rays)


@torch.no_grad()
def hidden_surface(
    geometry: GeometryFit, surface: SurfacePoints, generator: torch.Generator, count: int = 4096
) -> tuple[Tensor, Tensor]:
    """x_ref and gamma of surface points that the camera does not see: there the refinement is to be nothing.

    Random points of the head's box, brought to the surface by Newton steps and kept where it faces away.
    """
    low, high = (surface.x.new_tensor(b / UNIT_M) for b in BOUNDS_M)
    x = low + (high - low) * torch.rand(4 * count, 3, generator=generator, device=surface.x.device)
    for _ in range(6):
        f, gradient, _, _ = sdf_and_gradient(geometry.shape, x, geometry.z_sdf, differentiable=False)
        x = x - (f / gradient.square().sum(-1).clamp_min(0.25))[:, None] * gradient
    f, gradient, x_ref, gamma = sdf_and_gradient(geometry.shape, x, geometry.z_sdf, differentiable=False)
    # The camera's direction varies little over a head; points that face away from it are hidden.
    facing = (nn.functional.normalize(gradient, dim=-1) * surface.view.mean(0)).sum(-1)
    keep = torch.nonzero((f.abs() < 0.01) & (facing < -0.05))[:, 0][:count]
    if len(keep) == 0:
        keep = torch.arange(min(count, len(x)), device=x.device)
    return x_ref[keep].detach(), gamma[keep].detach()
