#!/usr/bin/env python3
"""Measure cast shadows on scenes with true maps: closed-form light times ray-cast visibility against path tracing.

Diffuse radiance albedo / pi sum_i S_i E_i of the true albedo, normals, positions, mesh and light, against the scene's
gt/diffuse_radiance.exr (path traced with shadows, without bounces), both after a 5 x 5 box that drowns the truth's
noise, on the mask less 4 pixels at its edge; linear radiance, PSNR with a peak of 1. A scene without a mesh of its own
is measured with the maps of --maps.
"""

import argparse
import json
import sys
from pathlib import Path

from _cli import run

# The truth's shadow rays leave the triangles themselves: 0.02 mm clears rounding and nothing else.
TRUE_OFFSET_M = 2e-5


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(prog="measure_visibility.py", description=__doc__.split("\n\n")[0])
    out.add_argument("scene", nargs="+", type=Path, help="scene folders with gt/diffuse_radiance.exr and lights.json")
    out.add_argument("--maps", type=Path, metavar="SCENE", help="take mesh, albedo, normals, positions from its gt/")
    out.add_argument("--rays", type=int, default=64, metavar="K", help="rays per point and lobe (default 64)")
    out.add_argument("--directions", type=int, default=256, metavar="K", help="directions all points share (256)")
    out.add_argument("--picture", type=Path, metavar="PNG", help="ours, truth and ten times their difference")
    out.add_argument("--json", action="store_true", help="print JSON instead of the table")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    p = parser()
    arguments = p.parse_args(argv)
    if arguments.rays < 1 or arguments.directions < 1:
        p.error("--rays and --directions must be at least 1")
    return run(lambda: body(arguments))


def body(arguments: argparse.Namespace) -> int:
    """Measure each scene and print."""
    import numpy as np

    figures, rows = {}, []
    for scene in arguments.scene:
        figures[scene.name], pictures = measure(scene, arguments.maps or scene, arguments.rays, arguments.directions)
        rows.append(np.concatenate(pictures, 1))
    if arguments.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, values in figures.items():
            print(name, *(f"  {key:<52}{value:10.4g}" for key, value in values.items()), sep="\n")
    if arguments.picture:
        from sira_assets.numerics.colour import srgb_from_linear
        from sira_assets.scene.image import write_png

        write_png(arguments.picture, np.round(255 * srgb_from_linear(np.concatenate(rows))).astype(np.uint8))
    return 0


def measure(scene: Path, maps: Path, rays: int, directions: int):
    """Figures of one scene, and (H, W, 3) linear pictures: ours, truth, ten times the difference."""
    import time

    import numpy as np
    import torch
    from scipy import ndimage

    from sira_assets.measure.truth import read_mesh
    from sira_assets.mesh.raycast import Raycaster
    from sira_assets.numerics.sg import irradiance
    from sira_assets.render.visibility import SurfaceVisibility, lobe_visibility
    from sira_assets.render.visibility_table import shared_visibility
    from sira_assets.scene.image import read_image, read_mask
    from sira_assets.scene.sg_light import SGLight

    light = SGLight.from_dict(json.loads((scene / "gt" / "lights.json").read_text()))
    albedo, normals, positions = (
        read_image(maps / "gt" / f"{name}.exr").linear for name in ("albedo", "normal", "position")
    )
    shadowed, unshadowed = (
        read_image(scene / "gt" / f"diffuse_{name}.exr").linear for name in ("radiance", "unshadowed")
    )
    length = np.linalg.norm(normals, axis=-1)
    inside = read_mask(scene / "mask.png") & (np.abs(length - 1.0) < 0.02)
    keep = ndimage.binary_erosion(inside, iterations=4)
    n = normals[inside].astype(np.float64) / length[inside][:, None]
    x = positions[inside].astype(np.float64)
    mesh = read_mesh(maps / "gt" / "mesh.ply")
    caster = Raycaster(mesh)
    axis, sharpness, amplitude = light.axis, light.sharpness, light.amplitude
    lobes = tuple(torch.tensor(a, dtype=torch.float32) for a in (axis, sharpness, amplitude))

    def shade(visibility) -> np.ndarray:
        out = np.zeros_like(albedo)
        seen = None if visibility is None else torch.as_tensor(visibility)
        e = irradiance(torch.tensor(n, dtype=torch.float32), *lobes, visibility=seen)
        out[inside] = albedo[inside] * e.numpy() / np.pi
        return out

    def decibels(ours: np.ndarray, truth: np.ndarray) -> float:
        box = lambda a: ndimage.uniform_filter(a.astype(np.float64), (5, 5, 0))[keep]  # noqa: E731
        return float(-10.0 * np.log10(((box(ours) - box(truth)) ** 2).mean()))

    def of_vertices() -> np.ndarray:
        at = (mesh.vertices, mesh.normals, axis, sharpness, amplitude)
        share = shared_visibility(caster, *at, directions=directions, offset=TRUE_OFFSET_M)
        return SurfaceVisibility(mesh, share).near(caster, x)

    ways = {
        f"{rays} rays per point and lobe": lambda: lobe_visibility(
            caster, x, n, axis, sharpness, rays=rays, offset=TRUE_OFFSET_M
        ),
        f"{directions} shared directions": lambda: shared_visibility(
            caster, x, n, axis, sharpness, amplitude, directions=directions, offset=TRUE_OFFSET_M
        ),
        f"{directions} shared directions, at the mesh's vertices": of_vertices,
    }
    figures: dict[str, float] = {"points": float(inside.sum()), "vertices": float(len(mesh.vertices))}
    figures["light hidden, %"] = float(100.0 * (1.0 - shadowed[keep].mean() / unshadowed[keep].mean()))
    figures["no shadows, dB"] = decibels(shade(None), shadowed)
    figures["no shadows against truth without shadows, dB"] = decibels(shade(None), unshadowed)
    pictures = []
    for name, way in ways.items():
        started = time.process_time()
        ours = shade(way())
        figures[f"{name}, dB"] = decibels(ours, shadowed)
        figures[f"{name}, CPU s"] = time.process_time() - started
        if not pictures:
            pictures = [ours, shadowed, np.clip(10.0 * np.abs(ours - shadowed), 0.0, 1.0)]
    return figures, pictures


if __name__ == "__main__":
    sys.exit(main())
