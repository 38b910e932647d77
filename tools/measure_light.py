#!/usr/bin/env python3
"""Measure the closed-form light: error and cost of each grade of irradiance and of the specular lobe.

Errors are against quadrature (numerics/sg_reference.py); costs are ratios to `exp` of as many numbers on this machine.
`--picture` writes the error maps that docs/light.md shows.
"""

import argparse
import json
import sys
from pathlib import Path

from _cli import run

GRADES = ("fast", "accurate")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(prog="measure_light.py", description=__doc__.split("\n\n")[0])
    out.add_argument("--picture", type=Path, metavar="PNG", help="write the error maps (some 20 s)")
    out.add_argument("--points", type=int, default=100_000, metavar="N", help="surface points timed (default 100000)")
    out.add_argument("--lobes", type=int, default=32, metavar="M", help="light lobes timed (default 32)")
    out.add_argument("--traffic", action="store_true", help="shading against copying its arrays instead")
    out.add_argument("--scene", type=Path, metavar="DIR", help="irradiance on a scene's true normals (gt/) as well")
    out.add_argument("--json", action="store_true", help="print JSON instead of the table")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: measure(arguments))


def measure(arguments: argparse.Namespace) -> int:
    """Print errors and costs, and write the picture if asked."""
    figures = {} if arguments.traffic else {**irradiance_errors(), **costs(arguments.points, arguments.lobes)}
    if arguments.traffic:
        figures |= traffic(arguments.points, arguments.lobes)
    if arguments.scene:
        figures |= scene_errors(arguments.scene)
    if arguments.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:<58}{value:12.5g}")
    if arguments.picture:
        draw(arguments.picture)
    return 0


def sweep():
    """Sharpness (S, 1) and cosine (1, C) of the irradiance figures."""
    import numpy as np

    crowded = np.geomspace(1e-4, 1.0, 200)
    sharpness = np.concatenate([[0.0], np.geomspace(1e-8, 1e8, 200)])[:, None]
    return sharpness, np.concatenate([-crowded[::-1], [0.0], crowded])[None]


def irradiance_errors() -> dict[str, float]:
    """Worst error of each grade and precision, in per cent of the lobe's head-on irradiance."""
    import numpy as np
    import torch

    from sira_assets.numerics.sg import LOBE_IRRADIANCE
    from sira_assets.numerics.sg_reference import irradiance_exact

    sharpness, cosine = sweep()
    exact, head_on = irradiance_exact(cosine, sharpness), irradiance_exact(1.0, sharpness)
    figures = {}
    for grade in GRADES:
        for dtype in (torch.float32, torch.float64):
            value = LOBE_IRRADIANCE[grade](torch.tensor(cosine, dtype=dtype), torch.tensor(sharpness, dtype=dtype))
            error = float((np.abs(value.double().numpy() - exact) / head_on).max())
            figures[f"irradiance {grade} {str(dtype)[6:]}, error % of head-on"] = 100.0 * error
    return figures


def costs(points: int, lobes: int) -> dict[str, float]:
    """CPU time of each grade on one thread, forward and with gradient, in units of one exp per pair."""
    import torch

    from sira_assets.numerics.sg import irradiance
    from sira_assets.numerics.sg_specular import specular_radiance

    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    normals, view, axis = (
        torch.nn.functional.normalize(torch.randn(n, 3, generator=generator), dim=-1) for n in (points, points, lobes)
    )
    view = torch.nn.functional.normalize(normals + 0.5 * view, dim=-1)
    light = axis, torch.exp(2 * torch.randn(lobes, generator=generator) + 2), torch.rand(lobes, 3, generator=generator)
    f0 = torch.full((points,), 0.04)
    pairs = torch.rand(points, lobes, generator=generator)
    unit = seconds(lambda: torch.exp(pairs))
    figures = {}
    for grade in GRADES:
        runs = {
            "irradiance": lambda n, g=grade: irradiance(n, *light, grade=g),
            "specular": lambda n, g=grade: specular_radiance(n, view, f0, *light, roughness=0.5, grade=g),
        }
        for name, function in runs.items():

            def with_gradient(function=function):
                leaf = normals.clone().requires_grad_()
                function(leaf).sum().backward()

            figures[f"{name} {grade}, forward, exps per pair"] = seconds(lambda f=function: f(normals)) / unit
            figures[f"{name} {grade}, with gradient, exps per pair"] = seconds(with_gradient) / unit
    return figures


def traffic(points: int, lobes: int) -> dict[str, float]:
    """CPU time of whole shading on one thread, over that of reading its inputs and writing its outputs once."""
    import torch

    from sira_assets.render.shading import shade

    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    random = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    unit = lambda x: torch.nn.functional.normalize(x, dim=-1)  # noqa: E731
    normals, axis = unit(random(points, 3)), unit(random(lobes, 3))
    view = unit(normals + 0.5 * unit(random(points, 3)))
    light = axis, torch.exp(2.0 * random(lobes) + 2.0), torch.rand(lobes, 3, generator=generator)
    albedo, f0 = torch.full((points, 3), 0.5), torch.full((points,), 0.04)
    read, written = [normals, view, albedo, f0], [torch.empty(points, 3) for _ in range(3)]

    def copy():
        for source in read:
            source.clone()
        for target in written:
            target.fill_(0.5)

    def with_gradient():
        leaves = [t.clone().requires_grad_() for t in (normals, albedo, f0)]
        shade(leaves[0], view, leaves[1], leaves[2], *light).radiance.sum().backward()

    copying = seconds(copy)
    forward = seconds(lambda: shade(normals, view, albedo, f0, *light), repeats=2)
    exponentials = seconds(lambda: torch.exp(normals[:, :1].expand(-1, lobes) * light[1]), repeats=2)
    return {
        "shading, forward, over copying its arrays": forward / copying,
        "shading, with gradient, over copying its arrays": seconds(with_gradient, repeats=2) / copying,
        "one exp per pair, over copying its arrays": exponentials / copying,
    }


