#!/usr/bin/env python3
"""The paper's ablations over a set of scenes: trains the priors they need, fits, scores, prints its table beside ours.

python tools/make_scenes.py --count 240 --truth train --out train
python tools/run_ablations.py --train train --out ablations SCENE... [SCENE=TRUTH...]

Three extra priors are trained on the same scenes with one stated budget of steps; every fit is at draft quality, with
one seed. Everything is kept in --out as it is done: the same command goes on. A scene is a folder with truth (gt/); one
whose truth stands elsewhere is SCENE=TRUTH. Exit status: 0 done, 3 unusable input, 130 interrupted.
"""

import argparse
import sys
from pathlib import Path

from _cli import run

ROWS = ("a.1", "a.2", "a.3", "a.4", "b.1", "b.2", "b.3")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="run_ablations.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("scenes", nargs="+", metavar="SCENE[=TRUTH]", help="scenes to fit and score")
    out.add_argument("--train", type=Path, required=True, metavar="DIR", help="generated scenes to train on")
    out.add_argument("--out", type=Path, default=Path("ablations"), metavar="DIR", help="default: ablations")
    out.add_argument("--steps", type=int, default=4000, help="of SA-SM, for every prior (default 4000)")
    out.add_argument("--appearance-steps", type=int, default=1000, help="of AF-SM, b's prior only (default 1000)")
    out.add_argument("--samples", type=Path, metavar="DIR", help="keep the training samples here (default: OUT/priors)")
    out.add_argument("--workers", type=int, default=2, help="processes that draw samples (default 2)")
    out.add_argument("--only", nargs="+", choices=ROWS, default=ROWS, help="rows to run (default: all)")
    out.add_argument("--priors-only", action="store_true", help="train, and stop there")
    out.add_argument("--seed", type=int, default=0)
    out.add_argument("--table", type=Path, metavar="FILE", help="also write every figure, .json or .csv")
    out.add_argument("--json", action="store_true", help="print JSON instead of the tables")
    out.add_argument("--quiet", action="store_true", help="no word on stderr")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    p = parser()
    arguments = p.parse_args(argv)
    if arguments.steps < 1 or arguments.appearance_steps < 1 or arguments.seed < 0:
        p.error("--steps and --appearance-steps must be at least 1, --seed at least 0")
    return run(lambda: ablate(arguments))


def ablate(a: argparse.Namespace) -> int:
    """Train, fit, score, print."""
    import _fit_measurement as measurement
    from _ablations import ABLATIONS

    rows = [row for row in ABLATIONS if row.name in a.only]
    shapes = {row.prior for row in rows} | ({"full"} if any(not row.of_shape for row in rows) else set())
    priors = {name: trained(a, name) for name in sorted(shapes)}
    if a.priors_only:
        return 0
    figures, pairs = [], [measurement.scene_and_truth(argument) for argument in a.scenes]
    for name, pair in zip(measurement.case_names([folder for folder, _ in pairs]), pairs, strict=True):
        figures += score_scene(a, rows, priors, name, *pair)
    if a.table:
        measurement.write_rows(a.table, figures)
    if a.json:
        import json

        print(json.dumps(figures, indent=1))
    else:
        print_tables(rows, figures)
    return 0


def trained(a: argparse.Namespace, name: str) -> Path:
    """The prior of that name, these settings and these scenes, trained if it is not there, gone on with if begun."""
    import time
    from dataclasses import replace

    from _ablations import shape_models

    from sira_assets.train.loop import digest
    from sira_assets.train.prior import PriorConfig, train_prior
    from sira_assets.train.scenes import scenes_digest

    base = PriorConfig()
    # A shape that is fitted without appearance needs no AF-SM: its first weights go into the file.
    appearance_steps = a.appearance_steps if name == "full" else 0
    # The share of its steps in which the reference learns alone stays what it is in the full training.
    alone = max(1, round(base.shape.reference_steps * a.steps / base.shape.steps))
    config = replace(
        base,
        shape_model=shape_models(base.shape_model)[name],
        shape=replace(base.shape, steps=a.steps, reference_steps=alone, seed=a.seed),
        appearance=replace(base.appearance, steps=appearance_steps, seed=a.seed),
    )
    folder, key = a.out / "priors", f"{name}-{digest(config, scenes_digest([a.train]))}"
    path = folder / f"{key}.safetensors"
    if path.is_file():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    say(a, f"training the prior '{name}': {a.steps} steps")
    started = time.process_time()
    shared = {"stacks": a.samples or folder, "workers": a.workers}
    train_prior([a.train], path, folder / f"{key}-run", config=config, resume=True, **shared)
    say(a, f"  {time.process_time() - started:.0f} s of processor time in this session")
    return path


