"""Single-view appearance on the fixed surface (SIRA section 3.3, second step).

Notation: as in fields/af_sm.py; r_pb = r_d + k_s r_s; a = a_base + k_r a_refine; I the photo, c the model's colour. The
schedule: light on a fixed albedo (k_s = k_r = 0); then z_a; then k_s ramps to 1 with z_s; then the base albedo is
frozen and the refinement opened, held back by
L_reg = mean |a_refine| w with w = l8 max(0, |a_base|_1 - |r_d,base|_1) + l9 |r_s|_1,
which is large in shadow and in highlights, so that neither is baked into the albedo.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from sira_assets.fields.fitted import AlbedoRefinement, FittedHead, RefinementConfig
from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior, freeze
from sira_assets.fields.sa_sm import sdf_and_gradient
from sira_assets.fit.decision import FitDecision
from sira_assets.fit.geometry import GeometryFit
from sira_assets.fit.light import FreeLight
from sira_assets.fit.pixels import PixelRays, mask_rays, require_pixels
from sira_assets.numerics.sg import irradiance
from sira_assets.numerics.srgb import srgb_decode, srgb_encode
from sira_assets.render.shading import ROUGHNESS, Shading, shade
from sira_assets.render.tracing import sphere_trace
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.sg_light import SGLight


@dataclass(frozen=True)
class AppearanceFitConfig:
    """Steps of each stage, pixels a step, rates and weights (l8, l9 in the paper)."""

    steps_light: int = 150
    steps_albedo: int = 200
    steps_specular: int = 150
    steps_refinement: int = 800
    pixels: int = 3000
    max_surface: int = 60000
    rate_codes: float = 0.05
    rate_light: float = 0.03
    rate_refinement: float = 1.5e-3
    albedo_prior: float = 3.0e-5
    light_prior: float = 3.0e-5
    shadow: float = 1.0
    highlight: float = 2.0
    regularity: float = 0.05
    unseen: float = 0.5
    refinement: RefinementConfig = RefinementConfig()
    seed: int = 0


@dataclass(frozen=True)
class SurfacePoints:
    """What the camera sees of the fitted surface, one row a pixel, in network units and the canonical frame."""

    x: Tensor
    normals: Tensor
    view: Tensor
    x_ref: Tensor
    gamma: Tensor
    rays: PixelRays

    def rows(self, index: Tensor) -> "SurfacePoints":
        """Some of the points."""
        tensors = (self.x, self.normals, self.view, self.x_ref, self.gamma)
        return SurfacePoints(*(t[index] for t in tensors), self.rays.select(index))


@dataclass(frozen=True)
class AppearanceFit:
    """What the appearance fit adds: the whole head, and the light in the scene's world."""

    head: FittedHead
    light: SGLight
    history: tuple[tuple[int, dict[str, float]], ...]
    decisions: tuple[FitDecision, ...]
    seconds: float


def visible_surface(
    portrait: Portrait,
    geometry: GeometryFit,
    *,
    at_most: int | None = None,
    generator: torch.Generator | None = None,
    chunk: int = 16384,
) -> SurfacePoints:
    """Trace the mask's pixels (a random `at_most` of them) against the fitted surface; those that miss are left out."""
    posed = replace(portrait, canonical_from_world=geometry.canonical_from_world)
    rays = mask_rays(posed, device=geometry.z_sdf.device)
    if at_most is not None and len(rays) > at_most:
        rays = rays.select(torch.randperm(len(rays), generator=generator, device=rays.origins.device)[:at_most])
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


