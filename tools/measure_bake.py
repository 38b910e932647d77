"""What a bake costs and how true it is: seconds and memory for all maps, seams, a known function and a checker.

The surface is the shipped models' mean head, or an ellipsoid; the maps' light is two lobes with cast shadows. Beside
it, on the same mesh and atlas, Open3D's bake (of vertex colours: it has no other), and Blender's with --blender PYTHON,
a Python that has bpy (from the dense surface's vertex colours).

    python tools/measure_bake.py --size 2048 --samples 4
    python tools/measure_bake.py --size 1024 --blender ~/blender-venv/bin/python --picture maps.png
"""

import argparse
import json
import sys
from pathlib import Path

import _cli


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--head", choices=["mean", "ellipsoid"], default="mean", help="the networks' mean head, or analytic")
    p.add_argument("--size", type=int, default=1024, help="texels a side (1024)")
    p.add_argument("--samples", type=int, default=4, metavar="K", help="K x K samples a texel (4)")
    p.add_argument("--triangles", type=int, default=20000, help="of the mesh baked on (20000)")
    p.add_argument("--cell", type=float, default=2.5, metavar="MM", help="of the surface extracted first (2.5)")
    p.add_argument("--known-only", action="store_true", help="leave out the timed bake of all maps")
    p.add_argument("--open3d", action="store_true", help="Open3D's bake too")
    p.add_argument("--blender", type=Path, metavar="PYTHON", help="Blender's bake too, by this Python")
    p.add_argument("--picture", type=Path, metavar="PNG", help="the maps side by side")
    p.add_argument("--json", action="store_true", help="print JSON")
    return p


def body(arguments: argparse.Namespace) -> int:
    """Bake, measure, print."""
    import time

    import numpy as np
    from _bake_checks import KnownMaterial, bake_figures, surface_points

    from sira_assets.fields.analytic import EllipsoidHead
    from sira_assets.fields.fitted import FittedHead
    from sira_assets.fields.prior import load_prior
    from sira_assets.mesh.clean import clean_mesh
    from sira_assets.mesh.extract import ExtractConfig, extract_mesh
    from sira_assets.mesh.project import ProjectConfig, project_points
    from sira_assets.mesh.simplify import simplify_mesh
    from sira_assets.render.visibility_table import surface_visibility
    from sira_assets.scene.sg_light import SGLight
    from sira_assets.texture.bake import BakeConfig, bake
    from sira_assets.texture.texture_set import MAPS
    from sira_assets.texture.unwrap import UnwrapConfig, unwrap

    head = EllipsoidHead()
    if arguments.head == "mean":
        prior = load_prior()
        head = FittedHead(prior.shape, prior.appearance, prior.z_sdf.mean, prior.z_a.mean, prior.z_s.mean)
    surface = clean_mesh(extract_mesh(head, ExtractConfig(cell_m=1e-3 * arguments.cell)))
    mesh = simplify_mesh(surface, arguments.triangles)
    atlas = unwrap(mesh, UnwrapConfig(texture_size=arguments.size))
    light = SGLight(
        np.array([[0.5, 0.5, 0.7071], [-0.8, 0.2, 0.5657]]), np.array([20.0, 2.0]), np.array([[6.0] * 3, [0.5] * 3])
    )
    figures: dict[str, dict] = {}
    if not arguments.known_only:
        before = peak_bytes()
        started, cpu = time.monotonic(), time.process_time()
        shadows = surface_visibility(surface, light, np.eye(4))
        config = BakeConfig(arguments.size, arguments.samples, MAPS)
        maps = bake(head, mesh, atlas, light, np.eye(4), config, shadows=shadows, surface=surface)
        figures["all maps"] = {
            "triangles": len(mesh.faces),
            "texels covered": int(maps.coverage.sum()),
            "seconds": time.monotonic() - started,
            "CPU seconds": time.process_time() - cpu,
            "peak memory, MB": peak_bytes() / 1e6,
            "of which before the bake, MB": before / 1e6,
        }
        if arguments.picture:
            write_sheet(maps, arguments.picture)
    known = KnownMaterial(head)
    started, cpu = time.monotonic(), time.process_time()
    config = BakeConfig(arguments.size, arguments.samples, ("diffuse",))
    texture = bake(known, mesh, atlas, light, np.eye(4), config).diffuse
    spent = {"seconds": time.monotonic() - started, "CPU seconds": time.process_time() - cpu}
    points = surface_points(mesh, atlas, 100_000)
    moved = project_points(head, points.x, ProjectConfig(0.003, 2e-6, 4))
    there = (mesh, atlas, points.some(np.abs(moved.residual_m) < 2e-5, moved.points))
    figures["ours"] = {**spent, **bake_figures(texture, *there)}
    if arguments.open3d:
        texture, spent = open3d_bake(mesh, atlas, arguments.size)
        # It bakes the mesh's own surface, so that is what it is held to.
        figures["Open3D"] = {**spent, **bake_figures(texture, mesh, atlas, points)}
    if arguments.blender:
        texture, spent = blender_bake(arguments.blender, mesh, atlas, surface, arguments.size, arguments.samples**2)
        figures["Blender"] = {**spent, **bake_figures(texture, *there)}
    if arguments.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, values in figures.items():
            print(name, *(f"  {key:<56}{value:12.5g}" for key, value in values.items()), sep="\n")
    return 0


