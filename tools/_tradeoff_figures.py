"""From measured runs to curves, tables and one page.

Notation: a record is one run: its scene, seed, what was changed, its stages and its measures. Costs are processor
seconds beside the benchmark of the same moment, over those of the reference run of the same scene and seed.
"""

import base64
import csv
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

REFERENCE = "reference"
# Imports, reading and the benchmark: the same for all, so no ratio counts it.
START = "start"


@dataclass(frozen=True)
class Record:
    """One run.

    Parameters
    ----------
    knob, value : what was changed; `reference`, or `preset`, has a knob of that name
    stages : name -> (processor seconds, wall-clock seconds, bytes at the peak)
    benchmark : processor seconds of the three pieces of work, at that moment
    measures : name -> value
    as_reference : stages that were not run, for the setting does not reach them
    """

    scene: str
    seed: int
    knob: str
    value: object
    stages: dict[str, tuple[float, float, int]]
    benchmark: dict[str, float]
    measures: dict[str, float]
    as_reference: tuple[str, ...] = ()

    def seconds(self, stage: str | None = None) -> float:
        """Processor seconds of a stage, or of all."""
        return self.stages[stage][0] if stage else sum(s[0] for s in self.stages.values())


@dataclass(frozen=True)
class Setting:
    """All runs of one value, beside their references.

    Parameters
    ----------
    ratio, wall_ratio : of all stages together, means over scenes and seeds
    stage_ratios : by stage
    deltas, spread : measure -> how much worse than the reference (negative is better), median over scenes and seeds,
        and its standard deviation
    """

    knob: str
    value: object
    ratio: float
    wall_ratio: float
    stage_ratios: dict[str, float]
    deltas: dict[str, float]
    spread: dict[str, float]
    memory_bytes: int
    runs: int


def compared(records: Sequence[Record]) -> list[Setting]:
    """Every value of every knob beside the references, in the order they were measured."""
    from sira_assets.plan.figures import WORTH, Benchmark
    from sira_assets.plan.machine import speed

    references = {(r.scene, r.seed): r for r in records if r.knob == REFERENCE}
    groups: dict[tuple[str, object], list[Record]] = {}
    for r in records:
        if (r.scene, r.seed) in references:
            groups.setdefault((r.knob, r.value), []).append(r)
    out = []
    for (knob, value), runs in groups.items():
        beside = [references[r.scene, r.seed] for r in runs]
        total, wall, by_stage = [], [], {}
        for r, ref in zip(runs, beside, strict=True):
            here, there = Benchmark(**r.benchmark), Benchmark(**ref.benchmark)
            stages = [s for s in ref.stages if s != START]
            # A stage that a setting does without costs nothing.
            took = {s: ref.stages[s] if s in r.as_reference else r.stages.get(s, (0.0, 0.0, 0)) for s in stages}
            # A stage that was found has the reference's own figures, of the reference's own moment.
            scaled = {s: took[s][0] / (1.0 if took[s] == ref.stages[s] else speed(s, here, there)) for s in stages}
            total.append(sum(scaled.values()) / sum(ref.seconds(s) for s in stages))
            wall.append(sum(t[1] for t in took.values()) / sum(ref.stages[s][1] for s in stages))
            for s in scaled:
                by_stage.setdefault(s, []).append(scaled[s] / max(ref.seconds(s), 1e-9))
        names = [
            n for n in WORTH if all(n in r.measures and n in b.measures for r, b in zip(runs, beside, strict=True))
        ]
        sign = {n: 1.0 if WORTH[n] > 0 else -1.0 for n in names}
        deltas = {
            n: [sign[n] * (r.measures[n] - b.measures[n]) for r, b in zip(runs, beside, strict=True)] for n in names
        }
        out.append(
            Setting(
                knob,
                value,
                float(np.mean(total)),
                float(np.mean(wall)),
                {s: float(np.exp(np.mean(np.log(np.maximum(v, 1e-3))))) for s, v in by_stage.items()},
                # One head whose hair hides the face would outweigh the others.
                {n: float(np.median(v)) for n, v in deltas.items()},
                {n: float(np.std(v, ddof=1)) if len(v) > 1 else float("nan") for n, v in deltas.items()},
                max(s[2] for r in runs for s in r.stages.values()),
                len(runs),
            )
        )
    return out


def curve_of(settings: Sequence[Setting], knob):
    """A knob's `KnobCurve`, the reference at its own value; None where fewer than two values were measured.

    Parameters
    ----------
    knob : of `plan.knobs`; only the stages it names are given ratios, for the others differ by noise alone
    """
    from sira_assets.plan.figures import KnobCurve, Point
    from sira_assets.plan.knobs import place

    rows = [s for s in settings if s.knob == knob.name]
    if len(rows) < 2:
        return None

    def rank(setting: Setting) -> float:
        first, second, share = place(knob.values, setting.value)
        return first + share * (second - first)

    # The reference's own value may lie between those of the knob; a curve is made monotone in this order.
    rows.sort(key=lambda s: (rank(s), s.ratio))
    points = tuple(
        Point(
            row.value,
            tuple((s, row.stage_ratios[s]) for s in knob.stages if s in row.stage_ratios),
            tuple(row.deltas.items()),
            tuple((n, s) for n, s in row.spread.items() if np.isfinite(s)),
            row.memory_bytes,
        )
        for row in rows
    )
    return KnobCurve(knob.name, points)


