#!/usr/bin/env python3
"""Measure the single-view fit where the truth is known.

  heldout SCENE...    faces, maps, light, novel views, time by stage (make_scenes.py --kind eval --views 5 makes some)
  pose SCENE...       nine noisy 2D landmarks in place of the given pose
  fairness            the same heads, poses and lights in three skin tones, drawn into --out
  stability SCENE     a sound scene spoilt in every way that users' photos are
  thrift SCENE...     what the fit leaves out, beside the truth, and what that saves and costs
  extremes SCENE      lights, lenses, sizes and masks at the ends of what a photo can be

SCENE is a scene with gt/, or SCENE=TRUTH where the truth stands elsewhere; a folder of scenes stands for all of them.
Figures are kept in --out as they are found: the same command goes on. Seconds are processor time of one process. Exit
status: 0 measured, 3 unusable input, 4 a case ended neither sane nor, of the extremes,
refused, 130 interrupted.
"""

import argparse
import sys
from pathlib import Path

from _cli import run

PARTIAL = 4


def parser() -> argparse.ArgumentParser:
    """The command line."""
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--out", type=Path, default=Path("measured"), metavar="DIR", help="default: measured")
    shared.add_argument("--prior", type=Path, help="trained models (default: the ones that ship with the package)")
    shared.add_argument("--quality", choices=["draft", "standard", "high"], default="standard")
    shared.add_argument("--seed", type=int, default=0)
    shared.add_argument("--table", type=Path, metavar="FILE", help="also write every figure, .json or .csv")
    shared.add_argument("--json", action="store_true", help="print JSON instead of tables")
    shared.add_argument("--quiet", action="store_true", help="no word on stderr")
    out = argparse.ArgumentParser(
        prog="measure_fit.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = out.add_subparsers(dest="what", required=True, metavar="WHAT")
    for name in ("heldout", "pose", "thrift", "stability", "extremes"):
        one = what.add_parser(name, parents=[shared])
        one.add_argument("scenes", nargs=1 if name in ("stability", "extremes") else "+", metavar="SCENE[=TRUTH]")
        if name == "pose":
            one.add_argument("--noise", type=float, default=2.5, metavar="PX", help="of each landmark (default 2.5)")
    fairness = what.add_parser("fairness", parents=[shared])
    fairness.add_argument("--heads", type=int, default=20, help="geometries, each in three tones (default 20)")
    fairness.add_argument("--size", type=int, default=512, help="pixels of the portraits (default 512)")
    fairness.add_argument("--samples", type=int, default=64, help="light directions a sample point (default 64)")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    p = parser()
    arguments = p.parse_args(argv)
    if arguments.seed < 0 or getattr(arguments, "heads", 1) < 1 or getattr(arguments, "noise", 0.0) < 0:
        p.error("--seed and --noise must be at least 0, --heads at least 1")
    return run(lambda: measure(arguments))


def measure(a: argparse.Namespace) -> int:
    """Measure, keep, print."""
    import json

    from _fit_measurement import write_rows

    measures = (heldout, pose, fairness, thrift, stability, extremes)
    rows, show = {measure.__name__: measure for measure in measures}[a.what](a)
    if a.table:
        write_rows(a.table, rows)
    if a.json:
        print(json.dumps(rows, indent=1))
    else:
        show(rows)
    return PARTIAL if any(row.get("sane") is False for row in rows) else 0


def heldout(a: argparse.Namespace):
    """Everything against exact truth."""
    from _measure_heldout import measure_heldout, print_heldout

    return each_scene(a, measure_heldout), print_heldout


def pose(a: argparse.Namespace):
    """Estimated poses beside given ones."""
    from functools import partial

    from _measure_pose import measure_pose, print_pose

    return each_scene(a, partial(measure_pose, noise_px=a.noise), noise=a.noise), print_pose


def fairness(a: argparse.Namespace):
    """By skin tone."""
    from _measure_fairness import measure_tone, print_fairness, write_tones

    options = {"size": a.size, "samples": a.samples, "seed": a.seed}
    say(a, f"scenes of {a.heads} heads in three tones")
    drawn = write_tones(a.out / "tones", range(a.heads), **options)
    a.scenes = [str(folder) for _, _, folder in drawn]
    rows = each_scene(a, measure_tone, drawn=options)
    return [{"head": h, "tone": t} | row for (h, t, _), row in zip(drawn, rows, strict=True)], print_fairness


def thrift(a: argparse.Namespace):
    """As the scene requires, and with everything."""
    from _measure_thrift import measure_thrift, print_thrift

    return each_scene(a, measure_thrift), print_thrift


def stability(a: argparse.Namespace):
    """One scene, spoilt."""
    from _measure_stability import CASES, print_stability

    return each_case(a, CASES), print_stability


def extremes(a: argparse.Namespace):
    """One scene, taken to the ends."""
    from _measure_extremes import CASES, accepted, print_extremes

    return [accepted(row) for row in each_case(a, CASES)], print_extremes


def each_case(a: argparse.Namespace, cases) -> list[dict]:
    """The whole journey on every case of one scene."""
    from _fit_measurement import read_measured_scene, scene_and_truth, scene_facts
    from _measure_stability import measure_case

    pair = scene_and_truth(a.scenes[0])
    scene = read_measured_scene(*pair)
    results, settings, prior = kept(a, scene=scene_facts(*pair))
    rows = []
    for case in cases:
        say(a, case.name)
        name = "".join(c if c.isalnum() else "_" for c in case.name)
        row = results.of(f"{scene.name}-{name}", lambda case=case: measure_case(case, scene, prior(), settings))
        rows.append({"case": case.name} | row)
    return rows


def each_scene(a: argparse.Namespace, figures, **facts) -> list[dict]:
    """`figures(scene, prior, settings)` of every scene of the command line."""
    from _fit_measurement import case_names, read_measured_scene, scene_and_truth, scene_facts

    pairs = [pair for argument in a.scenes for pair in expanded(*scene_and_truth(argument))]
    results, settings, prior = kept(a, **facts)
    rows = []
    for name, (folder, truth) in zip(case_names([folder for folder, _ in pairs]), pairs, strict=True):
        say(a, name)
        found = results.of(
            name,
            lambda f=folder, t=truth: figures(read_measured_scene(f, t), prior(), settings),
            scene=scene_facts(folder, truth),
        )
        rows.append({"scene": name} | found)
    return rows


def expanded(folder: Path, truth: Path) -> list[tuple[Path, Path]]:
    """The scene itself, or every scene in a folder of them."""
    inside = sorted(path.parent for path in folder.glob("*/transforms.json"))
    own = (folder / "transforms.json").exists() or (folder / "cameras.npz").exists() or not inside
    return [(folder, truth)] if own else [(scene, scene) for scene in inside]


def kept(a: argparse.Namespace, **facts):
    """Where the figures are kept, the settings, and the prior once it is asked for."""
    from functools import cache

    from _fit_measurement import SAMPLES, Results, prior_facts

    from sira_assets import pipeline
    from sira_assets.fields.prior import load_prior

    settings = pipeline.settings_for(a.quality, seed=a.seed)
    facts |= {"settings": repr(settings), "prior": prior_facts(a.prior), "samples": SAMPLES}
    return Results(a.out / a.what, facts), settings, cache(lambda: load_prior(a.prior))


def say(a: argparse.Namespace, line: str) -> None:
    """A line of progress."""
    if not a.quiet:
        print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
