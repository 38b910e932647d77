"""Rays that a fit follows: each keeps its hit from step to step and is traced anew now and then.

Notation: rays o + t d in the canonical frame, network units, before the pose correction; f the signed distance.
"""

import torch
from torch import Tensor

from sira_assets.fields.head_field import BOUNDS_M, CHUNK
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.sa_sm import ShapeAppearanceModel
from sira_assets.fit.pixels import EAR, PixelRays, on_ears
from sira_assets.fit.pose import PoseCorrection, corrected
from sira_assets.render.tracing import TraceConfig, sphere_trace

# So far from what the codes make of an ear no ear goes (network units: 8 mm).
BEYOND_AN_EAR = 0.08
# Rays that would draw out a covered ear by more than this (6 mm) look for another place.
EAR_REACH = 0.06


class KeptRays:
    """Some of a photo's rays, with the hit that each had last; `index`, `t`, `hit` and `lowest` change in place.

    Parameters
    ----------
    every : rays to choose from
    weight : (len(every),) how often each is chosen
    count : rays followed at a time
    """

    def __init__(self, every: PixelRays, weight: Tensor, count: int):
        self.every, self.weight = every, weight
        self.index = torch.arange(min(count, len(every)), device=weight.device)
        self.t = torch.zeros_like(every.origins[: len(self.index), 0])
        self.hit = torch.zeros_like(every.in_mask[: len(self.index)])
        self.lowest = torch.zeros_like(self.t)

    @property
    def rays(self) -> PixelRays:
        """Those followed now."""
        return self.every.select(self.index)

    def choose(self, generator: torch.Generator) -> None:
        """Follow other rays, so that over a fit every pixel has its say."""
        self.index.copy_(torch.multinomial(self.weight, len(self.index), generator=generator))

    def retrace(self, model: ShapeAppearanceModel, z_sdf: Tensor, pose: PoseCorrection, config=TraceConfig()) -> None:
        """Trace the rays followed."""
        rays = self.rays
        low, high = (self.t.new_tensor(b / UNIT_M) for b in BOUNDS_M)
        with torch.no_grad():
            origins, directions = corrected(pose, rays.origins, rays.directions)
            hits = sphere_trace(lambda x: model(x, z_sdf)[0], origins, directions, low, high, config)
        self.t.copy_(hits.t)
        self.hit.copy_(hits.hit)

    def attend(
        self,
        attention: float,
        at_most: int,
        model: ShapeAppearanceModel,
        z_sdf: Tensor,
        pose: PoseCorrection,
        config=TraceConfig(),
    ) -> None:
        """Trace all rays and follow those on the wrong side of the silhouette `attention` times as often from then on.

        Of more than `at_most` every so many are traced, and stand for those behind them: rays come row by row.
        """
        step = -(-len(self.every) // at_most)
        low, high = (self.t.new_tensor(b / UNIT_M) for b in BOUNDS_M)
        for part in torch.arange(0, len(self.every), step, device=self.t.device).split(CHUNK):
            rays = self.every.select(part)
            with torch.no_grad():
                origins, directions = corrected(pose, rays.origins, rays.directions)
                hit = sphere_trace(lambda x: model(x, z_sdf)[0], origins, directions, low, high, config).hit
            wrong = (hit != rays.in_mask).repeat_interleave(step)[: len(self.every) - int(part[0])]
            self.weight[part[0] : part[0] + len(wrong)] = torch.where(wrong, attention, 1.0)

    def deepest(self, model: ShapeAppearanceModel, z_sdf: Tensor, pose: PoseCorrection, reach=0.6, samples=12) -> None:
        """Move each hit to the lowest f within `reach` behind it, and note it: how far a hit is inside."""
        rays = self.rays
        with torch.no_grad():
            origins, directions = corrected(pose, rays.origins, rays.directions)
            ts = self.t[:, None] + torch.linspace(0.0, reach, samples, device=self.t.device)
            points = origins[:, None] + ts[..., None] * directions[:, None]
            f = model(points.reshape(-1, 3), z_sdf)[0].view(ts.shape)
            lowest, at = f.min(1)
            self.lowest.copy_(lowest)
            self.t.copy_(torch.where(self.hit, ts.gather(1, at[:, None])[:, 0], self.t))

    def beyond_ears(self, model: ShapeAppearanceModel, z_sdf: Tensor, pose: PoseCorrection) -> Tensor:
        """(2,) shares of the rays that the mask has further out beside the right and the left ear than ears reach."""
        rays = self.rays
        with torch.no_grad():
            origins, directions = corrected(pose, rays.origins, rays.directions)
            f, x_ref, _ = model(origins + self.t[:, None] * directions, z_sdf)
            beyond = ~self.hit & rays.in_mask & (f > BEYOND_AN_EAR)
        return (beyond[:, None] & on_ears(x_ref)).float().mean(0)

    def spare_ears(
        self,
        model: ShapeAppearanceModel,
        z_sdf: Tensor,
        pose: PoseCorrection,
        before: ShapeAppearanceModel,
        before_z: Tensor,
        covered: Tensor,
        reach=1.2,
        samples=32,
    ) -> None:
        """Let rays of the mask that miss and would draw an ear out follow another part of the head.

        Of all that a head has, an ear is mostly nearest to the outline of hair that covers it. A ray that passes
        nothing else stays where it is.

        Parameters
        ----------
        before, before_z : the head whose ears are spared
        covered : (2,) bool, whether the right and the left ear are
        reach : how far along a ray, from where it comes nearest, another place is looked for, in `samples` places
        """
        missed = torch.nonzero(~self.hit & self.every.in_mask[self.index])[:, 0]
        if not len(missed):
            return
        rays = self.every.select(self.index[missed])
        with torch.no_grad():
            origins, directions = corrected(pose, rays.origins, rays.directions)
            along = torch.linspace(-reach, reach, samples, device=self.t.device)
            ts = self.t[missed, None] + torch.cat([along.new_zeros(1), along])
            points = (origins[:, None] + ts[..., None] * directions[:, None]).reshape(-1, 3)
            f_before, x_ref, _ = before(points, before_z)
            drawn_out = ((on_ears(x_ref) & covered).any(-1) & (f_before > EAR_REACH)).view(ts.shape)
            # Cheeks and temples are no place for hair to stand off either.
            before_ears = (x_ref[:, 2] > EAR[1][2]).view(ts.shape)
            f = model(points, z_sdf)[0].view(ts.shape).masked_fill(drawn_out | before_ears, torch.inf)
            elsewhere = ts.gather(1, f.argmin(1, keepdim=True))[:, 0]
            self.t[missed] = torch.where(drawn_out[:, 0], elsewhere, self.t[missed])

    def draw(self, count: int, generator: torch.Generator, where: Tensor) -> Tensor:
        """At most `count` of the rays followed, drawn by `where`; their positions among them."""
        if not bool((where > 0).any()):
            return torch.zeros(0, dtype=torch.int64, device=where.device)
        return torch.multinomial(where, min(count, int((where > 0).sum())), generator=generator)

    def drawn(self, chosen: Tensor) -> PixelRays:
        """The rays at these positions."""
        return self.every.select(self.index[chosen])