def open3d_bake(mesh, atlas, size: int):
    """Open3D's map of the known colours at the mesh's vertices, and what it took."""
    import time

    import numpy as np
    import open3d
    from _bake_checks import known_colours

    core = open3d.core
    there = open3d.t.geometry.TriangleMesh(
        core.Tensor(mesh.vertices.astype(np.float32)), core.Tensor(mesh.faces.astype(np.int64))
    )
    there.vertex["known"] = core.Tensor(known_colours(mesh.vertices).astype(np.float32))
    # Its textures run upwards from v = 0.
    there.triangle["texture_uvs"] = core.Tensor(atlas.uv[atlas.faces_uv].astype(np.float32))
    started, cpu = time.monotonic(), time.process_time()
    baked = there.bake_vertex_attr_textures(size, {"known"}, margin=8.0)["known"].numpy()
    return baked, {"seconds": time.monotonic() - started, "CPU seconds": time.process_time() - cpu}


def blender_bake(python: Path, mesh, atlas, surface, size: int, samples: int):
    """Blender's map of the known colours at the dense surface's vertices, and what it took."""
    import subprocess
    import tempfile

    import numpy as np
    from _bake_checks import known_colours

    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "in.npz"), Path(folder, "out.npz")
        np.savez(
            source,
            vertices=mesh.vertices,
            faces=mesh.faces,
            corner_uv=atlas.uv[atlas.faces_uv],
            dense_vertices=surface.vertices,
            dense_faces=surface.faces,
            dense_colours=known_colours(surface.vertices),
            size=size,
            samples=samples,
        )
        script = Path(__file__).with_name("_blender_bake.py")
        subprocess.run([python, script, source, target], check=True, stdout=subprocess.DEVNULL)
        with np.load(target) as found:
            spent = {"seconds": float(found["seconds"]), "CPU seconds": float(found["cpu"])}
            return np.asarray(found["texture"], np.float64), spent


def write_sheet(maps, path: Path) -> None:
    """Every map as a picture of 512 texels, four in a row."""
    import numpy as np

    from sira_assets.numerics.colour import srgb_from_linear
    from sira_assets.scene.image import write_png

    step = max(1, maps.size // 512)
    small = lambda a: a[::step, ::step][:512, :512]  # noqa: E731
    grey = lambda a: np.repeat(a[..., None], 3, -1)  # noqa: E731
    low, high = maps.position[maps.coverage].min(0), maps.position[maps.coverage].max(0)
    tiles = [
        srgb_from_linear(np.clip(small(maps.diffuse), 0, 1)),
        grey(np.clip(small(maps.specular_f0) / 0.08, 0, 1)),
        0.5 + 0.5 * small(maps.normal_tangent),
        grey(small(maps.occlusion)),
        (small(maps.position) - low) / (high - low),
        srgb_from_linear(np.clip(small(maps.irradiance) / np.quantile(maps.irradiance, 0.99), 0, 1)),
        grey(small(maps.visibility)[..., 0]),
        srgb_from_linear(np.clip(small(maps.radiance) / np.quantile(maps.radiance, 0.99), 0, 1)),
    ]
    rows = [np.concatenate(tiles[k : k + 4], 1) for k in (0, 4)]
    write_png(path, np.round(255 * np.clip(np.concatenate(rows), 0, 1)).astype(np.uint8))


def peak_bytes() -> int:
    """The most memory this process has held."""
    from sira_assets.delivery import peak_memory_bytes

    return peak_memory_bytes()


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    p = parser()
    arguments = p.parse_args(argv)
    if not 64 <= arguments.size <= 8192 or not 1 <= arguments.samples <= 8:
        p.error("--size must be 64 to 8192, --samples 1 to 8")
    return _cli.run(lambda: body(arguments))


if __name__ == "__main__":
    sys.exit(main())
