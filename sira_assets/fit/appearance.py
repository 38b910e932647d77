"""Single-view appearance on the fixed surface (SIRA section 3.3, second step).

Notation: as in fit/appearance_losses.py. The schedule: light on a fixed albedo (k_s = k_r = 0); then z_a; then k_s
ramps to 1 with z_s; then the base albedo is frozen and the refinement opened, held back in shadow and highlights. The
fitted surface casts shadows on itself in all stages.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sira_assets.fields.fitted import FittedHead
from sira_assets.fields.prior import Prior, freeze
from sira_assets.fit.appearance_losses import AppearanceFitConfig, AppearanceLosses
from sira_assets.fit.decision import FitDecision
from sira_assets.fit.geometry import GeometryFit
from sira_assets.fit.loop import Checkpoint, Stage, run_stages
from sira_assets.fit.pace import Pace
from sira_assets.fit.pixels import require_pixels
from sira_assets.fit.required import Evidence, needed_highlights, needed_lobes, needed_shadows
from sira_assets.fit.seen_surface import SurfacePoints, cut_region, hidden_surface, visible_surface
from sira_assets.fit.shadows import FitShadows
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.sg_light import SGLight

# Processor time of a step of each stage beside a step of the light.
WORK = {"light": 1.0, "albedo": 0.85, "specular": 1.05, "refinement": 1.25, "all at once": 1.0}


@dataclass(frozen=True)
class AppearanceFit:
    """What the appearance fit adds: the whole head, and the light in the scene's world.

    Parameters
    ----------
    roughness : of the whole surface, GGX alpha is its square
    shadowed : whether the found light is to be seen with the head's own cast shadows
    warnings : what the fit had to mend, one line each
    """

    head: FittedHead
    light: SGLight
    roughness: float
    shadowed: bool
    history: tuple[tuple[int, dict[str, float]], ...]
    decisions: tuple[FitDecision, ...]
    warnings: tuple[str, ...]
    seconds: float


def unlit_head(geometry: GeometryFit, prior: Prior) -> FittedHead:
    """The fitted shape with the mean person's material: what is known before the appearance fit."""
    return FittedHead(geometry.shape, prior.appearance, geometry.z_sdf, prior.z_a.mean, prior.z_s.mean)


def fit_appearance(
    portrait: Portrait,
    geometry: GeometryFit,
    prior: Prior,
    surface_canonical: TriangleMesh,
    config: AppearanceFitConfig = AppearanceFitConfig(),
    *,
    checkpoint: Checkpoint | None = None,
    pace: Pace | None = None,
    report: Callable[[int, int], None] = lambda step, steps: None,
) -> AppearanceFit:
    """Find albedo, specular albedo and light of one portrait on its fitted surface.

    Parameters
    ----------
    surface_canonical : the fitted surface as triangles, canonical metres; rays meet it, and it casts the shadows
    checkpoint : where the state is kept while the fit runs; one of this very fit is gone on from
    pace : when to be over, in place of the steps planned; not together with a checkpoint
    report : called with (steps done, steps in all)
    """
    c = config
    device = geometry.z_sdf.device
    generator = torch.Generator(device).manual_seed(c.seed + 1)
    caster = Raycaster(surface_canonical)
    cut = cut_region(portrait, geometry, caster)
    surface = _seen_surface(portrait, geometry, caster, cut, c, generator)
    hidden = hidden_surface(portrait, geometry, surface_canonical, surface, cut, generator)
    shadows = FitShadows(caster, c.rays, device=device) if c.shadows else None
    fit = AppearanceLosses(c, prior, surface, hidden, shadows)
    record = run_stages(
        _stages(fit, c), fit.state(), seed=c.seed, device=device, checkpoint=checkpoint, pace=pace, report=report
    )
    fit.settle_light()
    freeze(fit.refinement)
    if not c.scheduled:
        freeze(fit.model)
    with torch.no_grad():
        head = FittedHead(
            geometry.shape,
            fit.model,
            geometry.z_sdf,
            prior.z_a.code(fit.z_a).detach(),
            prior.z_s.code(fit.z_s).detach(),
            fit.refinement if c.steps_refinement and c.scheduled else None,
            float(fit.highlights) if c.steps_specular else 0.0,
        )
        evidence = Evidence.of(fit.points, fit.light.lobes(), fit.shares())
        shadowed, decisions = evidence.visibility is not None, ()
        if not c.everything:
            evidence, shadowed, of_shadows = needed_shadows(evidence)
            evidence, of_lobes = needed_lobes(evidence, sought=len(fit.light.kept), merging=float(fit.merging))
            errors = {"plain": float(fit.plain_error), "shiny": float(fit.shiny_error)}
            of_highlights = needed_highlights(head.specular_scale, **errors)
            decisions = (of_lobes, of_highlights, *of_shadows)
        lobes = evidence.lobes
        axis, sharpness, amplitude = (t.double().cpu().numpy() for t in lobes)
    world_from_canonical = np.linalg.inv(geometry.canonical_from_world)[:3, :3]
    world_from_canonical = world_from_canonical / np.cbrt(np.linalg.det(world_from_canonical))
    return AppearanceFit(
        head,
        SGLight(axis @ world_from_canonical.T, sharpness, amplitude),
        float(fit.roughness),
        shadowed,
        record.history,
        decisions,
        record.warnings,
        record.seconds,
    )


