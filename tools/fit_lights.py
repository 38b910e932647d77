#!/usr/bin/env python3
"""Fit spherical gaussians to a panorama (.exr or .hdr) and write them as lights.json.

As many lobes as the residuals asked for need; --picture shows the panorama beside the lobes, and spheres lit by both.
"""

import argparse
import json
import sys
import time
from pathlib import Path

from _cli import run

# Pixels of a normal map at which irradiance is compared, and rows of cells for the spheres of the picture.
MEASURED_NORMALS, PICTURE_ROWS, SPHERE = 8192, 64, 96


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(prog="fit_lights.py", description=__doc__.split("\n\n")[0])
    out.add_argument("panorama", type=Path, metavar="PANORAMA", help="lat-long .exr or .hdr, twice as wide as high")
    out.add_argument("--out", type=Path, required=True, metavar="JSON", help="where the lobes go: lights.json")
    out.add_argument("--residual", type=float, default=0.02, help="irradiance, RMS / mean (default 0.02)")
    out.add_argument(
        "--glossy-residual", type=float, default=0.05, help="blurred radiance, relative RMS (default 0.05; inf: any)"
    )
    out.add_argument("--lobes", type=int, metavar="N", help="N lobes at most, whatever the residuals")
    out.add_argument("--max-lobes", type=int, default=128, metavar="N", help="where the search ends (default 128)")
    out.add_argument("--blur-degrees", type=float, default=10.0, help="width of that blur, 4 to 60 (default 10)")
    out.add_argument("--back", type=Path, metavar="FILE", help="also write the lobes as a panorama, .exr or .hdr")
    out.add_argument("--normals", type=Path, metavar="EXR", help="also measure irradiance on this normal map")
    out.add_argument("--picture", type=Path, metavar="PNG", help="panorama beside lobes, and spheres lit by both")
    out.add_argument("--json", action="store_true", help="print JSON instead of the table")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: fit(arguments))


def fit(arguments: argparse.Namespace) -> int:
    """Fit, write, measure; 4 if the residuals asked for were not reached."""
    from sira_assets.atomic import write_text
    from sira_assets.fit.panorama import PanoramaFitConfig, fit_panorama, irradiance_residual_on
    from sira_assets.scene.envmap import envmap_from_sg, read_envmap, write_envmap

    config = PanoramaFitConfig(
        arguments.residual, arguments.glossy_residual, arguments.lobes, arguments.max_lobes, arguments.blur_degrees
    )
    envmap = read_envmap(arguments.panorama)
    start, start_cpu = time.perf_counter(), time.process_time()
    found = fit_panorama(envmap, config)
    seconds, cpu = time.perf_counter() - start, time.process_time() - start_cpu
    figures = {
        "lobes": len(found.light),
        "irradiance residual, RMS / mean": found.irradiance_residual,
        "irradiance residual, RMS / largest": found.irradiance_residual_of_peak,
        "irradiance residual, worst / largest": found.irradiance_worst_of_peak,
        f"glossy residual, blurred by {config.blur_degrees:g} degrees": found.glossy_residual,
        "seconds": round(seconds, 2),
        "seconds of CPU": round(cpu, 2),
    }
    if arguments.normals:
        normals = read_normals(arguments.normals)
        of_mean, of_peak = irradiance_residual_on(envmap, found.light, normals)
        figures["on the normal map, RMS / mean"] = of_mean
        figures["on the normal map, RMS / largest"] = of_peak
    write_text(arguments.out, json.dumps(found.light.to_dict(), indent=1, allow_nan=False) + "\n")
    if arguments.back:
        write_envmap(arguments.back, envmap_from_sg(found.light, envmap.radiance.shape[0]))
    if arguments.picture:
        draw(arguments.picture, envmap, found.light)
    if arguments.json:
        trail = [{"lobes": n, "irradiance": e, "glossy": g} for n, e, g in found.trail]
        print(json.dumps({**figures, "reached": found.reached, "trail": trail}, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:<44}{value:10.4g}")
    if not found.reached:
        print(f"the residuals asked for need more than {len(found.light)} lobes: see --max-lobes", file=sys.stderr)
        return 4
    return 0


def read_normals(path: Path):
    """Unit normals (n, 3), at most MEASURED_NORMALS evenly taken from those of an EXR map; the rest is background."""
    import numpy as np

    from sira_assets.errors import InputError
    from sira_assets.scene.exr import read_exr

    pixels = read_exr(path)
    length = np.linalg.norm(pixels, axis=-1) if pixels.ndim == 3 else np.zeros(1)
    seen = np.abs(length - 1.0) < 0.01  # half floats keep a length of 1 to 0.001
    if not seen.any():
        raise InputError(
            expected=f"unit normals (H, W, 3) in {path}", received=f"shape {pixels.shape}", remedy="give gt/normal.exr"
        )
    normals = pixels[seen].astype(np.float64)
    normals = normals[:: -(-len(normals) // MEASURED_NORMALS)]
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def draw(path: Path, envmap, light) -> None:
    """Panorama and lobes as pictures; a white diffuse and two glossy spheres, seen along -Z, lit by each."""
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from sira_assets.atomic import replacing
    from sira_assets.fit.panorama_cells import cells_blurred, cells_irradiance, panorama_cells
    from sira_assets.numerics.colour import srgb_from_linear
    from sira_assets.scene.envmap import envmap_from_sg
    from sira_assets.scene.envmap_resample import envmap_resized

    height = min(envmap.radiance.shape[0], 256)
    maps = envmap_resized(envmap, height), envmap_from_sg(light, height)
    x, y = np.meshgrid(*[(np.arange(SPHERE) + 0.5) / SPHERE * 2.0 - 1.0] * 2)
    y, inside = -y, x * x + y * y < 1.0
    normals = np.stack([x, y, np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], -1)[inside]
    mirror = 2.0 * normals[:, 2:] * normals - [0.0, 0.0, 1.0]
    # A GGX surface of roughness r reflects, head-on, a lobe of sharpness 1 / (2 r^4) about the mirror direction.
    lit = [("diffuse", lambda cells: cells_irradiance(cells, normals) / np.pi)]
    lit += [
        (f"glossy, roughness {r}", lambda cells, r=r: cells_blurred(cells, mirror, 0.5 / r**4)) for r in (0.5, 0.35)
    ]
    exposure = 0.18 / max(float(np.median(maps[0].radiance.mean(-1))), 1e-30)
    figure = Figure(figsize=(12, 6), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subfigures(2, 1)
    for axes, shown, title in zip(rows[0].subplots(1, 2), maps, ("panorama", f"{len(light)} lobes"), strict=True):
        axes.imshow(srgb_from_linear(np.clip(shown.radiance * exposure, 0.0, 1.0)))
        axes.set(title=title, xticks=[], yticks=[])
    columns = iter(rows[1].subplots(1, 2 * len(lit)))
    for title, reflect in lit:
        balls = np.zeros((2, SPHERE, SPHERE, 3))
        balls[:, inside] = [reflect(panorama_cells(shown, PICTURE_ROWS)) for shown in maps]
        white = max(float(np.percentile(balls[0][inside], 98)), 1e-30)
        for ball, by in zip(balls, ("panorama", "lobes"), strict=True):
            axes = next(columns)
            axes.imshow(srgb_from_linear(np.clip(ball / white, 0.0, 1.0)))
            axes.set(title=f"{title}\nby {by}", xticks=[], yticks=[])
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=100)


if __name__ == "__main__":
    sys.exit(main())
