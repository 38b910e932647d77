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
from sira_assets.train.batches import Batch, SampleTensors
from sira_assets.train.loop import LoopConfig, Trainee, digest, tensors_digest, train
from sira_assets.train.parallel import Share
from sira_assets.train.shape import ShapeCodes


@dataclass(frozen=True)
class AppearanceTrainConfig:
    """Weights and schedule; `smooth_reach` is eps, the reach of the albedo's smoothness, in network units."""

    steps: int = 3000
    scenes_per_step: int = 16
    pixels: int = 192
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
    share: Share = Share(),
) -> dict[str, Tensor]:
    """All loss terms of one step, unweighted. Lights are per scene, so each scene is shaded on its own."""
    c = config
    batch = Batch.of_step(c.seed + 1, step, c.scenes_per_step, len(data), share, codes.z_a.device)
    x, view, rgb, diffuse, specular = batch.draw(
        (data.pixels, data.pixel_view, data.pixel_rgb, data.pixel_diffuse, data.pixel_specular), c.pixels
    )
    z_sdf = batch.codes(shape_codes.z_sdf.detach(), c.pixels)
    _, gradient, x_ref, gamma = sdf_and_gradient(shape, x, z_sdf, differentiable=False)
    normals = nn.functional.normalize(gradient.detach(), dim=-1)
    x_ref, gamma = x_ref.detach(), gamma.detach()
    z_a, z_s = (batch.codes(table, c.pixels) for table in (codes.z_a, codes.z_s))
    albedo = model.diffuse(x_ref, gamma, z_a)
    f0 = model.specular_f0(x_ref, albedo, z_s)
    axis, sharpness, amplitude = model.lobes(batch.codes(codes.z_l))
    radiance = []
    for i in range(len(axis)):
        rows = slice(i * c.pixels, (i + 1) * c.pixels)
        shading = shade(normals[rows], view[rows], albedo[rows], f0[rows], axis[i], sharpness[i], amplitude[i])
        radiance.append(shading.diffuse_radiance + shading.specular_radiance)
    offset = c.smooth_reach * batch.normal(c.pixels, 3)
    losses = {
        "colour": (srgb_encode(torch.cat(radiance)) - srgb_encode(rgb)).abs().mean(),
        "embedding": sum(batch.codes(table).square().sum(-1).mean() for table in (codes.z_a, codes.z_s, codes.z_l)),
        "smooth": (albedo - model.diffuse(x_ref + offset, gamma, z_a)).abs().mean(),
    }
    if c.supervision > 0:
        losses["supervision"] = _supervision(albedo, f0, diffuse, specular, share)
    return losses


def _supervision(albedo: Tensor, f0: Tensor, diffuse: Tensor, specular: Tensor, share: Share) -> Tensor:
    """Error of both albedos against exact ones, over the pixels of the whole step that have them."""
    known = torch.isfinite(specular)
    diffuse, specular = torch.where(known[:, None], diffuse, 0.0), torch.where(known, specular, 0.0)
    error = (srgb_encode(albedo) - srgb_encode(diffuse)).abs().mean(-1) + (f0 - specular).abs() / 0.04
    return (known * error).mean() / share.mean(known.float().mean()).clamp_min(1e-6)


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
    scenes_digest: str = "",
    share: Share = Share(),
    report: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> tuple[AppearanceFactorModel, AppearanceCodes, float]:
    """Train AF-SM on a frozen SA-SM, keeping `folder/appearance.safetensors`; with `resume` go on from it exactly.

    Parameters, returned values and errors as `train_shape`.
    """
    torch.manual_seed(config.seed + 1)
    model = AppearanceFactorModel(model_config, feature_size=shape.config.feature_size).to(device)
    codes = new_appearance_codes(len(data), model_config, config.seed, device)
    shape.requires_grad_(False)
    learnt_on = tensors_digest({**shape.state_dict(), "z_sdf": shape_codes.z_sdf})
    trainee = Trainee(model, {"z_a": codes.z_a, "z_s": codes.z_s, "z_l": codes.z_l}, config.rate, config.code_rate)
    names = ("embedding", "smooth", *(("supervision",) if config.supervision > 0 else ()))
    seconds = train(
        trainee,
        lambda step: appearance_losses(model, codes, shape, shape_codes, data, config, step, share),
        {"colour": 1.0} | {name: getattr(config, name) for name in names},
        Path(folder) / "appearance.safetensors",
        LoopConfig(config.steps, save_every, resume),
        run_digest=digest("AF-SM", learnt_on, shape.config, model_config, config, len(data), scenes_digest),
        share=share,
        report=report,
    )
    return model, codes, seconds
