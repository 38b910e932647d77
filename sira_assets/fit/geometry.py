"""Single-view geometry (SIRA section 3.3, first step): A finds the codes, B frees the networks, C covers the mask.

Before A the shading says which shapes are likely (fit/shading.py), in place of the prior alone.

Notation: as in fields/sa_sm.py and render/tracing.py; c coefficients of the codes' gaussians (sigma units), so |c|^2 is
the prior's energy. The reference signed distance is never changed: it is what all heads share.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior, freeze
from sira_assets.fields.sa_sm import ShapeAppearanceModel
from sira_assets.fit.geometry_losses import GeometryFitConfig, GeometryLosses
from sira_assets.fit.kept_rays import KeptRays
from sira_assets.fit.landmark_rays import landmark_rays
from sira_assets.fit.loop import Checkpoint, Stage, run_stages
from sira_assets.fit.pace import Pace
from sira_assets.fit.pixels import PixelRays, face_weight, mask_rays, pixel_rays, require_pixels, silhouette_band
from sira_assets.fit.shading import shading_evidence
from sira_assets.scene.portrait import Portrait

# torch.multinomial takes at most 2^24 weights; a photo larger than this is drawn from at random first.
MOST_PIXELS = 2_000_000
# Processor time of a step of each stage beside a step of the codes, on two cores with AVX-512.
WORK = {"appearance code": 0.35, "codes": 1.0, "networks": 1.5, "cover": 1.5}


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
    warnings : what the fit had to mend, one line each
    """

    shape: ShapeAppearanceModel
    z_sdf: Float[Tensor, " Z"]
    z_r: Float[Tensor, " Z"]
    canonical_from_world: np.ndarray
    history: tuple[tuple[int, dict[str, float]], ...]
    pose_change_deg: float
    pose_change_m: float
    warnings: tuple[str, ...]
    seconds: float


def fit_geometry(
    portrait: Portrait,
    prior: Prior,
    config: GeometryFitConfig = GeometryFitConfig(),
    *,
    device: str | torch.device = "cpu",
    checkpoint: Checkpoint | None = None,
    pace: Pace | None = None,
    report: Callable[[int, int], None] = lambda step, steps: None,
) -> GeometryFit:
    """Fit SA-SM to one portrait.

    Parameters
    ----------
    prior : on `device`
    checkpoint : where the state is kept while the fit runs; one of this very fit is gone on from
    pace : when to be over, in place of the steps planned; not together with a checkpoint
    report : called with (steps done, steps in all)
    """
    c = config
    inside, edge = _pools(portrait, c, device)
    generator = torch.Generator(device).manual_seed(c.seed)
    evidence = shading_evidence(inside.every, landmark_rays(portrait, prior), prior, c.shading, generator)
    fit = GeometryLosses(c, prior, inside, edge, evidence)

    def stage(name: str, steps: int, groups, *, geometry: bool = True, begin=lambda: None, enter=lambda: None) -> Stage:
        def before_step(step: int, generator: torch.Generator) -> None:
            if step % c.retrace == 0 and (step == 0 or geometry):
                fit.retrace(generator)

        losses = lambda step, g: fit.losses(g, geometry=geometry, share=step / steps)  # noqa: E731
        return Stage(name, steps, groups, losses, begin, enter, before_step, WORK[name])

    def shape_groups(rate: float) -> list[tuple[list[Tensor], float]]:
        pose = [([fit.pose.rotation, fit.pose.translation], c.rate_pose)] if portrait.pose_is_estimated else []
        return [([fit.coefficients], rate), *pose]

    appearance, renderer = [fit.appearance], fit.new_renderer()
    learnt = [(renderer, c.rate_new_renderer)] if renderer else []
    settle_groups = [(appearance, c.rate_appearance_codes), *learnt]
    settle = stage("appearance code", c.steps_appearance, settle_groups, geometry=False, enter=fit.open_new_renderer)
    codes_groups = [*shape_groups(c.rate_codes), (appearance, 0.5 * c.rate_appearance_codes), *learnt]
    codes = stage("codes", c.steps_codes, codes_groups, enter=fit.open_new_renderer)
    networks_groups = [
        *shape_groups(0.1 * c.rate_codes),
        (appearance, 0.1 * c.rate_appearance_codes),
        (fit.network_parameters(), c.rate_networks),
    ]
    networks = stage("networks", c.steps_networks, networks_groups, begin=fit.remember, enter=fit.open_networks)
    cover_groups = [(list(fit.model.deformation.parameters()), c.rate_cover)]
    cover = stage("cover", c.steps_cover, cover_groups, begin=fit.begin_cover, enter=fit.open_cover)
    record = run_stages(
        [settle, codes, networks, cover],
        fit.state(),
        seed=c.seed,
        device=device,
        bfloat16=c.bfloat16,
        checkpoint=checkpoint,
        pace=pace,
        report=report,
    )
    freeze(fit.model)
    with torch.no_grad():
        z_sdf, z_r = fit.codes()
    return GeometryFit(
        fit.model,
        z_sdf.detach(),
        z_r.detach(),
        fit.pose.matrix() @ portrait.canonical_from_world,
        record.history,
        float(np.degrees(np.linalg.norm(fit.pose.rotation.detach().cpu().numpy()))),
        float(np.linalg.norm(fit.pose.translation.detach().cpu().numpy()) * UNIT_M),
        record.warnings,
        record.seconds,
    )


def _pools(portrait: Portrait, c: GeometryFitConfig, device: str | torch.device) -> tuple[KeptRays, KeptRays]:
    """Rays through the mask, more of them on the face, and rays about its edge."""
    pool = mask_rays(portrait, device=device)
    require_pixels(int(pool.usable.sum()), len(pool))
    band = pixel_rays(portrait, *silhouette_band(portrait), device=device)
    generator = torch.Generator(device).manual_seed(c.seed)
    pool, band = (_at_most(rays, generator) for rays in (pool, band))
    even = torch.ones(len(band), device=device)
    return KeptRays(pool, face_weight(pool), c.pool), KeptRays(band, even, c.band_pool)


def _at_most(rays: PixelRays, generator: torch.Generator) -> PixelRays:
    if len(rays) <= MOST_PIXELS:
        return rays
    index = torch.randperm(len(rays), generator=generator, device=rays.origins.device)
    return rays.select(index[:MOST_PIXELS].sort().values)
