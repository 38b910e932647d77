"""The light that goes with the albedo: as much brighter as that has become darker."""

from dataclasses import replace

import pytest
import torch
from ball_prior import ball_prior
from half_ball import half_ball

from sira_assets.fit.appearance_losses import AppearanceFitConfig, AppearanceLosses
from sira_assets.render.shading import shade


def losses_of(config=AppearanceFitConfig(shadows=False)) -> AppearanceLosses:
    """Those of a grey ball."""
    surface = half_ball()
    surface = replace(surface, rays=replace(surface.rays, rgb=torch.full_like(surface.x, 0.6)))
    return AppearanceLosses(config, ball_prior(), surface, (surface.x_ref, surface.gamma), None)


def move(fit: AppearanceLosses, far: float) -> None:
    torch.manual_seed(3)
    with torch.no_grad():
        fit.z_a.add_(far * torch.randn_like(fit.z_a))


def level_of_picture(fit: AppearanceLosses) -> torch.Tensor:
    """(3,) mean log of what the face reflects diffusely."""
    p = fit.level_points
    with torch.no_grad():
        albedo = fit.model.diffuse(p.x_ref, p.gamma, fit.prior.z_a.code(fit.z_a))
        return shade(p.normals, p.view, albedo, None, *fit.light.lobes()).radiance.log().mean(0)


@pytest.mark.parametrize("far", [-3.0, 0.0, 2.0])
def test_the_picture_is_as_bright_whatever_the_albedo(far):
    fit = losses_of()
    before = level_of_picture(fit)
    move(fit, far)
    fit.settle_light()
    # float32 of some hundred logarithms.
    torch.testing.assert_close(level_of_picture(fit), before, rtol=0.0, atol=2e-5)
    again = fit.light.log_amplitude.detach().clone()
    fit.settle_light()
    torch.testing.assert_close(fit.light.log_amplitude.detach(), again, rtol=0.0, atol=1e-6)


def test_the_gradient_is_that_of_a_light_that_follows():
    fit = losses_of()
    move(fit, 0.5)
    fit.settle_light()
    here = fit.z_a.detach().clone()

    def loss(at: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            fit.z_a.copy_(at)
        terms = fit.losses(torch.Generator().manual_seed(0), k_s=0.0, refine=False)
        return 1e3 * (terms["colour"] + terms["tint"] / fit.config.tint)

    loss(here).backward()
    way, slope = torch.nn.functional.normalize(fit.z_a.grad, dim=0), float(fit.z_a.grad.norm())
    h = 0.05
    with torch.no_grad():
        numeric = float((loss(here + h * way) - loss(here - h * way)) / (2 * h))
    # The mean of absolute errors has kinks, and differences of float32 carry some 1e-2.
    assert slope == pytest.approx(numeric, rel=0.03)
    assert slope > 1.0


def test_what_it_was_without_highlights_comes_back_whole():
    fit = losses_of()
    move(fit, 0.5)
    fit.settle_light()
    fit.remember_plain()
    before = level_of_picture(fit)
    move(fit, 2.0)
    fit.settle_light()
    fit.plain_error.fill_(1e-9)  # as if highlights had made it worse
    fit.decide_highlights()
    fit.settle_light()
    torch.testing.assert_close(level_of_picture(fit), before, rtol=0.0, atol=2e-5)


def test_all_at_once_the_light_goes_its_own_way():
    fit = losses_of(AppearanceFitConfig(shadows=False, scheduled=False))
    before = fit.light.log_amplitude.detach().clone()
    move(fit, 2.0)
    fit.settle_light()
    fit.losses(torch.Generator().manual_seed(0), k_s=1.0, refine=False)
    assert torch.equal(fit.light.log_amplitude.detach(), before)


def test_with_no_face_in_sight_the_light_follows_what_there_is():
    surface = half_ball()
    away = replace(surface, x=surface.x + torch.tensor([3.0, 0.0, 0.0]))
    fit = AppearanceLosses(AppearanceFitConfig(shadows=False), ball_prior(), away, (surface.x_ref, surface.gamma), None)
    assert len(fit.level_points) >= 200
    assert torch.isfinite(fit.level).all()
