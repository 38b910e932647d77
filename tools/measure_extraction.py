#!/usr/bin/env python3
"""Measure extraction: error against cell, field evaluations and seconds against a dense grid, tolerance against truth.

Fields: an analytic sphere and ellipsoid, the generator's bald head, the mean head of the trained models. Distances are
two-sided, mesh to zero set and back (millimetres). Order: 2 where halving the cell quarters the mean distance.
Evaluations count every point at which the field is asked, gradients among them, from the coarsest cell to the normals.
"""

import argparse
import json
import sys
from pathlib import Path

from _cli import run

FIELDS = ("sphere", "ellipsoid", "generator", "network")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="measure_extraction.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("--fields", nargs="+", choices=FIELDS, default=list(FIELDS))
    out.add_argument("--cells", nargs="*", type=float, default=[8.0, 4.0, 2.0], metavar="MM", help="for the order")
    out.add_argument("--resolution", type=int, default=512, metavar="N", help="dense N^3 grid to compare with (512)")
    out.add_argument("--tolerances", nargs="*", type=float, default=[0.5, 0.1], metavar="MM")
    out.add_argument("--simplify", action="store_true", help="also simplify to each tolerance, as the exporter does")
    out.add_argument("--prior", type=Path, help="trained models (default: the ones that ship with the package)")
    out.add_argument("--json", action="store_true", help="print JSON instead of tables")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    p = parser()
    arguments = p.parse_args(argv)
    if arguments.resolution and not 32 <= arguments.resolution <= 1024:
        p.error("--resolution must be 0 (leave out) or 32 to 1024")
    if any(not 0.5 <= cell <= 20.0 for cell in arguments.cells):
        p.error("--cells must be 0.5 to 20")
    return run(lambda: body(arguments))


def body(arguments: argparse.Namespace) -> int:
    """Measure every field and print."""
    figures: dict[str, dict[str, list[dict]]] = {}
    for name in arguments.fields:
        field = make_field(name, arguments.prior)
        figures[name] = {"convergence": [], "sparse": [], "tolerance": []}
        for part, row in measure(field, arguments):
            figures[name][part].append(row)
            if not arguments.json:
                print(f"{name:<10}", *(f"{key} {_short(value)}" for key, value in row.items()), sep="  ", flush=True)
    if arguments.json:
        print(json.dumps(figures, indent=1))
    return 0


def measure(field, arguments: argparse.Namespace):
    """All rows of one field as they are found, each with the part it belongs to."""
    last = None
    for cell in arguments.cells:
        last = convergence(field, cell, last)
        yield "convergence", last
    if arguments.resolution:
        yield "sparse", sparse(field, arguments.resolution)
    for asked in arguments.tolerances:
        yield "tolerance", tolerance(field, asked, simplify=arguments.simplify)


def _short(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def make_field(name: str, prior: Path | None):
    """One of `FIELDS`, a `HeadField`'s signed distance."""
    import torch

    from sira_assets.fields.analytic import EllipsoidHead, SphereHead

    if name == "sphere":
        return SphereHead()
    if name == "ellipsoid":
        return EllipsoidHead()
    if name == "generator":
        from data_synth.head.template import load_template, template_field

        class GeneratorHead:
            """The generator's template: bald, smooth, exact at any resolution."""

            template = load_template()

            def sdf(self, x):
                return 1e-3 * template_field(self.template, 1e3 * x)

        return GeneratorHead()
    from sira_assets.fields.fitted import FittedHead
    from sira_assets.fields.prior import load_prior

    models = load_prior(prior)
    z_sdf = models.z_sdf.code(torch.zeros(models.z_sdf.basis.shape[1]))
    return FittedHead(models.shape, models.appearance, z_sdf, models.z_a.mean, models.z_s.mean)


def convergence(field, cell_mm: float, last: dict | None) -> dict:
    """Two-sided distances at a cell, and the order since the last one."""
    import numpy as np

    from sira_assets.mesh.extract import ExtractConfig, extract_mesh
    from sira_assets.mesh.field_distance import field_distance

    gap = field_distance(field, extract_mesh(field, ExtractConfig(cell_m=1e-3 * cell_mm)), samples=20_000)
    mean = 1e3 * max(gap.mean_there, gap.mean_back)
    row = {"cell_mm": cell_mm, "mean_mm": mean, "max_mm": 1e3 * gap.greatest}
    if last:
        row["order"] = float(np.log(last["mean_mm"] / mean) / np.log(last["cell_mm"] / cell_mm))
    return row


def sparse(field, resolution: int) -> dict:
    """Cost at the cell of which the head's box holds resolution^3, and what came out."""
    import time

    import numpy as np
    import torch

    from sira_assets.fields.head_field import BOUNDS_M
    from sira_assets.mesh.clean import clean_mesh
    from sira_assets.mesh.extract import ExtractConfig, extract_with_report
    from sira_assets.mesh.topology import topology

    cell = float(np.cbrt(np.prod(BOUNDS_M[1] - BOUNDS_M[0])) / resolution)
    wall, cpu = time.perf_counter(), time.process_time()
    mesh, report = extract_with_report(field, ExtractConfig(cell_m=cell))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    shape, exported = topology(mesh), topology(clean_mesh(mesh))
    return {
        "cell_mm": 1e3 * cell,
        "evaluations": report.evaluations,
        "gradients": report.gradients,
        "fewer_than_dense": resolution**3 / report.evaluations,
        "steepest_slope": report.slope,
        "seconds": wall,
        "cpu_seconds": cpu,
        "threads": torch.get_num_threads(),
        "triangles": len(mesh.faces),
        "watertight": shape.watertight,
        "pieces": shape.pieces,
        "genus": shape.genus,
        "zero_area_faces": shape.zero_area_faces,
        "cleaned_pieces": exported.pieces,
        "cleaned_genus": exported.genus,
    }


def tolerance(field, tolerance_mm: float, *, simplify: bool) -> dict:
    """What a tolerance gives: of the surface alone, or of the mesh that is exported."""
    from sira_assets.mesh.asset_mesh import EXTRACT_SHARE, asset_mesh
    from sira_assets.mesh.clean import clean_mesh
    from sira_assets.mesh.extract import ExtractConfig, extract_with_report
    from sira_assets.mesh.field_distance import field_distance
    from sira_assets.mesh.topology import topology

    asked = EXTRACT_SHARE * tolerance_mm if simplify else tolerance_mm
    mesh, report = extract_with_report(field, ExtractConfig(tolerance_mm=asked))
    if simplify:
        mesh = asset_mesh(clean_mesh(mesh), 0, tolerance_mm)
    gap = field_distance(field, mesh, seed=1)
    return {
        "asked_mm": tolerance_mm,
        "max_mm": 1e3 * gap.greatest,
        "mean_mm": 1e3 * max(gap.mean_there, gap.mean_back),
        "triangles": len(mesh.faces),
        "cell_mm": 1e3 * report.cell_m,
        "evaluations": report.evaluations,
        "split_vertices": report.split_vertices,
        "lost_faces": report.lost_faces,
        "watertight": topology(mesh).watertight,
    }


if __name__ == "__main__":
    sys.exit(main())