def _seen_surface(
    portrait: Portrait,
    geometry: GeometryFit,
    caster: Raycaster,
    cut: np.ndarray,
    c: AppearanceFitConfig,
    generator: torch.Generator,
) -> SurfacePoints:
    """The seen surface, at most `max_surface` points of it, without pixels along a cut unless there is little else."""
    surface = visible_surface(portrait, geometry, caster, at_most=2 * c.max_surface, generator=generator)
    require_pixels(int(surface.rays.usable.sum()), int(portrait.mask.sum()))
    along = torch.as_tensor(cut, device=surface.x.device)[surface.rays.row, surface.rays.column]
    if 2 * int(along.sum()) < len(surface):
        surface = surface.rows(torch.nonzero(~along)[:, 0])
    if len(surface) > c.max_surface:
        chosen = torch.randperm(len(surface), generator=generator, device=surface.x.device)[: c.max_surface]
        surface = surface.rows(chosen.sort().values)
    return surface


def _stages(fit: AppearanceLosses, c: AppearanceFitConfig) -> list[Stage]:
    light = fit.light.parameters()

    def stage(name: str, steps: int, groups, k_s=lambda step: 0.0, *, refine=False, aimed_at=None) -> Stage:
        def losses(step: int, generator: torch.Generator) -> dict[str, Tensor]:
            drift = refine and step >= c.drift_from * steps
            return fit.losses(generator, k_s=k_s(step), refine=refine, drift=drift)

        def look(step: int, generator: torch.Generator) -> None:
            if refine and step % c.rays.refresh == 0:
                fit.look()
            # Before the refinement can take highlights into the albedo.
            if not refine and k_s(step) > 0.5 and step % c.roughness_every == 0:
                fit.settle_roughness(k_s=k_s(step))

        if aimed_at is None:
            return Stage(name, steps, groups, losses, enter=fit.enter_early, before_step=look, work=WORK[name])

        def begin() -> None:
            fit.settle_light()
            if refine and c.steps_specular:
                fit.decide_highlights()
            fit.aim()

        def enter() -> None:
            fit.enter_aimed(aimed_at)
            if not refine:
                fit.remember_plain()

        return Stage(name, steps, groups, losses, begin, enter, look, WORK[name])

    slow = 0.3 * c.rate_light
    codes = [fit.z_a, fit.z_s]
    # The highlights stay as they were found: what the refinement cannot explain is no reason for other skin.
    refined = [(light, slow), (list(fit.refinement.parameters()), c.rate_refinement)]
    if not c.scheduled:
        steps = c.steps_light + c.steps_albedo + c.steps_specular + c.steps_refinement
        decoders = [*fit.model.albedo.parameters(), *fit.model.specular.parameters()]
        groups = [(light, c.rate_light), (codes, c.rate_codes), (decoders, c.rate_decoders)]
        return [stage("all at once", steps, groups, lambda step: 1.0)]
    ramp = lambda step: (step + 1) / c.steps_specular  # noqa: E731
    k_s = lambda step: float(fit.highlights) if c.steps_specular else 0.0  # noqa: E731
    return [
        stage("light", c.steps_light, [(light, c.rate_light)]),
        stage("albedo", c.steps_albedo, [(light, c.rate_light), ([fit.z_a], c.rate_codes)]),
        stage("specular", c.steps_specular, [(light, slow), (codes, c.rate_codes)], ramp, aimed_at=fit.early),
        stage("refinement", c.steps_refinement, refined, k_s, refine=True, aimed_at=fit.surface),
    ]
