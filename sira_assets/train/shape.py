"""Auto-decoder training of SA-SM (SIRA section 3.1): latent codes and weights together.

Notation: as in fields/sa_sm.py; i scenes, j surface points, k volume points, l anchors. Lengths in network units.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig, sdf_and_gradient
from sira_assets.numerics.srgb import srgb_encode
from sira_assets.train.batches import Batch, SampleTensors
from sira_assets.train.loop import LoopConfig, Trainee, digest, train
from sira_assets.train.parallel import Share
from sira_assets.train.scenes import LANDMARKS

# Standard deviation of the widest principal code: what the widest direction has after a training without them.
WIDEST_CODE = 0.45


@dataclass(frozen=True)
class ShapeTrainConfig:
    """Weights of the losses (l1..l5 in the paper), sizes of a step, schedule.

    `sdf` and `normal` are additions: the generator knows exact distances and normals, which settle the inside and the
    space far from the surface in a tenth of the steps that the eikonal term alone needs.
    """

    steps: int = 12000
    scenes_per_step: int = 16
    pixels: int = 96
    surface: int = 48
    volume: int = 32
    volume_no_gradient: int = 128
    anchors: int = 64
    rate: float = 1.0e-3
    code_rate: float = 2.0e-3
    # Codes that start from principal components of the heads' correspondences; 0 starts all near zero, as the paper.
    principal_codes: int = 44
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
    # Share of the steps, from the start, whose hidden layers run in bfloat16.
    bfloat16: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class ShapeCodes:
    """One row a scene."""

    z_sdf: nn.Parameter
    z_r: nn.Parameter


def new_codes(count: int, config: ShapeConfig, seed: int, principal: Tensor | None = None) -> ShapeCodes:
    """Codes near zero, as the paper starts them; the first columns of z_sdf are `principal` (count, K), if given."""
    generator = torch.Generator().manual_seed(seed)
    size = (config.code_size, config.appearance_code_size)
    z_sdf, z_r = (0.05 * torch.randn(count, s, generator=generator) for s in size)
    if principal is not None:
        z_sdf[:, : principal.shape[1]] = principal[:, : config.code_size]
    return ShapeCodes(nn.Parameter(z_sdf), nn.Parameter(z_r))


def principal_codes(anchors: Float[Tensor, "N A 3"], count: int) -> Float[Tensor, "N K"]:
    """Principal components of heads in correspondence, scaled as codes: the wider a direction, the wider its code.

    An auto-decoder must discover how heads vary; where they are in correspondence, a linear model knows it before the
    first step, and its order (the broadest variations first) is kept.

    Parameters
    ----------
    anchors : points in correspondence, network units; NaN where a head lacks one
    count : columns asked for

    Returns
    -------
    K = `count`, or fewer where fewer than twice as many heads have all their points; the code of a head that lacks
    points is the likeliest one given those that it has, with a millimetre of noise.
    """
    points = anchors.double().flatten(1)
    known = torch.isfinite(points)
    whole = known.all(1)
    heads, noise = int(whole.sum()), 0.001 / UNIT_M
    if heads < 2:
        return anchors.new_zeros(len(anchors), 0)
    mean = points[whole].mean(0)
    _, scale, basis = torch.linalg.svd(points[whole] - mean, full_matrices=False)
    scale = scale / heads**0.5
    # Directions in which points differ by less than a micrometre are none.
    count = min(count, heads // 2, int((scale > 1e-3 * noise * points.shape[1] ** 0.5).sum()))
    if count < 1:
        return anchors.new_zeros(len(anchors), 0)
    scale, basis = scale[:count], basis[:count]
    # The sign of a singular vector is the library's whim; make its greatest entry positive.
    basis = basis * basis.gather(1, basis.abs().argmax(1, keepdim=True)).sign()
    reach = basis * scale[:, None]
    coefficients = []
    for row, has in zip(points - mean, known, strict=True):
        b = reach[:, has]
        system = b @ b.T + noise**2 * torch.eye(count, dtype=b.dtype)
        coefficients.append(torch.linalg.solve(system, b @ row[has]))
    width = WIDEST_CODE * (scale / scale[0]).sqrt()
    return (torch.stack(coefficients) * width).to(anchors)


def shape_losses(
    model: ShapeAppearanceModel,
    codes: ShapeCodes,
    data: SampleTensors,
    config: ShapeTrainConfig,
    step: int,
    share: Share = Share(),
) -> dict[str, Tensor]:
    """All loss terms of one step, unweighted; their mean over the processes is the step's."""
    low = step < config.bfloat16 * config.steps
    with torch.autocast(codes.z_sdf.device.type, torch.bfloat16, enabled=low):
        return _terms(model, codes, data, config, step, share)


