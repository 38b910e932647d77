"""What the fit leaves out, beside the truth, and what that saves and costs.

The scenes' photos are made anew from their exact normals and albedos, lit by few or many lobes, with or without
highlights, without shadows; each becomes an avatar twice, on one fitted shape: as the scene requires, and with
everything.
"""

import tempfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from _fit_measurement import Scene, Shape, picture_scores
from _tradeoff_keep import measured

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


# What both runs of a scene have in common: made once, and counted for both.
SHARED = ("fit geometry", "extract", "clean", "simplify", "measure")


def measure_thrift(scene: Scene, prior, settings) -> dict[str, object]:
    """One scene under its light: what was kept, and both journeys' seconds, bytes and decibels."""
    from sira_assets.pipeline import modelling_everything, run

    case = zlib.crc32(scene.folder.name.encode())
    lobes, highlights = LIGHTS[case % len(LIGHTS)]
    portrait = relit(scene, lobes, highlights, case)
    settings = replace(settings, appearance=replace(settings.appearance, shadows=False))
    stages = SharedStages()
    out: dict[str, object] = {"lobes": lobes, "highlights": highlights}
    for name, everything in (("required", False), ("everything", True)):
        chosen = modelling_everything(settings) if everything else settings
        stages.begin()
        journey = run(portrait, chosen, prior=prior, runner=stages)
        out[f"{name}_s"] = sum(stages.cpu_s.values())
        out |= {f"{name}_{key}": value for key, value in scores(journey, scene, portrait).items()}
        if not everything:
            out["shape_s"] = sum(stages.cpu_s[stage] for stage in SHARED)
            out["lobes_kept"] = len(journey.avatar.light.sharpness)
            out["highlights_kept"] = journey.appearance.head.specular_scale > 0.0
    return out


class SharedStages:
    """A runner for `pipeline.run` that makes the shared stages once.

    Attributes
    ----------
    cpu_s : stage -> processor seconds, its children's too, whether made now or before
    """

    def __init__(self):
        self._held: dict[str, tuple[object, float]] = {}
        self.begin()

    def begin(self) -> None:
        """Another run."""
        self.cpu_s: dict[str, float] = {}

    def __call__(self, name: str, function: Callable, *arguments, **options):
        """Run a stage, or give what it made."""
        if name in self._held:
            out, self.cpu_s[name] = self._held[name]
            return out
        out, stage = measured(name, function, *arguments, **options)
        self.cpu_s[name] = stage.cpu_s
        if name in SHARED:
            self._held[name] = out, stage.cpu_s
        return out


def scores(journey, scene: Scene, portrait) -> dict[str, float]:
    """dB of the field (final, diffuse) and of the exported file against the photo (asset); the file's bytes."""
    from sira_assets.asset.gltf import write_glb
    from sira_assets.measure.exported import measure_exported

    shape = Shape(journey.portrait, journey.geometry, journey.surface, {})
    pictures = picture_scores(shape, journey.appearance, scene, photo=portrait.image_linear)
    with tempfile.TemporaryDirectory() as folder:
        glb = Path(folder) / "avatar.glb"
        write_glb(journey.avatar, glb, journey.settings.export)
        compared = journey.view.final, portrait.image_linear, portrait.mask
        asset = measure_exported(glb, *compared, shadows=journey.appearance.shadowed)
        kilobytes = glb.stat().st_size / 1000
    found = {key: pictures[key] for key in ("final", "diffuse")}
    return found | {"asset": asset.against_photo.psnr_db, "kB": kilobytes}


def print_thrift(rows: list[Mapping[str, object]]) -> None:
    """A line a scene, then the means."""
    from _fit_measurement import mean_of, print_table

    yes = lambda b: "yes" if b else "no"  # noqa: E731
    pairs = [
        f"{kind}_{what}" for what in ("s", "kB", "final", "asset", "diffuse") for kind in ("required", "everything")
    ]
    lines = []
    for r in rows:
        kept = [r["lobes"], r["lobes_kept"], yes(r["highlights"]), yes(r["highlights_kept"])]
        lines.append([r["scene"], *kept, r["shape_s"], *(r[pair] for pair in pairs)])
    lines.append(["mean", "", "", "", "", mean_of(rows, "shape_s"), *(mean_of(rows, pair) for pair in pairs)])
    columns = ["scene", "lobes", "kept", "highlights", "kept", "shape CPU s", "CPU s", "all", "kB", "all"]
    print_table([*columns, "final dB", "all", "asset dB", "all", "diffuse dB", "all"], lines)
