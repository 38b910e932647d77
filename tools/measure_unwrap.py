"""Unwrap heads of many sizes and a torture set; with --plain beside xatlas alone on the same meshes.

python tools/measure_unwrap.py --triangles 20000 100000 400000 1000000
python tools/measure_unwrap.py --triangles 20000 100000 --plain 300
python tools/measure_unwrap.py --torture --triangles 20000 --picture atlas.png
"""

import argparse
import json
import sys
from pathlib import Path

import _cli

PLAIN = """
import sys, time, numpy as np, xatlas
data = np.load(sys.argv[1])
started, cpu = time.monotonic(), time.process_time()
vertex, faces, uv = xatlas.parametrize(data["vertices"].astype(np.float32), data["faces"].astype(np.uint32))
np.savez(sys.argv[2], uv=uv, faces=faces, seconds=time.monotonic() - started, cpu=time.process_time() - cpu)
"""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--triangles", type=int, nargs="*", default=[20000], metavar="N", help="sizes of the head (20000)")
    p.add_argument("--torture", action="store_true", help="the torture set too, of the smallest size")
    p.add_argument("--seed", type=int, default=0, help="which generated head (0)")
    p.add_argument("--size", type=int, default=1024, help="texels a side (1024)")
    p.add_argument("--budget", type=float, default=240.0, metavar="S", help="seconds for each (240)")
    p.add_argument("--part", type=int, metavar="F", help="faces unwrapped together at most")
    p.add_argument("--methods", nargs="*", choices=["uvatlas", "xatlas"], help="instead of both in turn; none: boxes")
    p.add_argument("--plain", type=float, metavar="S", help="xatlas alone too, at most so many seconds")
    p.add_argument("--picture", type=Path, metavar="PNG", help="the charts of the last mesh, coloured")
    p.add_argument("--json", action="store_true", help="print JSON")
    return p


def body(arguments: argparse.Namespace) -> int:
    """Unwrap each mesh and print."""
    from dataclasses import replace

    from sira_assets.texture.unwrap import UnwrapConfig

    config = UnwrapConfig(texture_size=arguments.size, budget_s=arguments.budget)
    if arguments.part:
        config = replace(config, part_faces=arguments.part, whole_faces=arguments.part)
    if arguments.methods is not None:
        config = replace(config, methods=tuple(arguments.methods))
    figures, last = {}, None
    for name, vertices, faces in meshes(arguments):
        row, made = measure(vertices, faces, config)
        last = made or last
        figures[name] = row
        if arguments.plain and made:
            figures[f"{name}, xatlas alone"] = measure_plain(made[0], arguments.plain)
        if not arguments.json:
            for label in [key for key in figures if key.startswith(name)]:
                print(f"{label}: ", end="")
                print(
                    ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in figures[label].items())
                )
                sys.stdout.flush()
            del figures[name]
            figures.pop(f"{name}, xatlas alone", None)
    if arguments.json:
        print(json.dumps(figures, indent=1))
    if arguments.picture and last:
        draw(last[1], arguments.picture)
    return 0


def meshes(arguments: argparse.Namespace):
    """Yield (name, vertices, faces) of the heads and the torture set."""
    import numpy as np

    from data_synth.head.build import build_head
    from data_synth.portraits import random_params

    head = build_head(random_params(arguments.seed, 0))
    for count in arguments.triangles:
        mesh = of_size(head.vertices_m, head.faces, count)
        yield f"head of {len(mesh.faces)}", mesh.vertices, mesh.faces
    if arguments.torture:
        mesh = of_size(head.vertices_m, head.faces, min(arguments.triangles, default=20000))
        rng = np.random.default_rng(0)
        yield from ((name, *arrays) for name, arrays in torture(mesh, rng))


def of_size(vertices, faces, count: int):
    """The head with about `count` triangles, halved first where it has fewer."""
    from sira_assets.mesh.simplify import simplify_mesh
    from sira_assets.mesh.triangle_mesh import TriangleMesh

    while len(faces) < 0.95 * count:
        import trimesh

        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    mesh = TriangleMesh(vertices, faces)
    return mesh if len(faces) <= 1.05 * count else simplify_mesh(mesh, count)


