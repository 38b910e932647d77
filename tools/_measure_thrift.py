"""What the fit leaves out, beside the truth, and what that saves and costs.

The scenes' photos are made anew from their exact normals and albedos, lit by few or many lobes, with or without
highlights, without shadows; each is fitted twice on one fitted shape: as the scene requires, and with everything.
"""

import zlib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from _fit_measurement import Scene, fit_material, fit_shape, picture_scores

# (lobes, whether there are highlights): a scene's name decides which, so that it has always the same.
LIGHTS = ((1, True), (3, False), (12, True), (1, False), (6, True), (3, True), (12, False), (2, True))
ROUGHNESS = 0.45


def drawn_lobes(count: int, rng: np.random.Generator):
    """Lobes from all over the front and the sides (canonical frame), of equal flux, some of them sharp."""
    axis = rng.normal(size=(count, 3))
    axis[:, 2] = np.abs(axis[:, 2]) + 0.3
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    sharpness = np.exp(rng.uniform(np.log(4.0), np.log(60.0), count))
    colour = 1.0 + 0.15 * rng.uniform(-1.0, 1.0, (count, 3))
    return axis, sharpness, colour * sharpness[:, None]


def relit(scene: Scene, lobes: int, highlights: bool, seed: int):
    """The portrait under that light."""
    import torch

    from sira_assets.render.shading import shade
    from sira_assets.scene.image import read_image

    p, gt = scene.portrait, scene.folder / "gt"
    maps = [read_image(gt / f"{name}.exr").linear[p.mask] for name in ("normal", "albedo", "specular")]
    normals, albedo, ks = (torch.as_tensor(m, dtype=torch.float32) for m in maps)
    _, directions = p.camera.rays_world()
    view = torch.as_tensor(-directions[p.mask.reshape(-1)], dtype=torch.float32)
    axis, sharpness, amplitude = drawn_lobes(lobes, np.random.default_rng([seed, lobes, highlights]))
    turn = p.world_from_canonical[:3, :3] / np.cbrt(np.linalg.det(p.world_from_canonical[:3, :3]))
    f0 = 0.04 * ks.mean(-1) if highlights else None
    light = (torch.as_tensor(a, dtype=torch.float32) for a in (axis @ turn.T, sharpness, amplitude))
    unit = torch.nn.functional.normalize(normals, dim=-1)
    radiance = shade(unit, view, albedo, f0, *light, roughness=ROUGHNESS).radiance.numpy()
    image = np.zeros_like(p.image_linear)
    image[p.mask] = np.minimum(0.7 * radiance / np.quantile(radiance, 0.98), 1.0)
    return replace(p, image_linear=image, saturated=(image >= 1.0).any(-1))


def measure_thrift(scene: Scene, prior, settings) -> dict[str, object]:
    """One scene under its light: what was kept, and both fits' seconds and decibels."""
    case = zlib.crc32(scene.folder.name.encode())
    lobes, highlights = LIGHTS[case % len(LIGHTS)]
    portrait = relit(scene, lobes, highlights, case)
    appearance = replace(settings.appearance, shadows=False)
    shape = fit_shape(portrait, prior, settings)
    out: dict[str, object] = {"lobes": lobes, "highlights": highlights}
    for name, everything in (("required", False), ("everything", True)):
        chosen = replace(settings, appearance=replace(appearance, everything=everything))
        fit, seconds = fit_material(shape, prior, chosen)
        scores = picture_scores(shape, fit, scene, photo=portrait.image_linear)
        out[f"{name}_s"] = seconds["appearance"]
        out |= {f"{name}_{k}": scores[k] for k in ("final", "diffuse")}
        if not everything:
            out["lobes_kept"] = len(fit.light.sharpness)
            out["highlights_kept"] = fit.head.specular_scale > 0.0
    return out


def print_thrift(rows: list[Mapping[str, object]]) -> None:
    """A line a scene, then the means."""
    from _fit_measurement import mean_of, print_table

    yes = lambda b: "yes" if b else "no"  # noqa: E731
    lines = []
    for r in rows:
        of_both = [r[f"{kind}_{what}"] for what in ("s", "final", "diffuse") for kind in ("required", "everything")]
        kept = [r["lobes"], r["lobes_kept"], yes(r["highlights"]), yes(r["highlights_kept"])]
        lines.append([r["scene"], *kept, *of_both])
    means = [mean_of(rows, f"{kind}_{w}") for w in ("s", "final", "diffuse") for kind in ("required", "everything")]
    lines.append(["mean", "", "", "", "", *means])
    columns = ["scene", "lobes", "kept", "highlights", "kept", "CPU s", "all", "final dB", "all", "diffuse dB", "all"]
    print_table(columns, lines)
