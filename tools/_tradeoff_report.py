"""The page, the table of knees and the planner's figures of a sweep.

Notation: as in _tradeoff_figures.py.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from _tradeoff_figures import (
    REFERENCE,
    START,
    Record,
    Section,
    Setting,
    compared,
    curve_of,
    pareto_plot,
    said,
    write_page,
)


def write_report(
    records: Sequence[Record],
    sweep,
    command: str,
    threads: int,
    out: Path,
    *,
    promises: Sequence[Section] = (),
    curves=None,
) -> list[str]:
    """Write index.html and figures.json; gives what is wrong with the presets, one line each.

    Parameters
    ----------
    curves : figures whose curves are taken over instead of measured ones, or None
    """
    from sira_assets.plan.figures import write_figures
    from sira_assets.plan.knobs import KNOBS

    # The reference is one more value of each knob, at seed 0: the seeds are for its spread.
    settings = compared(records)
    base = next(s for s in settings if s.knob == REFERENCE)
    spread = seed_spread(records)
    by_knob = {k.name: knob_settings(k, settings, base, sweep) for k in KNOBS}
    figures = planner_figures(records, by_knob, spread, command, threads)
    if curves is not None:
        made_by = f"{command}; curves: {curves.made_by.split('; curves: ')[-1]}"
        figures = replace(figures, made_by=made_by, curves=curves.curves, spread=curves.spread)
    write_figures(figures, out / "figures.json")
    sections, lost = [], []
    presets = [s for s in settings if s.knob == "preset"]
    if presets:
        section, lost = preset_section([*presets, replace(base, knob="preset", value=sweep.base)], spread)
        sections.append(section)
    sections += promises
    sections.append(reference_section(records, spread))
    for k in KNOBS:
        if len(by_knob[k.name]) > 1:
            sections.append(knob_section(k, by_knob[k.name], spread, default_of(k, sweep)))
    networks = [s for s in settings if s.knob == "network"]
    if networks:
        rows = [replace(base, knob="network", value="shipped"), *networks]
        head, table = settings_table(rows)
        sections.append(Section("network", "Priors of other sizes.", plot(rows, spread), head, table))
    chamfer = chamfer_section(records)
    sections += [chamfer] if chamfer else []
    scenes, seeds = sorted({r.scene for r in records}), sorted({r.seed for r in records})
    text = (
        f"{len(records)} runs on {len(scenes)} scenes ({', '.join(scenes)}), {len(seeds)} seeds of the reference "
        f"({sweep.base}), {threads} threads. Made by: {command}. Costs are processor seconds over the reference's, "
        "corrected by a benchmark of the same moment; bars are standard deviations over scenes, the grey band that of "
        "seeds; the red line is the front."
    )
    write_page("Speed against accuracy", text, sections, out / "index.html")
    return lost


def knob_settings(knob, settings: Sequence[Setting], base: Setting, sweep) -> list[Setting]:
    """A knob's measured values with the reference among them, cheapest first."""
    rows = [s for s in settings if s.knob == knob.name]
    if rows:
        rows.append(replace(base, knob=knob.name, value=default_of(knob, sweep)))
    numbers = {v: i for i, v in enumerate(knob.values)}
    return sorted(rows, key=lambda s: numbers.get(s.value, s.ratio + 100))


def default_of(knob, sweep):
    """The knob's value in the reference."""
    from _tradeoff_runs import tiny

    from sira_assets.pipeline import settings_for

    return knob.read(tiny() if sweep.quick else settings_for(sweep.base))


def seed_spread(records: Sequence[Record]) -> dict[str, float]:
    """Standard deviation of each measure over the reference's seeds, pooled over scenes."""
    from sira_assets.plan.figures import WORTH

    out = {}
    for name in WORTH:
        variances = []
        for scene in sorted({r.scene for r in records}):
            found = [
                r.measures[name] for r in records if (r.scene, r.knob) == (scene, REFERENCE) and name in r.measures
            ]
            if len(found) > 1:
                variances.append(np.var(found, ddof=1))
        if variances:
            out[name] = float(np.sqrt(np.mean(variances)))
    return out


def planner_figures(records, by_knob, spread, command: str, threads: int):
    """What the planner reads."""
    from sira_assets.plan.figures import WORTH, Benchmark, Figures, StageCost
    from sira_assets.plan.knobs import KNOBS

    references = [r for r in records if r.knob == REFERENCE]
    mean = lambda values: float(np.mean(list(values)))  # noqa: E731
    names = list(dict.fromkeys(s for r in references for s in r.stages))
    stages = tuple(
        StageCost(
            s,
            mean(r.stages[s][0] for r in references if s in r.stages),
            max(r.stages[s][2] for r in references if s in r.stages),
        )
        for s in names
    )
    bench = Benchmark(**{n: mean(r.benchmark[n] for r in references) for n in references[0].benchmark})
    accuracy = tuple((n, mean(r.measures[n] for r in references)) for n in WORTH if n in references[0].measures)
    curves = [curve for k in KNOBS if (curve := curve_of(by_knob[k.name], k)) is not None]
    scenes, seeds = len({r.scene for r in records}), len({r.seed for r in references})
    return Figures(command, scenes, seeds, threads, bench, stages, accuracy, tuple(spread.items()), tuple(curves))


