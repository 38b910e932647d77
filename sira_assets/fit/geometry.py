"""Single-view geometry (SIRA section 3.3, first step): phase A finds the codes, phase B frees the networks.

Notation: as in fields/sa_sm.py and render/tracing.py; c coefficients of the codes' gaussians (sigma units), so |c|^2 is
the prior's energy. The reference signed distance is never changed: it is what all heads share.
"""

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior, freeze
from sira_assets.fields.sa_sm import ShapeAppearanceModel, sdf_and_gradient
from sira_assets.fit.pixels import (
    CUT_Y_M,
    PixelRays,
    face_weight,
    mask_rays,
    pixel_rays,
    require_pixels,
    silhouette_band,
)
from sira_assets.fit.pose import POSE_SIGMA, PoseCorrection, corrected
from sira_assets.render.tracing import TraceConfig, differentiable_hit, sphere_trace
from sira_assets.scene.portrait import Portrait

# Over this distance (network units: 1 cm) the change of the deformation should be even.
SLOPE_REACH = 0.1
# torch.multinomial takes at most 2^24 weights; a photo larger than this is drawn from at random first.
MOST_PIXELS = 2_000_000


@dataclass(frozen=True)
class GeometryFitConfig:
    """Steps, rays and weights.

    Rays are kept and followed: each step moves a kept ray's hit by one Newton step, and all are traced anew every
    `retrace` steps.
    """

    steps_appearance: int = 80
    steps_codes: int = 200
    steps_networks: int = 320
    pool: int = 6000
    band_pool: int = 2500
    rays: int = 1000
    band_rays: int = 400
    retrace: int = 40
    rate_codes: float = 0.04
    rate_appearance_codes: float = 0.08
    rate_pose: float = 0.004
    rate_networks: float = 1.5e-4
    colour: float = 1.0
    silhouette: float = 0.5
    # Sharpness of the soft silhouette: sigmoid(-alpha f) of the nearest point of a missed ray, per network unit.
    alpha: float = 50.0
    reach: float = 0.1
    reach_networks: float = 0.8
    # In phase B a pixel of the mask without surface costs this much more than surface outside the mask: it would stay
    # a hole in the render.
    cover: float = 8.0
    prior: float = 1.0e-3
    appearance_prior: float = 3.0e-6
    eikonal: float = 0.05
    # Phase B stays near phase A: squared change of the deformation over the surface and around it.
    anchor: float = 4.0
    slope: float = 0.1
    pose: float = 2.0e-3
    # A ray whose kept hit is further than this off the surface waits for the next retrace.
    lost: float = 0.08
    seed: int = 0


@dataclass(frozen=True)
class GeometryFit:
    """What the geometry fit adds to a portrait.

    Parameters
    ----------
    shape : SA-SM, its deformation and renderer fine-tuned, frozen
    z_sdf, z_r : codes
    canonical_from_world : (4, 4), refined where the portrait's was an estimate
    history : (step, loss term means) every ten steps
    pose_change_deg, pose_change_m : size of the refinement
    """

    shape: ShapeAppearanceModel
    z_sdf: Float[Tensor, " Z"]
    z_r: Float[Tensor, " Z"]
    canonical_from_world: np.ndarray
    history: tuple[tuple[int, dict[str, float]], ...]
    pose_change_deg: float
    pose_change_m: float
    seconds: float


class _KeptRays:
    """A pool of rays with the hit that each had last."""

    def __init__(self, rays: PixelRays, weight: Tensor):
        self.rays, self.weight = rays, weight
        self.t = torch.zeros_like(rays.origins[:, 0])
        self.hit = torch.zeros_like(rays.in_mask)

    def retrace(self, model, z_sdf, pose, config=TraceConfig()):
        low, high = (self.t.new_tensor(b / UNIT_M) for b in BOUNDS_M)
        with torch.no_grad():
            origins, directions = corrected(pose, self.rays.origins, self.rays.directions)
            hits = sphere_trace(lambda x: model(x, z_sdf)[0], origins, directions, low, high, config)
        self.t, self.hit = hits.t, hits.hit

    def deepest(self, model, z_sdf, pose, reach=0.6, samples=12):
        """Move each hit to the lowest f within `reach` behind it: how far a wrong hit is inside."""
        with torch.no_grad():
            origins, directions = corrected(pose, self.rays.origins, self.rays.directions)
            ts = self.t[:, None] + torch.linspace(0.0, reach, samples, device=self.t.device)
            points = origins[:, None] + ts[..., None] * directions[:, None]
            f = model(points.reshape(-1, 3), z_sdf)[0].view(ts.shape)
        self.t = torch.where(self.hit, ts.gather(1, f.argmin(1, keepdim=True))[:, 0], self.t)

    def draw(self, count, generator, where):
        weight = self.weight * where
        if not bool((weight > 0).any()):
            return torch.zeros(0, dtype=torch.int64, device=weight.device)
        return torch.multinomial(weight, min(count, int((weight > 0).sum())), generator=generator)