def write_csv(records: Sequence[Record], path: Path) -> None:
    """One line a run."""
    from sira_assets.atomic import replacing

    stages = list(dict.fromkeys(s for r in records for s in r.stages))
    names = list(dict.fromkeys(n for r in records for n in r.measures))
    bench = list(dict.fromkeys(n for r in records for n in r.benchmark))
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        head = ["scene", "seed", "knob", "value", "cpu_s", "wall_s", "peak_bytes", *names]
        out.writerow([*head, *(f"{s} cpu_s" for s in stages), *(f"{s} wall_s" for s in stages), *bench])
        for r in records:
            wall, peak = sum(s[1] for s in r.stages.values()), max(s[2] for s in r.stages.values())
            row = [r.scene, r.seed, r.knob, r.value, f"{r.seconds():.3f}", f"{wall:.3f}", peak]
            row += [f"{r.measures[n]:.5g}" if n in r.measures else "" for n in names]
            row += [f"{r.stages[s][k]:.3f}" if s in r.stages else "" for k in (0, 1) for s in stages]
            out.writerow([*row, *(f"{r.benchmark[b]:.5f}" for b in bench)])


@dataclass(frozen=True)
class Section:
    """One heading of the page: a picture (matplotlib figure or None) and a table."""

    title: str
    say: str
    figure: object | None
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def write_page(title: str, said: str, sections: Sequence[Section], path: Path) -> None:
    """One HTML file, pictures inside."""
    from sira_assets.atomic import write_text

    parts = []
    for s in sections:
        picture = ""
        if s.figure is not None:
            buffer = io.BytesIO()
            s.figure.savefig(buffer, format="png", dpi=110)
            uri = base64.b64encode(buffer.getvalue()).decode()
            picture = f'<img alt="{html.escape(s.title)}" src="data:image/png;base64,{uri}">'
        head = "".join(f"<th>{html.escape(h)}</th>" for h in s.head)
        rows = "".join(f"<tr>{''.join(f'<td>{html.escape(c)}</td>' for c in row)}</tr>" for row in s.rows)
        table = f"<table><tr>{head}</tr>{rows}</table>" if s.rows else ""
        parts.append(f"<section><h2>{html.escape(s.title)}</h2><p>{html.escape(s.say)}</p>{picture}{table}</section>")
    style = (
        "body{font:15px/1.45 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}"
        "table{border-collapse:collapse;margin:.6em 0;font-variant-numeric:tabular-nums}td,th{padding:.2em .7em;"
        "text-align:right;border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}"
        "img{max-width:100%}h2{margin-top:2em}section{overflow-x:auto}"
    )
    write_text(
        path,
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{style}</style><h1>{html.escape(title)}</h1><p>{html.escape(said)}</p>{''.join(parts)}</html>\n",
    )


def pareto_plot(settings: Sequence[Setting], spread: dict[str, float], names: Sequence[str]):
    """A matplotlib figure: each measure that moves against the cost of all stages, values named, the front drawn."""
    from matplotlib.figure import Figure

    from sira_assets.plan.figures import MEASURES
    from sira_assets.plan.front import dominated

    moved = {m.name for m in MEASURES if m.name in names and any(s.deltas[m.name] for s in settings)}
    measures = [m for m in MEASURES if m.name in (moved or names)]
    columns = min(3, max(1, len(measures)))
    rows = -(-len(measures) // columns)
    figure = Figure(figsize=(3.6 * columns, 2.7 * rows), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(rows, columns)).flat)
    for axis in axes[len(measures) :]:
        axis.remove()
    for axis, measure in zip(axes, measures, strict=False):
        x, y = [s.ratio for s in settings], [s.deltas[measure.name] for s in settings]
        error = [s.spread[measure.name] if np.isfinite(s.spread[measure.name]) else 0.0 for s in settings]
        seeds = spread.get(measure.name, 0.0)
        axis.axhspan(-seeds, seeds, color="0.92", zorder=0)
        axis.errorbar(x, y, yerr=error, fmt="o", ms=4, lw=0.8, color="#1f5fa8")
        front = sorted(zip(np.array(x)[~dominated(x, y)], np.array(y)[~dominated(x, y)], strict=True))
        axis.step(*zip(*front, strict=True), where="post", lw=1, color="#c0503a")
        for s, b in zip(settings, y, strict=True):
            axis.annotate(said(s.value), (s.ratio, b), textcoords="offset points", xytext=(4, 4), fontsize=7)
        axis.set_title(f"{measure.name}: worse by, {measure.unit}", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.25)
    figure.supxlabel("processor time over the reference's", fontsize=8)
    return figure


def said(value: object) -> str:
    """A value in a few characters."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)
