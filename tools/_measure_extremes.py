"""Scenes at the ends of what a photo can be: each must end in a sane avatar or in a refusal that says why.

Photos are made of a sound scene's exact normals and albedo (other lights, without shadows), or of its photo projected
onto the true surface and seen by another camera.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from _fit_measurement import Scene
from _measure_stability import Case, clipped, resized

# What a head fills of a picture taken for it, and where its middle lies (canonical metres).
FILLED_M = 0.45
MIDDLE_M = np.array([0.0, -0.04, -0.05])
PIXELS = 512


def with_image(scene: Scene, image: np.ndarray):
    """The portrait with that linear picture, nothing clipped."""
    p = scene.portrait
    return replace(p, image_linear=image.astype(np.float32), saturated=np.zeros_like(p.mask))


def black(scene: Scene):
    """Nothing was exposed."""
    return with_image(scene, np.zeros_like(scene.portrait.image_linear))


def white(scene: Scene):
    """Every pixel is clipped."""
    return clipped(scene.portrait, np.full_like(scene.portrait.image_linear, 4.0))


def one_pixel_of_light(scene: Scene):
    """Black but for one pixel in the mask's middle."""
    p = scene.portrait
    rows, columns = np.nonzero(p.mask)
    image = np.zeros_like(p.image_linear)
    image[int(np.median(rows)), int(np.median(columns))] = 0.5
    return with_image(scene, image)


def lit_by(scene: Scene, direction, sharpness: float):
    """One lobe from `direction` (canonical frame), as bright as exposes the lit half of the face."""
    import torch

    from sira_assets.numerics.sg import irradiance
    from sira_assets.scene.image import read_image

    p, gt = scene.portrait, scene.folder / "gt"
    normals, albedo = (read_image(gt / f"{name}.exr").linear for name in ("normal", "albedo"))
    axis = p.world_from_canonical[:3, :3] @ np.asarray(direction, np.float64)
    axis = torch.as_tensor(axis / np.linalg.norm(axis), dtype=torch.float32)[None]
    n = torch.nn.functional.normalize(torch.as_tensor(normals[p.mask], dtype=torch.float32), dim=-1)
    # The lobe's energy is held, so that a sharp one is as bright as a wide one.
    amplitude = torch.full((1, 3), sharpness / (2.0 * np.pi) / -np.expm1(-2.0 * sharpness))
    image = np.zeros_like(p.image_linear)
    image[p.mask] = irradiance(n, axis, torch.tensor([float(sharpness)]), amplitude).numpy() * albedo[p.mask]
    return clipped(p, 0.8 * image / max(np.quantile(image[p.mask], 0.99), 1e-9))


def seen_from(scene: Scene, distance_m: float, focal_px: float, pixels: int = PIXELS):
    """The scene's photo on its true surface, seen from `distance_m` before the face through another lens."""
    from sira_assets.mesh.raycast import Raycaster
    from sira_assets.scene.camera import Camera
    from sira_assets.scene.canonical import transform_points

    p = scene.portrait
    to_world = p.world_from_canonical
    scale = np.cbrt(np.linalg.det(to_world[:3, :3]))
    rotation = to_world[:3, :3] / scale
    pose = np.eye(4)
    pose[:3, :3] = rotation @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = transform_points(to_world, (MIDDLE_M + np.array([0.0, 0.0, distance_m]))[None])[0]
    half = pixels / 2
    camera = Camera(np.array([[focal_px, 0, half], [0, focal_px, half], [0, 0, 1.0]]), pose, pixels, pixels)
    # The truth stands in metres, the portrait in its world's units.
    mesh = scene.truth.mesh.transformed(np.diag([*[1.0 / p.metres_per_unit] * 3, 1.0]))
    origins, directions = camera.rays_world()
    hit = Raycaster(mesh).cast(origins, directions)
    mask = hit.hit.reshape(pixels, pixels)
    t = hit.t[hit.hit]
    points = origins[hit.hit] + t[:, None] * directions[hit.hit]
    pixel, _ = p.camera.project(points)
    column, row = np.clip(pixel.astype(int), 0, [p.camera.width - 1, p.camera.height - 1]).T
    image = np.zeros((pixels, pixels, 3), np.float32)
    image[mask] = p.image_linear[row, column]
    bright = np.zeros_like(mask)
    bright[mask] = p.saturated[row, column]
    return replace(p, image_linear=image, mask=mask, saturated=bright, camera=camera)


def field_of_view(scene: Scene, degrees: float):
    """A lens of that field of view, as near as makes the head fill the picture, but never inside it."""
    focal = PIXELS / 2 / np.tan(np.radians(degrees) / 2)
    return seen_from(scene, max(focal / PIXELS * FILLED_M, 0.2), focal)


def small_mask(scene: Scene):
    """Fifty pixels of the face."""
    p = scene.portrait
    rows, columns = np.nonzero(p.mask)
    centre = np.median(rows), np.median(columns)
    nearest = np.argsort(np.hypot(rows - centre[0], columns - centre[1]), kind="stable")[:50]
    mask = np.zeros_like(p.mask)
    mask[rows[nearest], columns[nearest]] = True
    return replace(p, mask=mask)


def whole_mask(scene: Scene):
    """Everything is said to be head."""
    return replace(scene.portrait, mask=np.ones_like(scene.portrait.mask))


CASES = (
    Case("black", black),
    Case("white", white),
    Case("one pixel of light", one_pixel_of_light),
    Case("lamp of sharpness 1e6", lambda scene: lit_by(scene, (0.3, 0.3, 1.0), 1e6)),
    Case("rim light", lambda scene: lit_by(scene, (1.0, 0.2, -0.6), 300.0)),
    Case("32 pixels", lambda scene: resized(scene, 32)),
    Case("8192 pixels", lambda scene: resized(scene, 8192)),
    Case("field of view 2 deg", lambda scene: field_of_view(scene, 2.0)),
    Case("field of view 170 deg", lambda scene: field_of_view(scene, 170.0)),
    Case("10 m away", lambda scene: seen_from(scene, 10.0, 1.2 * PIXELS)),
    Case("mask of 50 pixels", small_mask),
    Case("mask that is everything", whole_mask),
)


def accepted(row: Mapping[str, object]) -> dict[str, object]:
    """A refusal in words is as good an end as a sane avatar."""
    return dict(row) | {"sane": bool(row["sane"] or row["wrong"] == "refused")}


def print_extremes(rows: list[Mapping[str, object]]) -> None:
    """A line a case, then what was said."""
    from _fit_measurement import print_table

    def end(row) -> str:
        return "refused" if row["wrong"] == "refused" else "sane" if row["sane"] else f"not sane: {row['wrong']}"

    lines = [[r["case"], end(r), r.get("placed"), r.get("seconds"), r["said"][0] if r["said"] else "-"] for r in rows]
    print_table(["case", "ends", "face placed", "CPU s", "first thing said"], lines)