def scene_errors(folder: Path) -> dict[str, float]:
    """Worst pixel of irradiance / pi on true normals against noise-free truth, in per cent of the picture's peak."""
    import numpy as np
    import torch

    from sira_assets.numerics.sg import irradiance
    from sira_assets.scene.image import read_image
    from sira_assets.scene.sg_light import SGLight

    light = SGLight.from_dict(json.loads((folder / "gt" / "lights.json").read_text()))
    normals, truth = (read_image(folder / "gt" / f"{name}.exr").linear for name in ("normal", "diffuse_shading"))
    length = np.linalg.norm(normals, axis=-1)
    inside = (np.abs(length - 1) < 1e-2) & (truth.sum(-1) > 0)
    n = torch.tensor(normals[inside] / length[inside][:, None])
    lobes = tuple(torch.tensor(a, dtype=torch.float32) for a in (light.axis, light.sharpness, light.amplitude))
    figures = {}
    for grade in GRADES:
        error = np.abs(irradiance(n, *lobes, grade=grade).numpy() / np.pi - truth[inside]).max()
        figures[f"irradiance {grade} on {folder.name}, error % of peak"] = 100.0 * float(error / truth[inside].max())
    return figures


def seconds(function, repeats: int = 5) -> float:
    """Least CPU time of several calls after one to warm up."""
    import time

    function()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return max(min(times), 1e-9)


def specular_error(roughness: float, n_dot_v: float, sharpness: float, grade: str) -> float:
    """Worst error over a sweep of the lobe through the plane of incidence, over the sweep's peak."""
    import numpy as np
    import torch

    from sira_assets.numerics.sg_reference import ggx_specular
    from sira_assets.numerics.sg_specular import specular_radiance

    angles = np.linspace(-1.5, 1.5, 13)
    axes = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], -1)
    exact = np.array([ggx_specular(n_dot_v, roughness, 0.04, a, sharpness, samples=96) for a in axes])
    normal, view = torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([[(1 - n_dot_v**2) ** 0.5, 0.0, n_dot_v]])
    ours = [
        specular_radiance(
            normal, view, torch.tensor([0.04]), torch.tensor(a[None], dtype=torch.float32), torch.tensor([sharpness]),
            torch.ones(1, 3), roughness=roughness, grade=grade,
        )[0, 0].item()
        for a in axes
    ]  # fmt: skip
    return float(np.abs(np.array(ours) - exact).max() / exact.max())


def draw(path: Path) -> None:
    """Error maps: irradiance over sharpness and cosine, the specular lobe over roughness and view."""
    import numpy as np
    import torch
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from sira_assets.atomic import replacing
    from sira_assets.numerics.sg import LOBE_IRRADIANCE
    from sira_assets.numerics.sg_reference import irradiance_exact

    figure = Figure(figsize=(12, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    sharpness, cosine = np.geomspace(1e-3, 1e6, 181)[:, None], np.linspace(-1, 1, 401)[None]
    exact, head_on = irradiance_exact(cosine, sharpness), irradiance_exact(1.0, sharpness)
    for row, grade in enumerate(GRADES):
        value = LOBE_IRRADIANCE[grade](torch.tensor(cosine), torch.tensor(sharpness)).numpy()
        error = 100 * (value - exact) / head_on
        bound = np.abs(error).max()
        image = axes[row, 0].pcolormesh(cosine[0], sharpness[:, 0], error, cmap="RdBu_r", vmin=-bound, vmax=bound)
        axes[row, 0].set(yscale="log", xlabel="n . xi", ylabel="sharpness", title=f"irradiance {grade}, % of head-on")
        figure.colorbar(image, ax=axes[row, 0])
        roughness, n_dot_v = np.linspace(0.2, 1.0, 9), np.linspace(0.05, 1.0, 10)
        for column, lam in enumerate((5.0, 50.0), start=1):
            grid = [[100 * specular_error(float(r), float(v), lam, grade) for v in n_dot_v] for r in roughness]
            image = axes[row, column].pcolormesh(n_dot_v, roughness, grid, cmap="viridis", vmin=0, vmax=100)
            axes[row, column].contour(n_dot_v, roughness, grid, [10, 20, 40], colors="white", linewidths=0.8)
            title = f"specular {grade}, light {lam:g}, % of peak"
            axes[row, column].set(xlabel="n . v", ylabel="roughness", title=title)
            figure.colorbar(image, ax=axes[row, column])
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=100)


if __name__ == "__main__":
    sys.exit(main())
