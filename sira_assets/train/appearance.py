"""Auto-decoder training of AF-SM on frozen SA-SM (SIRA section 3.2).

Notation: as in fields/af_sm.py. Self-supervised by re-rendering the views: L_col + l6 L_emb + l7 |a(x) - a(x + eps)|,
with k_s = 1. `supervision` > 0 adds the generator's exact albedo, which the photos alone leave open up to the light's
colour and strength.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from sira_assets.fields.af_sm import AppearanceConfig, AppearanceFactorModel
from sira_assets.fields.sa_sm import ShapeAppearanceModel, sdf_and_gradient
from sira_assets.numerics.srgb import srgb_encode
from sira_assets.render.shading import shade
from sira_assets.train.batches import SampleTensors, draw, step_generator
from sira_assets.train.checkpoint import load_checkpoint, save_checkpoint
from sira_assets.train.shape import ShapeCodes, learning_rate


@dataclass(frozen=True)
class AppearanceTrainConfig:
    """Weights and schedule; `smooth_m` is eps, the reach of the albedo's smoothness, in network units."""

    steps: int = 3000
    scenes_per_step: int = 8
    pixels: int = 384
    rate: float = 1.0e-3
    code_rate: float = 3.0e-3
    embedding: float = 1.0e-4
    smooth: float = 0.02
    smooth_reach: float = 0.02
    supervision: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class AppearanceCodes:
    """One row a scene."""

    z_a: nn.Parameter
    z_s: nn.Parameter
    z_l: nn.Parameter


def new_appearance_codes(count: int, config: AppearanceConfig, seed: int, device="cpu") -> AppearanceCodes:
    """Codes near zero."""
    generator = torch.Generator().manual_seed(seed)
    sizes = (config.albedo_code_size, config.specular_code_size, config.light_code_size)
    return AppearanceCodes(
        *(nn.Parameter((0.05 * torch.randn(count, s, generator=generator)).to(device)) for s in sizes)
    )


def appearance_losses(
    model: AppearanceFactorModel,
    codes: AppearanceCodes,
    shape: ShapeAppearanceModel,
    shape_codes: ShapeCodes,
    data: SampleTensors,
    config: AppearanceTrainConfig,
    step: int,
) -> dict[str, Tensor]:
    """All loss terms of one step, unweighted. Lights are per scene, so each scene is shaded on its own."""
    c = config
    generator = step_generator(c.seed + 1, step, data.pixels.device)
    count = min(c.scenes_per_step, len(data))
    scenes = torch.randperm(len(data), generator=generator, device=generator.device)[:count]
    x, view, rgb, diffuse, specular = draw(
        (data.pixels, data.pixel_view, data.pixel_rgb, data.pixel_diffuse, data.pixel_specular),
        scenes,
        c.pixels,
        generator,
    )
    z_sdf = shape_codes.z_sdf.detach()[scenes].repeat_interleave(c.pixels, 0)
    _, gradient, x_ref, gamma = sdf_and_gradient(shape, x, z_sdf, differentiable=False)
    normals = nn.functional.normalize(gradient.detach(), dim=-1)
    x_ref, gamma = x_ref.detach(), gamma.detach()
    z_a, z_s = (table[scenes].repeat_interleave(c.pixels, 0) for table in (codes.z_a, codes.z_s))
    albedo, f0 = model.diffuse(x_ref, gamma, z_a), model.specular_f0(x_ref, z_s)
    axis, sharpness, amplitude = model.lobes(codes.z_l[scenes])
    radiance = []
    for i in range(count):
        rows = slice(i * c.pixels, (i + 1) * c.pixels)
        shading = shade(normals[rows], view[rows], albedo[rows], f0[rows], axis[i], sharpness[i], amplitude[i])
        radiance.append(shading.diffuse_radiance + shading.specular_radiance)
    offset = c.smooth_reach * torch.randn(x_ref.shape, generator=generator, device=x_ref.device)
    losses = {
        "colour": (srgb_encode(torch.cat(radiance)) - srgb_encode(rgb)).abs().mean(),
        "embedding": sum(table[scenes].square().sum(-1).mean() for table in (codes.z_a, codes.z_s, codes.z_l)),
        "smooth": (albedo - model.diffuse(x_ref + offset, gamma, z_a)).abs().mean(),
    }
    if c.supervision > 0:
        known = torch.isfinite(specular)
        if not known.any():
            return losses
        losses["supervision"] = (srgb_encode(albedo[known]) - srgb_encode(diffuse[known])).abs().mean() + (
            f0[known] - specular[known]
        ).abs().mean() / 0.04
    return losses


def train_appearance(
    data: SampleTensors,
    shape: ShapeAppearanceModel,
    shape_codes: ShapeCodes,
    folder: Path,
    *,
    model_config: AppearanceConfig = AppearanceConfig(),
    config: AppearanceTrainConfig = AppearanceTrainConfig(),
    device: str | torch.device = "cpu",
    resume: bool = False,
    save_every: int = 500,
    report: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> tuple[AppearanceFactorModel, AppearanceCodes]:
    """Train AF-SM on a frozen SA-SM, keeping `folder/appearance.safetensors`; with `resume` go on from it exactly."""
    torch.manual_seed(config.seed + 1)
    model = AppearanceFactorModel(model_config, feature_size=shape.config.feature_size).to(device)
    codes = new_appearance_codes(len(data), model_config, config.seed, device)
    tables = [codes.z_a, codes.z_s, codes.z_l]
    shape.requires_grad_(False)
    optimiser = torch.optim.Adam(
        [{"params": list(model.parameters()), "lr": config.rate}, {"params": tables, "lr": config.code_rate}]
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda s: learning_rate(s, config.steps))
    tensors = {
        "model": model.state_dict(),
        "codes": dict(zip(("z_a", "z_s", "z_l"), (t.data for t in tables), strict=True)),
    }
    path = Path(folder) / "appearance.safetensors"
    start = load_checkpoint(path, tensors, optimiser, schedule) if resume and path.exists() else 0
    for step in range(start, config.steps):
        losses = appearance_losses(model, codes, shape, shape_codes, data, config, step)
        total = losses["colour"] + config.embedding * losses["embedding"] + config.smooth * losses["smooth"]
        if "supervision" in losses:
            total = total + config.supervision * losses["supervision"]
        optimiser.zero_grad(set_to_none=True)
        total.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        if (step + 1) % 50 == 0 or step + 1 == config.steps:
            report(step + 1, {name: float(value.detach()) for name, value in losses.items()})
        if (step + 1) % save_every == 0 or step + 1 == config.steps:
            save_checkpoint(path, tensors, optimiser, schedule, step + 1)
    return model, codes
