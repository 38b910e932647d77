#!/usr/bin/env python3
"""How well the generator's shape space represents a scan: fit its parameters to known geometry and print what is left.

HEAD is a folder with mesh.ply and landmarks.json (the canonical nine under landmarks_m). Parameters are the identity,
the named shape and the relief, each held within three standard deviations; the head is placed by its own landmarks,
without a pose or scale of its own. Printed, in millimetres of the scan:

  face     mean distance from the scan's outer surface within 95 mm of the nose tip to the generated surface
  p95      95th percentile of the same
  open     the same with rays let out through the mesh's own openings, which counts the mouth bag of a bust that is
           open below; in brackets what the scan's outer surface itself scores there
  mean     what the mean head scores
  theta    largest and root-mean-square parameter in standard deviations, and how many stand at their bound

Then, region by region, the surface variation that the landmarks do not say: root mean square along the normal of what
named shape and relief add to the landmarks' smooth warp, in random heads and in the fitted ones, and its odd part over
its even part (asymmetry).

Exit status: 0 fitted, 3 unusable input, 4 a head's face is farther than --most.
"""

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from _cli import run


@dataclass(frozen=True)
class HeadFigures:
    """One head; lengths in millimetres of the scan."""

    head: str
    face_mm: float
    face_p95_mm: float
    open_mm: float
    open_floor_mm: float
    mean_head_mm: float
    largest_theta: float
    largest_name: str
    rms_theta: float
    at_bound: int


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="fit_generator.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("heads", type=Path, nargs="+", metavar="HEAD", help="folder with mesh.ply and landmarks.json")
    out.add_argument("--samples", type=int, default=60_000, metavar="N", help="points on each scan (default 60000)")
    out.add_argument("--random", type=int, default=40, metavar="N", help="random heads to set beside (default 40)")
    out.add_argument("--most", type=float, metavar="MM", help="exit 4 if a face distance exceeds this")
    out.add_argument("--meshes", type=Path, metavar="DIR", help="write the fitted heads here (PLY, canonical frame)")
    out.add_argument("--json", action="store_true", help="print JSON instead of tables")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    if arguments.samples < 1000 or arguments.random < 2:
        parser().error("--samples must be at least 1000 and --random at least 2")
    return run(lambda: fit_heads(arguments))


def fit_heads(arguments: argparse.Namespace) -> int:
    """Fit each head, print its line, then the variation between landmarks.

    Raises
    ------
    InputError : two heads would be written to one file.
    """
    import numpy as np
    from _generator_fit import between_landmarks, random_between, region_table

    from sira_assets.errors import InputError

    names = [folder.resolve().name for folder in arguments.heads]
    twice = sorted({name for name in names if names.count(name) > 1})
    if arguments.meshes and twice:
        raise InputError(
            expected="heads in folders of different names with --meshes, which calls each head's file after its folder",
            received=f"several called {', '.join(twice)}",
            remedy="rename them, or fit them in runs with another --meshes",
        )
    figures, fitted = [], []
    for folder in arguments.heads:
        f, fit = fit_head(folder, arguments.samples)
        figures.append(f)
        fitted.append(fit)
        if arguments.meshes:
            write_mesh(arguments.meshes / f"{f.head}.ply", fit.mesh)
        if not arguments.json:
            if len(figures) == 1:
                print(f"{'head':<12}{'face':>8}{'p95':>8}{'open':>16}{'mean':>8}   theta: largest, rms, at bound")
            print(
                f"{f.head:<12}{f.face_mm:>8.3f}{f.face_p95_mm:>8.3f}{f.open_mm:>8.3f} ({f.open_floor_mm:.3f})"
                f"{f.mean_head_mm:>8.3f}   {f.largest_theta:+.2f} {f.largest_name}, {f.rms_theta:.2f}, {f.at_bound}",
                flush=True,
            )
    table = region_table(random_between(arguments.random), [between_landmarks(f.params) for f in fitted])
    if arguments.json:
        print(json.dumps({"heads": [asdict(f) for f in figures], "between_landmarks_mm": table}, indent=1))
    else:
        print(f"\n{'region':<12}{'random':>8}" + "".join(f"{f.head:>10}" for f in figures))
        for name, values in table.items():
            print(f"{name:<12}{values[0]:>8.2f}" + "".join(f"{v:>10.2f}" for v in values[1:]))
    worst = float(np.max([f.face_mm for f in figures]))
    return 4 if arguments.most is not None and worst > arguments.most else 0


def fit_head(folder: Path, samples: int):
    """Figures of one head and its `Fit`.

    Raises
    ------
    InputError : no mesh or no landmarks.
    """
    import numpy as np
    from _generator_fit import FACE_RADIUS_M, PARAMETER_NAMES, FitConfig, fit_scan, head_mesh, limits, read_head

    from data_synth.head.params import mean_params
    from sira_assets.measure.outer_surface import OuterSurfaceConfig, outer_surface
    from sira_assets.measure.surface import Surface, sample_surface

    head = read_head(folder)
    scan, mm = head.mesh, head.mm

    def face_samples(mesh):
        points = sample_surface(mesh, samples, seed=0).points
        return points[np.linalg.norm(points - head.nose_tip, axis=1) < 1e3 * FACE_RADIUS_M / mm]

    outer = outer_surface(scan)
    # 96 directions of which 3 leave, and openings not closed: the outer surface of the data set's own scorer
    open_outer = outer_surface(scan, OuterSurfaceConfig(directions=96, needed=3, close_openings=False))
    face, open_face = face_samples(outer), face_samples(open_outer)
    # stratified samples come in the order of the faces
    fit = fit_scan(np.random.default_rng(0).permutation(face), head.nine, FitConfig())
    surface, mean_surface = Surface(fit.mesh), Surface(head_mesh(mean_params()))
    left = surface.distance(face) * mm
    largest = int(np.abs(fit.theta).argmax())
    bound = limits()
    return HeadFigures(
        head=head.name,
        face_mm=float(left.mean()),
        face_p95_mm=float(np.quantile(left, 0.95)),
        open_mm=float(surface.distance(open_face).mean() * mm),
        open_floor_mm=float(Surface(outer).distance(open_face).mean() * mm),
        mean_head_mm=float(mean_surface.distance(face).mean() * mm),
        largest_theta=float(fit.theta[largest]),
        largest_name=PARAMETER_NAMES[largest],
        rms_theta=float(np.sqrt((fit.theta**2).mean())),
        at_bound=int(((fit.theta <= bound[:, 0]) & (bound[:, 0] < 0) | (fit.theta >= bound[:, 1])).sum()),
    ), fit


def write_mesh(path: Path, mesh) -> None:
    """Write a PLY through a temporary file."""
    import trimesh

    from sira_assets.atomic import write_bytes

    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="ply"))


if __name__ == "__main__":
    sys.exit(main())
