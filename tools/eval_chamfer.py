#!/usr/bin/env python3
"""Surface distance in millimetres between a predicted and a true head, by a named protocol.

Reads any mesh file trimesh reads (PLY, OBJ, GLB, STL, OFF), an avatar folder, a scene folder or a head folder. A scene
brings its landmarks, camera and canonical frame along. Exit status: 0 measured, 3 unusable input, 4 measured but the
alignment failed (the figures are printed, with the reason).
"""

import argparse
import sys

from _cli import run

UNITS = ("m", "dm", "cm", "mm", "um", "in", "ft")
ALIGNMENT_FAILED = 4


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="eval_chamfer.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("pred", metavar="PRED", help="the predicted mesh")
    out.add_argument("gt", metavar="GT", help="the true mesh")
    out.add_argument("--protocol", choices=("surface", "h3ds", "now"), default="surface", help="default: surface")
    out.add_argument("--region", choices=("face", "head", "all"), help="print this one only (default: all known)")
    out.add_argument(
        "--align",
        choices=("none", "rigid", "similarity"),
        help="default: none for surface, similarity for h3ds and now",
    )
    out.add_argument(
        "--landmarks",
        metavar="FILE",
        help='JSON {"gt": {"nose_tip": [x, y, z], ...}, "pred": {...}}, or the truth\'s alone; those of the prediction '
        "start the alignment (default: what lies beside GT and PRED)",
    )
    out.add_argument(
        "--pred-frame",
        choices=("world", "canonical"),
        default="world",
        help="canonical: PRED stands in the canonical head frame; the scene's canonical_from_world places it",
    )
    out.add_argument("--units-pred", choices=UNITS, help="default: m, or what the scene GT says for world coordinates")
    out.add_argument("--units-gt", choices=UNITS, help="default: what the scene says, else m")
    out.add_argument("--samples", type=int, default=60_000, help="points per surface (default: 60000)")
    out.add_argument("--seed", type=int, default=0)
    out.add_argument("--keep-inner", action="store_true", help="count mouth bags, sockets and the like")
    out.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return out


def main(argv: list[str] | None = None) -> int:
    """Parse, measure, print; gives the exit status."""
    arguments = parser().parse_args(argv)
    if arguments.samples < 1 or arguments.seed < 0:
        parser().error("--samples must be at least 1 and --seed at least 0")
    return run(lambda: _measure(arguments))


def _measure(a: argparse.Namespace) -> int:
    import numpy as np

    from sira_assets.errors import InputError
    from sira_assets.measure.present import surface_json, surface_table
    from sira_assets.measure.protocols import ProtocolConfig, measure_surface
    from sira_assets.measure.truth import METRES_PER, landmarks_beside, read_landmarks, read_mesh, read_truth

    truth = read_truth(a.gt, metres_per_unit=METRES_PER[a.units_gt] if a.units_gt else None, landmarks=a.landmarks)
    known = {"face": "nose_tip" in truth.landmarks, "head": truth.canonical_from_world is not None}
    if a.protocol != "now" and not known.get(a.region, True):
        needs = "a nose tip" if a.region == "face" else "a canonical frame"
        raise InputError(
            expected=f"{needs} of the truth for --region {a.region}",
            received="a truth without landmarks",
            remedy="give --landmarks, or --region all",
        )
    canonical = a.pred_frame == "canonical"
    unit = METRES_PER[a.units_pred] if a.units_pred else 1.0 if canonical else truth.metres_per_unit
    pred = read_mesh(a.pred, metres_per_unit=unit)
    source = a.landmarks or landmarks_beside(a.pred)
    marks = read_landmarks(source, metres_per_unit=unit, of="pred" if a.landmarks else "gt") if source else {}
    if canonical:
        if truth.canonical_from_world is None:
            raise InputError(
                expected="a truth with canonical_from_world or landmarks, for --pred-frame canonical",
                received="neither",
                remedy="name a scene folder as GT, or give --landmarks",
            )
        world_from_canonical = np.linalg.inv(truth.canonical_from_world)
        pred = pred.transformed(world_from_canonical)
        marks = {name: world_from_canonical[:3, :3] @ x + world_from_canonical[:3, 3] for name, x in marks.items()}
    config = ProtocolConfig(a.protocol, a.align, a.samples, a.seed, not a.keep_inner)
    report = measure_surface(pred, truth, config, pred_landmarks=marks)
    if a.json:
        print(surface_json(report, region=a.region))
    else:
        from rich.console import Console

        Console().print(surface_table(report, region=a.region))
    for problem in report.alignment.problems:
        print(f"alignment failed: {problem}", file=sys.stderr)
    return 0 if report.alignment.ok else ALIGNMENT_FAILED


if __name__ == "__main__":
    sys.exit(main())
