"""The fitted surface as the photo sees it, and as it does not.

Notation: as in fields/sa_sm.py; network units, canonical frame.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.sa_sm import sdf_and_gradient
from sira_assets.fit.geometry import GeometryFit
from sira_assets.fit.pixels import PixelRays, mask_rays
from sira_assets.render.tracing import sphere_trace
from sira_assets.scene.canonical import transform_points
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
    portrait: Portrait, geometry: GeometryFit, generator: torch.Generator, count: int = 4096
) -> tuple[Tensor, Tensor]:
    """x_ref and gamma of surface points of which the photo says nothing: there the refinement is to be nothing.

    Random points of the head's box, brought to the surface by Newton steps and kept where it faces away from the camera
    or is seen beside the mask, two pixels or more from it; a hole in the mask is bridged by what is around it.
    """
    device = geometry.z_sdf.device
    low, high = (torch.as_tensor(b / UNIT_M, dtype=torch.float32, device=device) for b in BOUNDS_M)
    x = low + (high - low) * torch.rand(4 * count, 3, generator=generator, device=device)
    for _ in range(6):
        f, gradient, _, _ = sdf_and_gradient(geometry.shape, x, geometry.z_sdf, differentiable=False)
        x = x - (f / gradient.square().sum(-1).clamp_min(0.25))[:, None] * gradient
    f, gradient, x_ref, gamma = sdf_and_gradient(geometry.shape, x, geometry.z_sdf, differentiable=False)
    posed = replace(portrait, canonical_from_world=geometry.canonical_from_world)
    away, beside = _unseen(posed, UNIT_M * x.double().cpu().numpy(), gradient.double().cpu().numpy())
    keep = torch.nonzero((f.abs() < 0.01) & torch.as_tensor(away | beside, device=device))[:, 0][:count]
    if len(keep) == 0:
        keep = torch.arange(min(count, len(x)), device=x.device)
    return x_ref[keep].detach(), gamma[keep].detach()


def _unseen(portrait: Portrait, x_m: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) bool each of canonical points: facing away from the camera; seen beside the mask or beyond the picture."""
    from scipy import ndimage

    centre = transform_points(portrait.canonical_from_world, portrait.camera.world_from_camera[None, :3, 3])
    to_camera = centre - x_m
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(to_camera, axis=1)
    cosine = (normals * to_camera).sum(1) / np.maximum(lengths, 1e-12)
    mask = ndimage.binary_dilation(ndimage.binary_fill_holes(portrait.mask), iterations=2)
    pixel, depth = portrait.camera.project(transform_points(portrait.world_from_canonical, x_m))
    column, row = np.floor(np.clip(pixel, -1, [portrait.camera.width, portrait.camera.height])).astype(int).T
    inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1]) & (depth > 0)
    in_mask = np.zeros(len(x_m), bool)
    in_mask[inside] = mask[row[inside], column[inside]]
    return cosine < -0.05, ~in_mask