def fit_geometry(
    portrait: Portrait,
    prior: Prior,
    config: GeometryFitConfig = GeometryFitConfig(),
    *,
    device: str | torch.device = "cpu",
    report: Callable[[int, int], None] = lambda step, steps: None,
) -> GeometryFit:
    """Fit SA-SM to one portrait.

    Parameters
    ----------
    prior : on `device`
    report : called with (steps done, steps in all)
    """
    started = time.monotonic()
    c = config
    generator = torch.Generator(device).manual_seed(c.seed)
    model = copy.deepcopy(prior.shape)
    freeze(model)
    pool = mask_rays(portrait, device=device)
    require_pixels(int(pool.usable.sum()), len(pool))
    if len(pool) > MOST_PIXELS:
        pool = pool.select(torch.randperm(len(pool), generator=generator, device=device)[:MOST_PIXELS])
    chosen = torch.multinomial(face_weight(pool), min(c.pool, len(pool)), generator=generator)
    inside = _KeptRays(pool.select(chosen), torch.ones(len(chosen), device=device))
    band = pixel_rays(portrait, *silhouette_band(portrait), device=device)
    chosen = torch.randperm(len(band), generator=generator, device=device)[: c.band_pool]
    edge = _KeptRays(band.select(chosen), torch.ones(len(chosen), device=device))

    coefficients = nn.Parameter(torch.zeros(prior.z_sdf.basis.shape[1], device=device))
    appearance = nn.Parameter(torch.zeros(prior.z_r.basis.shape[1], device=device))
    pose = PoseCorrection(nn.Parameter(torch.zeros(3, device=device)), nn.Parameter(torch.zeros(3, device=device)))
    codes = lambda: (prior.z_sdf.code(coefficients), prior.z_r.code(appearance))  # noqa: E731
    fit = _Fit(c, model, codes, coefficients, appearance, pose, inside, edge, generator)
    fit.refine_pose = portrait.pose_is_estimated
    total = c.steps_appearance + c.steps_codes + c.steps_networks
    history: list[tuple[int, dict[str, float]]] = []

    def run(steps, optimiser, start, **options):
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1), eta_min=0.0)
        for step in range(steps):
            if step % c.retrace == 0 and (step == 0 or options["geometry"]):
                with torch.no_grad():
                    z_sdf = codes()[0]
                inside.retrace(model, z_sdf, pose)
                edge.retrace(model, z_sdf, pose)
                edge.deepest(model, z_sdf, pose)
            losses = fit.losses(**options)
            loss = sum(losses.values())
            optimiser.zero_grad(set_to_none=True)
            if bool(torch.isfinite(loss)):
                loss.backward()
                optimiser.step()
                schedule.step()
            if (start + step) % 10 == 0:
                history.append((start + step, {name: float(value.detach()) for name, value in losses.items()}))
            report(start + step + 1, total)

    def shape_groups(rate):
        # New dicts for every optimiser: it keeps, and its schedule lowers, the rates in those it is given.
        found = [{"params": [coefficients], "lr": rate}]
        if portrait.pose_is_estimated:
            found.append({"params": [pose.rotation, pose.translation], "lr": c.rate_pose})
        return found

    run(c.steps_appearance, torch.optim.Adam([appearance], lr=c.rate_appearance_codes), 0, geometry=False)
    start = c.steps_appearance
    groups = [*shape_groups(c.rate_codes), {"params": [appearance], "lr": 0.5 * c.rate_appearance_codes}]
    run(c.steps_codes, torch.optim.Adam(groups), start, geometry=True)
    start += c.steps_codes
    if c.steps_networks:
        fit.open_networks()
        groups = [
            *shape_groups(0.1 * c.rate_codes),
            {"params": [appearance], "lr": 0.1 * c.rate_appearance_codes},
            {"params": fit.network_parameters(), "lr": c.rate_networks},
        ]
        run(c.steps_networks, torch.optim.Adam(groups), start, geometry=True)
    freeze(model)
    correction = pose.matrix()
    with torch.no_grad():
        z_sdf, z_r = codes()
    return GeometryFit(
        model,
        z_sdf.detach(),
        z_r.detach(),
        correction @ portrait.canonical_from_world,
        tuple(history),
        float(np.degrees(np.linalg.norm(pose.rotation.detach().cpu().numpy()))),
        float(np.linalg.norm(pose.translation.detach().cpu().numpy()) * UNIT_M),
        time.monotonic() - started,
    )