def measures_of_all(rows: Sequence[Setting]) -> list[str]:
    """Measures that every setting has: a knob of the fit may be measured before the asset is made."""
    return [n for n in rows[0].deltas if all(n in s.deltas for s in rows)]


def settings_table(rows: Sequence[Setting]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Head and rows: value, costs, memory, measures; a dash where a setting was not measured so."""
    names = list(dict.fromkeys(n for s in rows for n in s.deltas))
    head = ("value", "processor time", "wall clock", "peak, GiB", *names)

    def said_of(s: Setting, name: str) -> str:
        if name not in s.deltas:
            return "–"
        return f"{s.deltas[name]:+.3g}" + (f" ± {s.spread[name]:.2g}" if np.isfinite(s.spread[name]) else "")

    table = []
    for s in rows:
        off = [said_of(s, n) for n in names]
        table.append((said(s.value), f"{s.ratio:.2f}", f"{s.wall_ratio:.2f}", f"{s.memory_bytes / 2**30:.1f}", *off))
    return head, tuple(table)


def plot(rows: Sequence[Setting], spread: dict[str, float]):
    """The Pareto plots of some settings."""
    return pareto_plot(rows, spread, measures_of_all(rows))


def knob_section(knob, rows: Sequence[Setting], spread: dict[str, float], default) -> Section:
    """A knob's plots, its table, its knee and its default."""
    from sira_assets.plan.front import knee

    curve = curve_of(rows, knob)
    order = [p.value for p in curve.points]
    rows = sorted(rows, key=lambda s: order.index(s.value))
    bend = knee([s.ratio for s in rows], [p.loss for p in curve.points])
    where = "none: nothing is gained beyond the noise, or nothing is paid" if bend is None else said(rows[bend].value)
    head, table = settings_table(rows)
    unit = f" ({knob.unit})" if knob.unit else ""
    say = f"Knee: {where}. Default of the reference: {said(default)}. Changes the cost of: {', '.join(knob.stages)}."
    return Section(f"{knob.name}{unit}", say, plot(rows, spread), head, table)


def preset_section(rows: Sequence[Setting], spread: dict[str, float]) -> tuple[Section, list[str]]:
    """The presets, and which of them another one dominates."""
    from sira_assets.plan.front import dominated

    rows = sorted(rows, key=lambda s: s.ratio)
    names = measures_of_all(rows)
    losses = np.array([[s.deltas[n] for n in names] for s in rows])
    lost = dominated([s.ratio for s in rows], losses)
    head, table = settings_table(rows)
    table = tuple((*row, "dominated" if bad else "on the front") for row, bad in zip(table, lost, strict=True))
    losers = [row.value for row, bad in zip(rows, lost, strict=True) if bad]
    lines = [f"preset {name}: another one costs no more and is nowhere worse" for name in losers]
    say = "Dominated: one that costs no less than another and is better in nothing."
    return Section("presets", say, plot(rows, spread), (*head, ""), table), lines


def reference_section(records: Sequence[Record], spread: dict[str, float]) -> Section:
    """What the reference took and measured, by scene."""
    references = [r for r in records if r.knob == REFERENCE]
    names = [n for n in references[0].measures if not n.startswith("chamfer")]
    stages = [s for s in references[0].stages if s != START]
    rows = [
        (
            f"{r.scene}, seed {r.seed}",
            *(f"{r.measures[n]:.3g}" for n in names),
            *(f"{r.seconds(s):.1f}" if s in r.stages else "" for s in stages),
        )
        for r in references
    ]
    rows.append(("standard deviation of seeds", *(f"{spread[n]:.2g}" if n in spread else "" for n in names)))
    head = ("run", *names, *(f"{s}, CPU s" for s in stages))
    return Section("reference", "Everything else is beside these runs.", None, head, tuple(rows))


def chamfer_section(records: Sequence[Record]) -> Section | None:
    """How many points the face's error needs."""
    from _tradeoff_runs import CHAMFER_SAMPLES

    found = [r.measures for r in records if f"chamfer_{CHAMFER_SAMPLES[0]}_mm" in r.measures]
    if not found:
        return None
    mean = lambda key: float(np.mean([m[key] for m in found]))  # noqa: E731
    rows = [
        (str(n), f"{mean(f'chamfer_{n}_mm'):.3f}", f"{mean(f'chamfer_{n}_sd_mm'):.4f}", f"{mean(f'chamfer_{n}_s'):.2f}")
        for n in CHAMFER_SAMPLES
    ]
    head = ("points a surface", "face, mm", "standard deviation over seeds, mm", "CPU s")
    say = "A measurement of the face with fewer points is cheaper and noisier. Default of the tools: 60000."
    return Section("Chamfer samples", say, None, head, tuple(rows))