def fit_appearance(
    portrait: Portrait,
    geometry: GeometryFit,
    prior: Prior,
    config: AppearanceFitConfig = AppearanceFitConfig(),
    *,
    report: Callable[[int, int], None] = lambda step, steps: None,
) -> AppearanceFit:
    """Find albedo, specular albedo and light of one portrait on its fitted surface."""
    started = time.monotonic()
    c = config
    device = geometry.z_sdf.device
    generator = torch.Generator(device).manual_seed(c.seed + 1)
    surface = visible_surface(portrait, geometry, at_most=2 * c.max_surface, generator=generator)
    surface = surface.rows(torch.nonzero(surface.rays.usable)[:, 0])
    require_pixels(len(surface.x), int(portrait.mask.sum()))
    if len(surface.x) > c.max_surface:
        surface = surface.rows(torch.randperm(len(surface.x), generator=generator, device=device)[: c.max_surface])
    light = FreeLight(prior)
    model = prior.appearance
    z_a = nn.Parameter(torch.zeros(prior.z_a.basis.shape[1], device=device))
    z_s = nn.Parameter(torch.zeros(prior.z_s.basis.shape[1], device=device))
    refinement = AlbedoRefinement(c.refinement, feature_size=geometry.shape.config.feature_size).to(device)
    _match_exposure(light, surface, model, prior)
    hidden = _hidden_surface(geometry, surface, generator)
    stages = (
        ("light", c.steps_light, light.parameters(), [], []),
        ("albedo", c.steps_albedo, light.parameters(), [z_a], []),
        ("specular", c.steps_specular, light.parameters(), [z_a, z_s], []),
        ("refinement", c.steps_refinement, light.parameters(), [z_s], list(refinement.parameters())),
    )
    total = sum(stage[1] for stage in stages)
    done, history = 0, []
    k_s = 0.0
    for name, steps, lights, codes, networks in stages:
        if steps == 0:
            continue
        slow = 0.3 if name in ("specular", "refinement") else 1.0
        groups = [{"params": lights, "lr": c.rate_light * slow}]
        if codes:
            groups.append({"params": codes, "lr": c.rate_codes})
        if networks:
            groups.append({"params": networks, "lr": c.rate_refinement})
        optimiser = torch.optim.Adam(groups)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps, eta_min=0.0)
        for step in range(steps):
            if name == "specular":
                k_s = (step + 1) / steps
            rows = torch.randint(len(surface.x), (min(c.pixels, len(surface.x)),), generator=generator, device=device)
            points = surface.rows(rows)
            base = model.diffuse(points.x_ref, points.gamma, prior.z_a.code(z_a))
            f0 = model.specular_f0(points.x_ref, prior.z_s.code(z_s))
            albedo = base
            if name == "refinement":
                base = base.detach()
                extra = refinement(points.x_ref, points.gamma)
                albedo = (base + extra).clamp(1e-4, 1.0)
            shading = shade(points.normals, points.view, albedo, k_s * f0, *light.lobes())
            error = (srgb_encode(shading.radiance) - points.rays.rgb).abs()
            losses = {
                "colour": error.mean(),
                "albedo_prior": c.albedo_prior * (z_a.square().sum() + z_s.square().sum()),
                "light_prior": c.light_prior * light.energy(),
            }
            if name == "refinement":
                diffuse_base = base * shading.irradiance.detach() / math.pi
                weight = c.shadow * (base.sum(-1) - diffuse_base.sum(-1)).clamp_min(0.0)
                weight = weight + c.highlight * shading.specular_radiance.detach().sum(-1)
                losses["regularity"] = c.regularity * (extra.abs().sum(-1) * weight).mean()
                pick = torch.randint(len(hidden[0]), (512,), generator=generator, device=device)
                losses["unseen"] = c.unseen * refinement(hidden[0][pick], hidden[1][pick]).abs().mean()
            loss = sum(losses.values())
            optimiser.zero_grad(set_to_none=True)
            if bool(torch.isfinite(loss)):
                loss.backward()
                optimiser.step()
                schedule.step()
            if done % 10 == 0:
                history.append((done, {key: float(value.detach()) for key, value in losses.items()}))
            done += 1
            report(done, total)
    freeze(refinement)
    with torch.no_grad():
        head = FittedHead(
            geometry.shape,
            model,
            geometry.z_sdf,
            prior.z_a.code(z_a).detach(),
            prior.z_s.code(z_s).detach(),
            refinement if c.steps_refinement else None,
            k_s,
        )
        lobes, lobe_decision = _needed_lobes(*light.lobes(), surface)
        head, specular_decision = _needed_specular(head, surface, lobes)
        axis, sharpness, amplitude = (t.double().cpu().numpy() for t in lobes)
    world_from_canonical = np.linalg.inv(geometry.canonical_from_world)[:3, :3]
    world_from_canonical = world_from_canonical / np.cbrt(np.linalg.det(world_from_canonical))
    return AppearanceFit(
        head,
        SGLight(axis @ world_from_canonical.T, sharpness, amplitude),
        tuple(history),
        (lobe_decision, specular_decision),
        time.monotonic() - started,
    )


