"""The roughness that the photo's highlights ask for."""

from dataclasses import replace

import pytest
import torch
from ball_prior import ball_prior
from half_ball import half_ball

from sira_assets.fit.appearance_losses import ROUGHNESS_STEP, AppearanceFitConfig, AppearanceLosses
from sira_assets.numerics.srgb import srgb_encode
from sira_assets.render.shading import ROUGHNESS, shade


@pytest.mark.parametrize("truth", [0.34, 0.5, 0.66])
def test_the_roughness_of_a_rendered_ball_is_found(truth):
    prior, surface = ball_prior(), half_ball()
    config = AppearanceFitConfig(shadows=False)
    fit = AppearanceLosses(config, prior, surface, (surface.x_ref, surface.gamma), None)
    with torch.no_grad():
        fit.light.log_sharpness += 2.0
    with torch.no_grad():
        albedo = prior.appearance.diffuse(surface.x_ref, surface.gamma, prior.z_a.mean)
        f0 = prior.appearance.specular_f0(surface.x_ref, albedo, prior.z_s.mean)
        lobes = fit.light.lobes()
        photo = shade(surface.normals, surface.view, albedo, f0, *lobes, roughness=truth).radiance
    rgb = srgb_encode(photo)
    fit.points = replace(surface, rays=replace(surface.rays, rgb=rgb))
    assert float(fit.roughness) == ROUGHNESS
    for _ in range(12):
        fit.settle_roughness(k_s=1.0)
    # Everything else is as it was rendered, so only the step limits it.
    assert abs(float(fit.roughness) - truth) <= ROUGHNESS_STEP / 2
