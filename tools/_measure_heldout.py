"""Held-out heads: everything that is known of a fit against the scene's exact truth."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from _fit_measurement import SAMPLES, Scene, Shape, face_errors, fit_material, fit_shape, picture_scores, rendered

COLUMNS = (
    "placed", "after_icp", "pred_to_gt", "seen", "unseen", "head", "final", "diffuse", "specular", "specular_constant",
    "specular_correlation", "relit", "light", "light_one_gain", "novel", "novel_seen", "seconds",
)  # fmt: skip


def measure_heldout(scene: Scene, prior, settings) -> dict[str, object]:
    """Figures of one scene: shape in mm, pictures in dB, light in shares of the true irradiance, seconds by stage."""
    shape = fit_shape(scene.portrait, prior, settings)
    appearance, seconds = fit_material(shape, prior, settings)
    stages = dict(shape.seconds) | seconds
    out = face_errors(shape, scene) | picture_scores(shape, appearance, scene)
    out |= light_error(appearance.light, scene.folder / "gt" / "lights.json") | novel_views(shape, appearance, scene)
    warnings = (*shape.geometry.warnings, *appearance.warnings)
    return out | {f"seconds_{n}": s for n, s in stages.items()} | {"seconds": sum(stages.values()), "said": warnings}


def light_error(found, path: Path, normals: int = 400) -> dict[str, float]:
    """RMS error of the irradiance on a sphere over the truth's RMS: light as it is, light_one_gain after the gain that
    explains it best (one photo leaves the brightness of light and skin to be divided)."""
    import json

    import torch

    from sira_assets.measure.outer_surface import fibonacci_directions
    from sira_assets.numerics.sg import irradiance
    from sira_assets.scene.sg_light import SGLight

    if not path.is_file():
        return {}
    n = torch.as_tensor(fibonacci_directions(normals))
    true, ours = (
        irradiance(n, *(torch.as_tensor(np.array(a)) for a in (light.axis, light.sharpness, light.amplitude))).numpy()
        for light in (SGLight.from_dict(json.loads(path.read_text())), found)
    )
    size = np.sqrt((true**2).mean())
    gain = (true * ours).sum() / max((ours**2).sum(), 1e-12)
    error = lambda e: float(np.sqrt(((e - true) ** 2).mean()) / size)  # noqa: E731
    return {"light": error(ours), "light_one_gain": error(gain * ours)}


def novel_views(shape: Shape, appearance, scene: Scene, count: int = 4) -> dict[str, float]:
    """novel: dB (sRGB) of the scene's other views inside their masks, pooled; novel_seen: mm from the true head that
    they see and the portrait does not to the fit."""
    from sira_assets.measure.image_metrics import pooled_psnr, score_image
    from sira_assets.scene.image import read_image, read_mask

    frames = other_frames(scene.folder)[:count]
    if not frames:
        return {}
    scores = []
    for frame in frames:
        exact = frame.image_path.with_suffix(".exr")
        truth = read_image(exact if exact.is_file() else frame.image_path).linear
        view = rendered(shape, appearance, frame.camera, appearance.light)
        scores.append(score_image(view.final, truth, read_mask(frame.mask_path)))
    return {"novel": pooled_psnr(scores)} | newly_seen(shape, scene, [frame.camera for frame in frames])


def newly_seen(shape: Shape, scene: Scene, cameras) -> dict[str, float]:
    """novel_seen of `novel_views`."""
    from sira_assets.measure.regions import in_head, seen_by
    from sira_assets.measure.surface import MM_PER_M, Surface, sample_surface
    from sira_assets.measure.truth import camera_in_metres

    unit, truth = shape.portrait.metres_per_unit, scene.truth
    points = sample_surface(truth.mesh, SAMPLES, seed=0).points
    surface = Surface(truth.mesh)
    others = np.zeros(len(points), bool)
    for camera in cameras:
        others |= seen_by(camera_in_metres(camera, unit), points, surface)
    new = others & ~seen_by(truth.camera, points, surface) & in_head(points, truth.canonical_from_world)
    if not new.any():
        return {}
    world_from_canonical = np.diag([unit, unit, unit, 1.0]) @ shape.portrait.world_from_canonical
    distance = Surface(shape.surface.transformed(world_from_canonical)).distance(points[new])
    return {"novel_seen": float(distance.mean() * MM_PER_M)}


def other_frames(folder: Path) -> list:
    """A scene's views beside the portrait: further frames of its own, or those of its folder novel/."""
    from sira_assets.scene.read_scene import read_frames

    frames = read_frames(folder)[1:]
    if not frames and (folder / "novel" / "transforms.json").is_file():
        frames = read_frames(folder / "novel")
    masks = [frame.image_path.with_name(frame.image_path.stem.replace("view", "mask") + ".png") for frame in frames]
    from dataclasses import replace

    frames = [f if f.mask_path else replace(f, mask_path=m) for f, m in zip(frames, masks, strict=True)]
    return [frame for frame in frames if frame.mask_path.is_file()]


def print_heldout(rows: list[Mapping[str, object]]) -> None:
    """A line a scene and their mean."""
    from _fit_measurement import mean_of, print_table

    shown = [name for name in COLUMNS if any(name in row for row in rows)]
    lines = [[row["scene"], *(row.get(name) for name in shown)] for row in rows]
    print_table(["scene", *shown], [*lines, ["mean", *(mean_of(rows, name) for name in shown)]])
    stages = [name for name in rows[0] if name.startswith("seconds_")]
    print("processor seconds: " + ", ".join(f"{name[8:]} {mean_of(rows, name):.1f}" for name in stages))
