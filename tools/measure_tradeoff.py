#!/usr/bin/env python3
"""Speed against accuracy: every knob one at a time, and the presets, over scenes with known truth.

Costs are processor seconds as ratios to a reference run in the same process, corrected by a benchmark of the same
moment; accuracy is measured against the scenes' truth and the fitted field. Runs are kept in OUT/runs, one JSON file
each, and stages that a knob does not touch are not run again: the same command goes on where it was stopped.
OUT/index.html has all curves, OUT/runs.csv every run, OUT/figures.json is what `export_avatar.py --budget` plans with.

A planner's times are of the machine that measured them. `--curves FIGURES` measures the reference alone, in some
minutes, and takes the curves from FIGURES (`shipped`: those of the package): a plan for the machine at hand.

Without SCENE, scenes of the generator are made in OUT/scenes (--count, --size, --scene-seed).

    python tools/measure_tradeoff.py --out tradeoff --count 2
    python tools/measure_tradeoff.py --out tradeoff --promises-only --promise 60s --promise 0.5mm
    python tools/measure_tradeoff.py --out tradeoff --promises-only --promise 60s --promise 180s --promise-seeds 2
    python tools/measure_tradeoff.py scenes/a scenes/b --out tradeoff --knob "texture size" --knob triangles
    python tools/measure_tradeoff.py scenes/a scenes/b --base draft --curves shipped --out tradeoff
    python tools/measure_tradeoff.py scenes/c --out tradeoff --knob "geometry steps" --no-presets --all-runs
"""

import argparse
import re
import sys
import time
from pathlib import Path

from _cli import run

PRESETS = ("draft", "standard", "high")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("scenes", nargs="*", type=Path, metavar="SCENE", help="scene folders, with gt/ where there is truth")
    p.add_argument("--out", type=Path, default=Path("tradeoff"), help="folder for everything (default: tradeoff)")
    p.add_argument("--count", type=int, default=2, help="scenes to make where none is named (default 2)")
    p.add_argument("--size", type=int, default=256, help="their width and height (default 256)")
    p.add_argument("--scene-seed", type=int, default=900, help="their seed (default 900)")
    p.add_argument("--base", choices=PRESETS, default="standard", help="what knobs are turned about")
    p.add_argument("--seeds", type=int, default=2, help="seeds of the reference, for the spread (default 2)")
    p.add_argument("--knob", action="append", default=[], metavar="NAME", help="only these; may be said again")
    p.add_argument("--knob-scenes", type=int, metavar="N", help="turn knobs on the first N scenes only")
    p.add_argument("--all-runs", action="store_true", help="report every run kept in OUT, other commands' as well")
    p.add_argument("--curves", type=Path, metavar="FIGURES", help="measure the reference alone, with curves from here")
    p.add_argument("--no-presets", dest="presets", action="store_false", help="leave the presets out")
    p.add_argument("--prior", type=Path, action="append", default=[], help="another prior, such as a wider one")
    p.add_argument(
        "--promise",
        action="append",
        default=[],
        type=promise,
        metavar="TIME|LENGTH",
        help="also see whether --budget TIME (60s) or --tolerance LENGTH (0.5mm) is kept; may be said again",
    )
    p.add_argument(
        "--promise-seeds", type=int, default=1, help="seeds of each promise; 2 show whether time is well spent"
    )
    p.add_argument("--promises-only", action="store_true", help="nothing but the promises")
    p.add_argument("--quick", action="store_true", help="a few tiny runs, to see that it works")
    p.add_argument("--quiet", action="store_true", help="no line for each run")
    return p