def score_scene(
    a: argparse.Namespace, rows, priors: dict[str, Path], name: str, folder: Path, truth: Path
) -> list[dict]:
    """Every row's figures of one scene, kept under `name`; fits are made once and shared by rows that begin alike."""
    from functools import cache

    import _fit_measurement as measurement

    from sira_assets.fields.prior import load_prior

    @cache
    def scene():
        return measurement.read_measured_scene(folder, truth)

    @cache
    def prior(name: str):
        return load_prior(priors[name])

    @cache
    def shape(name: str, settings):
        return measurement.fit_shape(scene().portrait, prior(name), settings)

    def figures(row) -> dict:
        settings = row.settings(a.seed)
        if row.of_shape:
            found = shape(row.prior, settings)
            errors = measurement.face_errors(found, scene())
            return errors | {"seconds": sum(found.seconds.values()), "warnings": len(found.geometry.warnings)}
        # b's rows differ in their appearance alone; the shape is a.4's, to the bit.
        found = shape(row.prior, shape_settings)
        appearance, seconds = measurement.fit_material(found, row.starting(prior(row.prior), a.seed), settings)
        scores = measurement.picture_scores(found, appearance, scene())
        return scores | {"seconds": seconds["appearance"], "warnings": len(appearance.warnings)}

    from sira_assets.pipeline import settings_for

    shape_settings = settings_for("draft", seed=a.seed)
    out = []
    for row in rows:
        facts = {"settings": repr(row.settings(a.seed)), "prior": measurement.prior_facts(priors[row.prior])}
        facts |= {"scene": measurement.scene_facts(folder, truth), "samples": measurement.SAMPLES}
        say(a, f"{name} {row.name}")
        kept = measurement.Results(a.out / "figures" / name, facts).of(row.name, lambda row=row: figures(row))
        out.append({"scene": name, "row": row.name} | kept)
    return out


def print_tables(rows, figures: list[dict]) -> None:
    """The paper's two tables, ours beside it, and each scene's figure."""
    from _fit_measurement import mean_of, print_table

    scenes = list(dict.fromkeys(row["scene"] for row in figures))

    def of(row) -> list[dict]:
        return [f for f in figures if f["row"] == row.name]

    shapes, materials = [r for r in rows if r.of_shape], [r for r in rows if not r.of_shape]
    if shapes:
        print("face, mean of true surface to fit, mm; the paper's on its own data")
        columns = ["", "paper", "placed", "after ICP", "seen", "unseen", "CPU s", *scenes]
        names = ("placed", "after_icp", "seen", "unseen", "seconds")
        print_table(columns, [
            [f"{r.name} {r.says}", r.paper.get("face"), *(mean_of(of(r), n) for n in names)]
            + [next((f.get("placed") for f in of(r) if f["scene"] == s), None) for s in scenes]
            for r in shapes
        ])  # fmt: skip
    seconds = lambda row: mean_of(of(row), "seconds")  # noqa: E731
    if materials:
        print("\nPSNR, dB: final sRGB, diffuse linear after one gain, specular ks, relit sRGB after one gain")
        names = ("final", "diffuse", "specular", "relit")
        columns = ["", *(f"{n} {who}" for n in names for who in ("paper", "ours")), "CPU s"]
        print_table(columns, [
            [f"{r.name} {r.says}", *(v for n in names for v in (r.paper.get(n), mean_of(of(r), n))), seconds(r)]
            for r in materials
        ])  # fmt: skip


def say(a: argparse.Namespace, line: str) -> None:
    """A line of progress."""
    if not a.quiet:
        print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
