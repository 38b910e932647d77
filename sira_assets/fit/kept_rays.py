"""Rays that a fit follows: each keeps its hit from step to step and is traced anew now and then.

Notation: rays o + t d in the canonical frame, network units, before the pose correction; f the signed distance.
"""

import torch
from torch import Tensor

from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.sa_sm import ShapeAppearanceModel
from sira_assets.fit.pixels import PixelRays
from sira_assets.fit.pose import PoseCorrection, corrected
from sira_assets.render.tracing import TraceConfig, sphere_trace


class KeptRays:
    """A pool of rays with the hit that each had last; `t` and `hit` change in place."""

    def __init__(self, rays: PixelRays, weight: Tensor):
        self.rays, self.weight = rays, weight
        self.t = torch.zeros_like(rays.origins[:, 0])
        self.hit = torch.zeros_like(rays.in_mask)

    def retrace(self, model: ShapeAppearanceModel, z_sdf: Tensor, pose: PoseCorrection, config=TraceConfig()) -> None:
        """Trace all rays."""
        low, high = (self.t.new_tensor(b / UNIT_M) for b in BOUNDS_M)
        with torch.no_grad():
            origins, directions = corrected(pose, self.rays.origins, self.rays.directions)
            hits = sphere_trace(lambda x: model(x, z_sdf)[0], origins, directions, low, high, config)
        self.t.copy_(hits.t)
        self.hit.copy_(hits.hit)

    def deepest(self, model: ShapeAppearanceModel, z_sdf: Tensor, pose: PoseCorrection, reach=0.6, samples=12) -> None:
        """Move each hit to the lowest f within `reach` behind it: how far a wrong hit is inside."""
        with torch.no_grad():
            origins, directions = corrected(pose, self.rays.origins, self.rays.directions)
            ts = self.t[:, None] + torch.linspace(0.0, reach, samples, device=self.t.device)
            points = origins[:, None] + ts[..., None] * directions[:, None]
            f = model(points.reshape(-1, 3), z_sdf)[0].view(ts.shape)
            self.t.copy_(torch.where(self.hit, ts.gather(1, f.argmin(1, keepdim=True))[:, 0], self.t))

    def draw(self, count: int, generator: torch.Generator, where: Tensor) -> Tensor:
        """Indices of at most `count` rays, drawn by weight times `where`."""
        weight = self.weight * where
        if not bool((weight > 0).any()):
            return torch.zeros(0, dtype=torch.int64, device=weight.device)
        return torch.multinomial(weight, min(count, int((weight > 0).sum())), generator=generator)