def promise(text: str) -> str:
    """`60s` or `0.5mm`, as it is."""
    if not re.fullmatch(r"(\d+(\.\d*)?|\.\d+)(s|mm)", text):
        raise argparse.ArgumentTypeError(f"a time such as 60s or a length such as 0.5mm, not {text!r}")
    return text


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status.

    0; 2 usage; 3 unusable input; 4 where a preset is dominated, a promise not kept, or a longer budget worse.
    """
    p = parser()
    args = p.parse_args(argv)
    args.words = sys.argv[1:] if argv is None else argv
    if args.curves and args.knob:
        p.error("--curves measures no knob: leave out --knob")
    if min(args.count, args.seeds, args.promise_seeds) < 1 or args.size < 32 or (args.knob_scenes or 1) < 1:
        p.error("--count, --seeds, --promise-seeds and --knob-scenes must be at least 1, --size at least 32")
    return run(lambda: body(args))


def body(args: argparse.Namespace) -> int:
    """Make scenes, run, write."""
    import torch
    from _tradeoff_figures import write_csv, write_page
    from _tradeoff_promises import bought, bought_section, promise_runs, promise_section
    from _tradeoff_report import write_report
    from _tradeoff_runs import Sweep, kept_records, sweep_runs

    from sira_assets.fields.prior import load_prior

    args.out.mkdir(parents=True, exist_ok=True)
    if args.quick:
        args.count, args.size, args.seeds = 1, min(args.size, 64), 1
    curves = kept_curves(args.curves)
    scenes = args.scenes or made_scenes(args)
    priors = {"shipped": load_prior(), **{path.stem: load_prior(path) for path in args.prior}}
    turned, presets = (0, False) if curves else (args.knob_scenes, args.presets)
    sweep = Sweep(args.base, args.seeds, tuple(args.knob), turned, presets, args.quick)
    began, records = time.monotonic(), []
    for record, found in () if args.promises_only else sweep_runs(sweep, scenes, priors, args.out):
        records.append(record)
        if not args.quiet:
            done = f"{record.scene} seed {record.seed}: {record.knob} {record.value}"
            figures = "  ".join(f"{n} {v:.3g}" for n, v in record.measures.items())
            print(f"{done:48} {record.seconds():7.1f} CPU s  {figures}{'  (found)' if found else ''}", flush=True)
        write_csv(records, args.out / "runs.csv")
    if args.all_runs:
        records = kept_records(args.out)
        write_csv(records, args.out / "runs.csv")
    kept = []
    for one, found in promise_runs(args.promise, scenes, args.out, args.promise_seeds):
        kept.append(one)
        if not args.quiet:
            came = "refused" if one.kept is None else f"{one.kept:.3g}"
            print(f"{one.scene} seed {one.seed}: {one.promise} asked, {came}{'  (found)' if found else ''}", flush=True)
    steps = bought(kept)
    broken = any(m.worse for m in steps) or not all(k.holds for k in kept)
    for m in steps:
        change = f"{m.change:+.3g} (chance {m.chance:.2g}); at worst {m.worst_change:+.3g} ({m.worst_chance:.2g})"
        if m.worse or not args.quiet:
            line = f"{m.measure}, {m.shorter} to {m.longer}: {change}, {m.worst}{': worse' if m.worse else ''}"
            print(line, file=sys.stderr if m.worse else sys.stdout)
    sections = [promise_section(kept)] if kept else []
    sections += [bought_section(steps)] if steps else []
    if args.promises_only:
        write_page("Budgets and tolerances", "", sections, args.out / "promises.html")
        return 4 if broken else 0
    command = " ".join(["python tools/measure_tradeoff.py", *args.words])
    lost = write_report(records, sweep, command, torch.get_num_threads(), args.out, promises=sections, curves=curves)
    if not args.quiet:
        print(f"{args.out / 'index.html'}  ({len(records)} runs, {time.monotonic() - began:.0f} s)")
    for line in lost:
        print(f"dominated: {line}", file=sys.stderr)
    return 4 if lost or broken else 0


def kept_curves(path: Path | None):
    """The figures whose curves are taken over, or None.

    Raises
    ------
    InputError : no such file, or one that holds something else.
    """
    from sira_assets.plan.figures import read_figures

    return None if path is None else read_figures(None if str(path) == "shipped" else path)


def made_scenes(args: argparse.Namespace) -> list[Path]:
    """Scenes of the generator in OUT/scenes, those that are there already left alone."""
    from data_synth.dataset import write_dataset
    from data_synth.scene_settings import SceneSettings, scene_name

    samples = 32 if args.quick else 64
    settings = SceneSettings(kind="eval", seed=args.scene_seed, views=1, size=args.size, samples=samples)
    folder = args.out / f"scenes-{args.size}"
    write_dataset(folder, settings, range(args.count), workers=1)
    return [folder / scene_name(settings, i) for i in range(args.count)]


if __name__ == "__main__":
    sys.exit(main())