def torture(mesh, rng):
    """Yield (name, (vertices, faces)) of meshes that unwrappers fail on."""
    import numpy as np

    v, f = mesh.vertices, mesh.faces
    some = rng.choice(len(f), len(f) // 20, replace=False)
    fins = np.column_stack([f[some, 0], f[some, 1], len(v) + np.arange(len(some))])
    yield "non-manifold (a fin on 5 % of the faces)", (np.vstack([v, v[f[some, 0]] + 0.01]), np.vstack([f, fins]))
    yield "duplicates (10 %, half of them reversed)", (v, np.vstack([f, f[some], f[some][:, ::-1]]))
    a, b, c = (v[f[some, k]] for k in range(3))
    new = len(v) + np.arange(len(some))
    thin = np.vstack(
        [
            np.column_stack([f[some, 0], f[some, 1], new]),
            np.column_stack([new, f[some, 1], f[some, 2]]),
            np.column_stack([f[some, 0], new, f[some, 2]]),
        ]
    )
    yield (
        "slivers (5 % split at 1e-5 of an edge)",
        (np.vstack([v, a + 1e-5 * (b - a) + 1e-7 * (c - a)]), np.vstack([np.delete(f, some, 0), thin])),
    )
    broken = v.copy()
    broken[len(v) // 2] = np.inf
    yield "an infinite vertex", (broken, f)
    yield "scale 1e-7", (1e-7 * v, f)
    yield "scale 1e6", (1e6 * v, f)
    yield "soup (no vertex shared)", (v[f].reshape(-1, 3), np.arange(3 * len(f)).reshape(-1, 3))
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2)
    at = rng.uniform(-1, 1, (500, 3))
    parts = ball.vertices * 0.03 + at[:, None], ball.faces + len(ball.vertices) * np.arange(500)[:, None, None]
    yield "500 components", tuple(part.reshape(-1, 3) for part in parts)
    yield (
        "random tangle of 3000",
        (rng.standard_normal((400, 3)), np.array([rng.choice(400, 3, replace=False) for _ in range(3000)])),
    )
    yield "no faces", (v, np.zeros((0, 3), int))


def measure(vertices, faces, config) -> tuple[dict, tuple | None]:
    """Figures of one unwrap, and (mesh, atlas); the error where the input is no mesh."""
    import resource
    import time
    from dataclasses import asdict

    from sira_assets.errors import InputError
    from sira_assets.mesh.triangle_mesh import TriangleMesh
    from sira_assets.texture.unwrap import unwrap

    def spent() -> float:
        child = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + child.ru_utime + child.ru_stime

    before = spent()
    try:
        mesh = TriangleMesh(vertices, faces)
        atlas = unwrap(mesh, config)
    except InputError as error:
        return {"error": str(error)}, None
    row = asdict(atlas.report) | {
        "CPU seconds": spent() - before,
        "least uv": float(atlas.uv.min()),
        "greatest uv": float(atlas.uv.max()),
    }
    return row, (mesh, atlas)


def measure_plain(mesh, seconds: float) -> dict:
    """The same figures of `xatlas.parametrize` with nothing done before."""
    import subprocess
    import tempfile

    import numpy as np

    from sira_assets.texture.atlas import measure_atlas

    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "in.npz"), Path(folder, "out.npz")
        np.savez(source, vertices=mesh.vertices, faces=mesh.faces)
        try:
            done = subprocess.run([sys.executable, "-c", PLAIN, source, target], timeout=seconds, check=False)
        except subprocess.TimeoutExpired:
            return {"error": f"not done within {seconds:g} s"}
        if done.returncode:
            return {"error": f"ended with code {done.returncode}"}
        with np.load(target) as found:
            uv, faces_uv = found["uv"].astype(np.float64), found["faces"].astype(np.int64)
            spent, cpu = float(found["seconds"]), float(found["cpu"])
    if not np.isfinite(uv).all() or len(faces_uv) != len(mesh.faces):
        return {"error": f"{int((~np.isfinite(uv)).sum())} coordinates not finite, {len(faces_uv)} faces"}
    said = {"method": "xatlas", "attempts": (), "padding_texels": 0.0, "predicted_s": 0.0}
    report = measure_atlas(mesh, uv, faces_uv, texture_size=1024, seconds=spent, **said)
    names = ("charts", "utilisation", "seconds", "stretch", "stretch_95", "sliver_share", "overlapping")
    return {name: getattr(report, name) for name in names} | {"CPU seconds": cpu}


def draw(atlas, path: Path) -> None:
    """Every chart in a colour of its own."""
    import numpy as np

    from sira_assets.scene.image import write_png
    from sira_assets.texture.atlas import chart_labels
    from sira_assets.texture.raster import rasterise

    size = 1024
    found = rasterise(atlas.uv, atlas.faces_uv, size, samples=1, first_row=0, last_row=size)
    chart = chart_labels(atlas.faces_uv, len(atlas.uv))[atlas.faces_uv[found.face, 0]]
    colours = np.random.default_rng(0).integers(60, 256, (int(chart.max()) + 1, 3), dtype=np.uint8)
    picture = np.zeros((size * size, 3), np.uint8)
    picture[found.texel] = colours[chart]
    write_png(path, picture.reshape(size, size, 3))


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    return _cli.run(lambda: body(arguments))


if __name__ == "__main__":
    sys.exit(main())