class _Fit:
    """The parts that every step of the fit reads."""

    def __init__(self, config, model, codes, coefficients, appearance, pose, inside, edge, generator):
        self.config, self.model, self.codes, self.pose = config, model, codes, pose
        self.coefficients, self.appearance = coefficients, appearance
        self.inside, self.edge, self.generator = inside, edge, generator
        self.before = None
        self.refine_pose = False

    def network_parameters(self):
        return [*self.model.deformation.parameters(), *self.model.renderer.parameters()]

    def open_networks(self):
        with torch.no_grad():
            self.before = (copy.deepcopy(self.model), self.codes()[0].clone())
        for parameter in self.network_parameters():
            parameter.requires_grad_(True)

    def losses(self, *, geometry: bool) -> dict[str, Tensor]:
        """Weighted loss terms of one step; without `geometry` only the appearance code learns."""
        c = self.config
        z_sdf, z_r = self.codes()
        chosen = self.inside.draw(c.rays, self.generator, (self.inside.hit & self.inside.rays.usable).float())
        rays = self.inside.rays.select(chosen)
        origins, directions = corrected(self.pose, rays.origins, rays.directions)
        x0 = origins + self.inside.t[chosen, None] * directions
        if not geometry:
            with torch.no_grad():
                z_sdf = z_sdf.detach()
            _, gradient, x_ref, gamma = sdf_and_gradient(self.model, x0.detach(), z_sdf, differentiable=False)
            normals, x_ref, gamma = nn.functional.normalize(gradient.detach(), dim=-1), x_ref.detach(), gamma.detach()
            colour = self.model.render(x_ref, normals, -directions.detach(), gamma, z_r)
            return {
                "colour": c.colour * (colour - rays.rgb).abs().mean(),
                "appearance_prior": c.appearance_prior * self.appearance.square().sum(),
            }
        f, gradient, _, _ = sdf_and_gradient(self.model, x0, z_sdf, differentiable=True)
        length = gradient.norm(dim=-1)
        normals = gradient / length.clamp_min(1e-6)[:, None]
        x = differentiable_hit(x0, directions, f, gradient)
        on = (f.detach().abs() < c.lost).float()
        with torch.no_grad():
            self.inside.t[chosen] += ((x - x0) * directions).sum(-1).clamp(-c.lost, c.lost)
        delta, gamma = self.model.deform(x, z_sdf)
        colour = self.model.render(x + delta, normals, -directions, gamma, z_r)
        losses = {
            "colour": c.colour * ((colour - rays.rgb).abs().mean(-1) * on).sum() / on.sum().clamp_min(1.0),
            "silhouette": c.silhouette * self.silhouette(z_sdf),
            "prior": c.prior * self.coefficients.square().sum(),
            "appearance_prior": c.appearance_prior * self.appearance.square().sum(),
        }
        if self.refine_pose:
            sigma = self.appearance.new_tensor(POSE_SIGMA)
            scaled = torch.cat([self.pose.rotation, self.pose.translation]) / sigma
            losses["pose"] = c.pose * scaled.square().sum()
        if self.before is not None:
            losses["eikonal"] = c.eikonal * ((length - 1.0) ** 2).mean()
            far, uneven = self.anchor(x.detach(), z_sdf)
            losses["anchor"], losses["slope"] = c.anchor * far, c.slope * uneven
        return losses

    def silhouette(self, z_sdf):
        """Cross-entropy of the soft silhouette, over band rays that miss where they should hit or the reverse."""
        c = self.config
        # Rays that hit and should are content, as in IDR; those that miss and should only guard the outside.
        hit, inside = self.edge.hit, self.edge.rays.in_mask
        chance = torch.where(hit & inside, 0.0, torch.where(hit == inside, 0.2, 1.0))
        chosen = self.edge.draw(c.band_rays, self.generator, chance)
        rays = self.edge.rays.select(chosen)
        origins, directions = corrected(self.pose, rays.origins, rays.directions)
        x = origins + self.edge.t[chosen, None] * directions
        f, _, _ = self.model(x, z_sdf)
        target = rays.in_mask.float()
        logits = -c.alpha * f
        off = nn.functional.binary_cross_entropy_with_logits(logits, target, reduction="none") / c.alpha
        # Saturating: hair and clothes that no code can reach must not bend the face. The networks can reach further.
        reach = c.reach if self.before is None else c.reach_networks
        robust = reach * off / (reach + off)
        weight = torch.where(rays.in_mask & (self.before is not None), c.cover, 1.0)
        return 10.0 * chance.mean() * (weight * robust).sum() / max(len(chosen), 1)

    def anchor(self, x, z_sdf):
        """How far, squared, and how unevenly the deformation changed since phase A, on the seen surface and around it.

        The second term is the squared slope of the change: it lets features move and keeps spikes (an ear drawn out
        into hair) from growing.
        """
        low, high = (x.new_tensor(b / UNIT_M) for b in BOUNDS_M)
        random = torch.rand(256, 3, generator=self.generator, device=x.device)
        edge = self.edge.draw(256, self.generator, torch.ones_like(self.edge.t))
        band = self.edge.rays.origins[edge] + self.edge.t[edge, None] * self.edge.rays.directions[edge]
        points = torch.cat([x[:384], band, low + (high - low) * random])
        away = SLOPE_REACH * torch.randn(points.shape, generator=self.generator, device=x.device)
        both = torch.cat([points, points + away])
        model, z_before = self.before
        with torch.no_grad():
            before, _ = model.deform(both, z_before)
        now, _ = self.model.deform(both, z_sdf)
        here, there = (now - before).chunk(2)
        slope = (there - here).square().sum(-1) / away.square().sum(-1)
        # Below the chin are collars and scarves, which stand off the neck that the prior knows.
        held = torch.where(points[:, 1] * UNIT_M < CUT_Y_M, 0.1, 1.0)
        return (held * here.square().sum(-1)).mean(), (held * slope).mean()