def _terms(
    model: ShapeAppearanceModel,
    codes: ShapeCodes,
    data: SampleTensors,
    config: ShapeTrainConfig,
    step: int,
    share: Share,
) -> dict[str, Tensor]:
    c = config
    batch = Batch.of_step(c.seed, step, c.scenes_per_step, len(data), share, codes.z_sdf.device)
    count = len(batch.scenes)
    pixels, pixel_normals, view, rgb = batch.draw(
        (data.pixels, data.pixel_normals, data.pixel_view, data.pixel_rgb), c.pixels
    )
    surface, surface_normals = batch.draw((data.surface, data.surface_normals), c.surface)
    volume, volume_sdf = batch.draw((data.volume, data.volume_sdf), c.volume)
    x = torch.cat([pixels, surface, volume])
    z = torch.cat([batch.codes(codes.z_sdf, n) for n in (c.pixels, c.surface, c.volume)])
    sdf, gradient, x_ref, gamma = sdf_and_gradient(model, x, z, differentiable=True)
    on = len(pixels) + len(surface)
    length = gradient.norm(dim=-1)
    normals = gradient / length.clamp_min(1e-6)[:, None]
    true_normals = torch.cat([pixel_normals, surface_normals])

    seen = len(pixels)
    colour = {}
    if model.config.joint_appearance:
        # The renderer sees the model's own normals, as in the fit, but does not shape the surface through them here.
        z_r = batch.codes(codes.z_r, c.pixels)
        rendered = model.render(x_ref[:seen], normals[:seen].detach(), view, gamma[:seen], z_r)
        colour["colour"] = (rendered - srgb_encode(rgb)).abs().mean()

    loose, loose_sdf = batch.draw((data.volume, data.volume_sdf), c.volume_no_gradient)
    loose_prediction, _, _ = model(loose, batch.codes(codes.z_sdf, c.volume_no_gradient))
    prediction, truth = torch.cat([sdf[on:], loose_prediction]), torch.cat([volume_sdf, loose_sdf])

    anchors = batch.same_of_all(data.anchors, c.anchors, always=LANDMARKS)
    known = torch.isfinite(anchors).all(-1, keepdim=True)
    anchors = torch.where(known, anchors, 0.0)
    anchor_delta, _ = model.deform(anchors.flatten(0, 1), batch.codes(codes.z_sdf, anchors.shape[1]))
    anchor_delta = torch.where(known, anchor_delta.view_as(anchors), 0.0)
    delta = torch.cat([x_ref - x, anchor_delta.flatten(0, 1)])
    return {
        "surface": sdf[:on].abs().mean(),
        "eikonal": ((length - 1.0) ** 2).mean(),
        "deformation": delta.norm(dim=-1).mean() + share.mean(delta.mean(0)).norm(),
        # Mean over pairs i != j of |a_i - a_j|^2 is 2 B / (B - 1) times the spread about the batch mean.
        "landmark": 2.0 * count / max(count - 1, 1) * _spread(anchors + anchor_delta, known, share),
        "embedding": sum(batch.codes(table).square().sum(-1).mean() for table in (codes.z_sdf, codes.z_r)),
        "sdf": (prediction.clamp(-c.clamp, c.clamp) - truth.clamp(-c.clamp, c.clamp)).abs().mean(),
        "normal": (1.0 - (normals[:on] * true_normals).sum(-1)).mean(),
        **colour,
    }


def _spread(points: Tensor, known: Tensor, share: Share) -> Tensor:
    """Mean squared distance of known points (b, A, 3) from their mean over all scenes of the step."""
    weight = known.float()
    mean = share.mean((weight * points).sum(0)) / share.mean(weight.sum(0)).clamp_min(1e-6)
    return (weight * (points - mean).square()).sum() / share.mean(weight.sum()).clamp_min(1e-6)


def train_shape(
    data: SampleTensors,
    folder: Path,
    *,
    model_config: ShapeConfig = ShapeConfig(),
    config: ShapeTrainConfig = ShapeTrainConfig(),
    device: str | torch.device = "cpu",
    resume: bool = False,
    save_every: int = 500,
    scenes_digest: str = "",
    share: Share = Share(),
    report: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> tuple[ShapeAppearanceModel, ShapeCodes, float]:
    """Train SA-SM, keeping `folder/shape.safetensors` up to date; with `resume` go on from it exactly.

    Parameters
    ----------
    scenes_digest : says which scenes `data` is; a checkpoint of others is refused
    share : this process' part of every step

    Returns
    -------
    model, codes, seconds of all sessions together
    """
    torch.manual_seed(config.seed)
    model = ShapeAppearanceModel(model_config).to(device)
    principal = principal_codes(data.anchors.cpu(), config.principal_codes)
    codes = new_codes(len(data), model_config, config.seed, principal)
    codes = ShapeCodes(*(nn.Parameter(code.data.to(device)) for code in (codes.z_sdf, codes.z_r)))
    trainee = Trainee(model, {"z_sdf": codes.z_sdf, "z_r": codes.z_r}, config.rate, config.code_rate)

    def hold_deformation(step: int) -> None:
        if step < config.reference_steps and model_config.reference:
            for parameter in (*model.deformation.parameters(), codes.z_sdf):
                parameter.grad = None

    names = ("eikonal", "deformation", "landmark", "colour", "embedding", "sdf", "normal")
    seconds = train(
        trainee,
        lambda step: shape_losses(model, codes, data, config, step, share),
        {"surface": 1.0} | {name: getattr(config, name) for name in names},
        Path(folder) / "shape.safetensors",
        LoopConfig(config.steps, save_every, resume),
        run_digest=digest("SA-SM", model_config, config, len(data), scenes_digest),
        share=share,
        after_backward=hold_deformation,
        report=report,
    )
    return model, codes, seconds
