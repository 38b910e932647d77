"""Auto-decoder training of SA-SM (SIRA section 3.1): latent codes and weights together.

Notation: as in fields/sa_sm.py; i scenes, j surface points, k volume points, l anchors. Lengths in network units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig, sdf_and_gradient
from sira_assets.numerics.srgb import srgb_encode
from sira_assets.train.batches import SampleTensors, draw, step_generator
from sira_assets.train.checkpoint import load_checkpoint, save_checkpoint


@dataclass(frozen=True)
class ShapeTrainConfig:
    """Weights of the losses (l1..l5 in the paper), sizes of a step, schedule.

    `sdf` and `normal` are additions: the generator knows exact distances and normals, which settle the inside and the
    space far from the surface in a tenth of the steps that the eikonal term alone needs.
    """

    steps: int = 12000
    scenes_per_step: int = 8
    pixels: int = 192
    surface: int = 96
    volume: int = 64
    volume_no_gradient: int = 256
    anchors: int = 128
    rate: float = 1.0e-3
    code_rate: float = 2.0e-3
    # The deformation opens after this many steps; until then the reference learns the heads' median.
    reference_steps: int = 400
    eikonal: float = 0.1
    deformation: float = 0.002
    landmark: float = 3.0
    colour: float = 0.3
    embedding: float = 1.0e-4
    sdf: float = 1.0
    normal: float = 0.05
    # Distances beyond this only matter by their sign: far space needs no detail.
    clamp: float = 1.0
    seed: int = 0


@dataclass(frozen=True)
class ShapeCodes:
    """One row a scene."""

    z_sdf: nn.Parameter
    z_r: nn.Parameter


def new_codes(count: int, config: ShapeConfig, seed: int) -> ShapeCodes:
    """Codes near zero, as the paper starts them."""
    generator = torch.Generator().manual_seed(seed)
    size = (config.code_size, config.appearance_code_size)
    return ShapeCodes(*(nn.Parameter(0.05 * torch.randn(count, s, generator=generator)) for s in size))


def shape_losses(
    model: ShapeAppearanceModel, codes: ShapeCodes, data: SampleTensors, config: ShapeTrainConfig, step: int
) -> dict[str, Tensor]:
    """All loss terms of one step, unweighted."""
    c = config
    generator = step_generator(c.seed, step, data.surface.device)
    count = min(c.scenes_per_step, len(data))
    scenes = torch.randperm(len(data), generator=generator, device=generator.device)[:count]

    def code(table, repeats):
        return table[scenes].repeat_interleave(repeats, 0)

    pixels, pixel_normals, view, rgb = draw(
        (data.pixels, data.pixel_normals, data.pixel_view, data.pixel_rgb), scenes, c.pixels, generator
    )
    surface, surface_normals = draw((data.surface, data.surface_normals), scenes, c.surface, generator)
    volume, volume_sdf = draw((data.volume, data.volume_sdf), scenes, c.volume, generator)
    x = torch.cat([pixels, surface, volume])
    z = torch.cat([code(codes.z_sdf, n) for n in (c.pixels, c.surface, c.volume)])
    sdf, gradient, x_ref, gamma = sdf_and_gradient(model, x, z, differentiable=True)
    on = len(pixels) + len(surface)
    length = gradient.norm(dim=-1)
    normals = gradient / length.clamp_min(1e-6)[:, None]
    true_normals = torch.cat([pixel_normals, surface_normals])

    seen = len(pixels)
    # The renderer sees the model's own normals, as in the fit, but does not shape the surface through them here.
    colour = model.render(x_ref[:seen], normals[:seen].detach(), view, gamma[:seen], code(codes.z_r, c.pixels))

    loose, loose_sdf = draw((data.volume, data.volume_sdf), scenes, c.volume_no_gradient, generator)
    loose_prediction, _, _ = model(loose, code(codes.z_sdf, c.volume_no_gradient))
    prediction, truth = torch.cat([sdf[on:], loose_prediction]), torch.cat([volume_sdf, loose_sdf])

    (anchors,) = draw_anchors(data, scenes, c.anchors, generator)
    anchor_delta, _ = model.deform(anchors.flatten(0, 1), code(codes.z_sdf, anchors.shape[1]))
    anchor_ref = anchors + anchor_delta.view_as(anchors)
    delta = torch.cat([x_ref - x, anchor_delta])
    return {
        "surface": sdf[:on].abs().mean(),
        "eikonal": ((length - 1.0) ** 2).mean(),
        "deformation": delta.norm(dim=-1).mean() + delta.mean(0).norm(),
        # Mean over pairs i != j of |a_i - a_j|^2 is 2 B / (B - 1) times the spread about the batch mean.
        "landmark": 2.0
        * count
        / max(count - 1, 1)
        * (anchor_ref - anchor_ref.mean(0, keepdim=True)).square().sum(-1).mean(),
        "colour": (colour - srgb_encode(rgb)).abs().mean(),
        "embedding": codes.z_sdf[scenes].square().sum(-1).mean() + codes.z_r[scenes].square().sum(-1).mean(),
        "sdf": (prediction.clamp(-c.clamp, c.clamp) - truth.clamp(-c.clamp, c.clamp)).abs().mean(),
        "normal": (1.0 - (normals[:on] * true_normals).sum(-1)).mean(),
    }


def draw_anchors(data, scenes, count, generator):
    """The same `count` anchors of every drawn scene, (B, count, 3)."""
    index = torch.randperm(data.anchors.shape[1], generator=generator, device=generator.device)[:count]
    return (data.anchors[scenes][:, index],)


def train_shape(
    data: SampleTensors,
    folder: Path,
    *,
    model_config: ShapeConfig = ShapeConfig(),
    config: ShapeTrainConfig = ShapeTrainConfig(),
    device: str | torch.device = "cpu",
    resume: bool = False,
    save_every: int = 500,
    report: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> tuple[ShapeAppearanceModel, ShapeCodes]:
    """Train SA-SM, keeping `folder/shape.safetensors` up to date; with `resume` go on from it exactly.

    Returns
    -------
    model, codes
    """
    torch.manual_seed(config.seed)
    model = ShapeAppearanceModel(model_config).to(device)
    codes = new_codes(len(data), model_config, config.seed)
    codes = ShapeCodes(*(nn.Parameter(code.data.to(device)) for code in (codes.z_sdf, codes.z_r)))
    optimiser = torch.optim.Adam(
        [
            {"params": list(model.parameters()), "lr": config.rate},
            {"params": [codes.z_sdf, codes.z_r], "lr": config.code_rate},
        ]
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda s: learning_rate(s, config.steps))
    tensors = {"model": model.state_dict(), "codes": {"z_sdf": codes.z_sdf.data, "z_r": codes.z_r.data}}
    path = Path(folder) / "shape.safetensors"
    start = 0
    if resume and path.exists():
        start = load_checkpoint(path, tensors, optimiser, schedule)
    for step in range(start, config.steps):
        losses = shape_losses(model, codes, data, config, step)
        total = sum(getattr(config, name, 1.0) * value for name, value in losses.items() if name != "surface")
        total = total + losses["surface"]
        optimiser.zero_grad(set_to_none=True)
        total.backward()
        if step < config.reference_steps:
            for parameter in model.deformation.parameters():
                parameter.grad = None
            codes.z_sdf.grad = None
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        if (step + 1) % 50 == 0 or step + 1 == config.steps:
            report(step + 1, {name: float(value.detach()) for name, value in losses.items()})
        if (step + 1) % save_every == 0 or step + 1 == config.steps:
            save_checkpoint(path, tensors, optimiser, schedule, step + 1)
    return model, codes


def learning_rate(step: int, steps: int) -> float:
    """Factor of the rate: 100 steps of warm-up, then a cosine to a fiftieth."""
    warm = min(1.0, (step + 1) / 100)
    fraction = min(step / max(steps, 1), 1.0)
    return warm * (0.02 + 0.98 * 0.5 * (1.0 + float(torch.cos(torch.tensor(torch.pi * fraction)))))