# A lobe that gives the seen surface less than this share of its light is left out: an eighth of one 8-bit step of 255.
LEAST_LOBE_SHARE = 0.0005


def _needed_lobes(axis: Tensor, sharpness: Tensor, amplitude: Tensor, surface: SurfacePoints):
    """The lobes that the seen surface can tell from none, and the decision."""
    every = surface.normals[:: max(1, len(surface.normals) // 4000)]
    light = torch.stack(
        [
            irradiance(every, axis[i : i + 1], sharpness[i : i + 1], amplitude[i : i + 1]).mean()
            for i in range(len(axis))
        ]
    )
    share = light / light.sum().clamp_min(1e-12)
    keep = share >= LEAST_LOBE_SHARE
    chosen = f"{int(keep.sum())} of {len(keep)}"
    lost = float(share[~keep].sum())
    evidence = f"the others give {100 * lost:.2g} % of the light on the seen surface"
    return (axis[keep], sharpness[keep], amplitude[keep]), FitDecision("light lobes", chosen, evidence)


# Highlights that lower the mean error by less than this (sRGB-encoded, 0 to 1; a tenth of an 8-bit step) are left out.
LEAST_SPECULAR_GAIN = 4.0e-4


def _needed_specular(head: FittedHead, surface: SurfacePoints, lobes) -> tuple[FittedHead, FitDecision]:
    """The head with or without highlights, by the mean error with them and with them taken away."""
    every = slice(None, None, max(1, len(surface.x) // 8000))
    albedo, f0 = head.reference_material(surface.x_ref[every], surface.gamma[every])
    shading = shade(surface.normals[every], surface.view[every], albedo, f0, *lobes)
    rgb = surface.rays.rgb[every]
    without = float((srgb_encode(shading.diffuse_radiance) - rgb).abs().mean())
    with_it = float((srgb_encode(shading.radiance) - rgb).abs().mean())
    evidence = f"mean error {with_it:.4f} with highlights, {without:.4f} with them taken away (sRGB-encoded, 0 to 1)"
    if without - with_it < LEAST_SPECULAR_GAIN:
        head = replace(head, specular_scale=0.0)
    return head, FitDecision("specular", f"k_s = {head.specular_scale:.2g}", evidence)


@torch.no_grad()
def _match_exposure(light: FreeLight, surface: SurfacePoints, model, prior) -> None:
    """Scale the starting light so that the mean albedo under it is as bright as the photo, in each channel's mean."""
    albedo = model.diffuse(surface.x_ref, surface.gamma, prior.z_a.mean)
    none = torch.zeros_like(albedo[:, 0])
    shading: Shading = shade(surface.normals, surface.view, albedo, none, *light.lobes(), roughness=ROUGHNESS)
    gain = srgb_decode(surface.rays.rgb).mean() / shading.radiance.mean().clamp_min(1e-6)
    light.scale(float(gain))


@torch.no_grad()
def _hidden_surface(geometry: GeometryFit, surface: SurfacePoints, generator, count: int = 4096):
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
