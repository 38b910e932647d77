"""Keeping to a plan while it runs: the fits end on time, and maps shrink where steps are worth more, or time ran out.

Notation: a run began at b and is to be over at e = b + AIMED_SHARE * budget, on a monotonic clock. Time that the plan
leaves over, or lacks, is shared by the two fits as they are planned to take it. Before the second one the plan is made
again from what is known then: how large the photo lets maps be, what the clock says, and how long the first fit's
steps took beside what was planned.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from sira_assets.fit.geometry import WORK
from sira_assets.fit.pace import Pace, StageKept
from sira_assets.pipeline import Settings, Timetable
from sira_assets.plan.figures import Benchmark, Figures
from sira_assets.plan.knobs import knob
from sira_assets.plan.planner import Plan, predicted

# Writing files is planned as well, but a stage can only be hurried while it fits: aim a little early.
AIMED_SHARE = 0.96
# A machine that turns out faster buys more steps than planned, up to so many times as many, and as many times the
# default's as the curves say anything is gained by: geometry, appearance.
MOST, BEST_GEOMETRY, BEST_APPEARANCE = 2.0, 1.5, 2.0
# Steps beside their plan, at most and at least: a benchmark of a second is not wrong by more.
SLOWEST, FASTEST = 4.0, 0.5


@dataclass
class Keeping:
    """What a run against the clock has done so far: filled while it runs."""

    steps: list[StageKept] = field(default_factory=list)
    maps: tuple[int, int] | None = None  # texels, and samples a texel, a side, where they were made less for the time


def timetable(
    plan: Plan,
    figures: Figures,
    here: Benchmark,
    keeping: Keeping,
    *,
    began: float,
    clock: Callable[[], float] = time.monotonic,
) -> Timetable:
    """When each fit of a plan with a budget is to be over.

    Parameters
    ----------
    began : when the run began, on `clock`
    keeping : told of what was done

    Raises
    ------
    ValueError : a plan without a budget.
    """
    if plan.budget_s is None:
        raise ValueError("a plan without a budget has no timetable")
    over = began + AIMED_SHARE * plan.budget_s
    planned = dict(plan.stages)
    geometry_s, appearance_s = (planned.get(name, 0.0) for name in ("fit geometry", "fit appearance"))
    spare = over - began - plan.seconds
    behind_geometry = plan.after("fit geometry") + spare * appearance_s / max(geometry_s + appearance_s, 1e-30)
    steps = knob("appearance steps")

    def pace(ends_at: float, best: float, planned: float) -> Pace:
        return Pace(ends_at, min(max(1.0, best / planned), MOST), clock, keeping.steps.append)

    def behind(settings: Settings) -> float:
        stages, _ = predicted(settings, figures, here)
        names = [s.name for s in stages]
        return sum(s.seconds for s in stages[names.index("fit appearance") + 1 :])

    def noted(settings: Settings, chosen: Settings) -> Settings:
        if chosen.bake == settings.bake:
            return settings
        keeping.maps = (chosen.bake.size, chosen.bake.samples)
        return replace(settings, unwrap=chosen.unwrap, bake=chosen.bake)

    def appearance(settings: Settings) -> tuple[Settings, Pace]:
        """Maps and steps that lose least together in the time left."""
        left, each = over - clock(), _slower(keeping.steps, geometry_s) * appearance_s

        def loss(option: Settings) -> float:
            share = min((left - behind(option)) / max(each, 1e-30), 1.0)
            fewer = steps.put(option, steps.read(option) * max(share, 1e-3))
            return predicted(fewer, figures, here)[1]

        settings = noted(settings, min(_no_larger_maps(settings), key=loss))
        return settings, pace(over - behind(settings), BEST_APPEARANCE, steps.read(settings))

    def revised(settings: Settings) -> Settings:
        """The best maps that the time left is enough for; nothing is aimed at early any more."""
        left, options = began + plan.budget_s - clock(), list(_no_larger_maps(settings))
        in_time = [o for o in options if behind(o) <= left] or options[-1:]
        return noted(settings, min(in_time, key=lambda o: predicted(o, figures, here)[1]))

    geometry = pace(over - behind_geometry, BEST_GEOMETRY, knob("geometry steps").read(plan.settings))
    return Timetable(geometry, appearance, revised)


def _no_larger_maps(settings: Settings) -> Iterator[Settings]:
    """These settings, and those with fewer texels or samples: the finest first."""
    size, samples = knob("texture size"), knob("texture samples")
    for s in (settings.bake.size, *(v for v in reversed(size.values) if v < settings.bake.size)):
        for n in (settings.bake.samples, *(v for v in reversed(samples.values) if v < settings.bake.samples)):
            yield samples.put(size.put(settings, s), n)


def _slower(steps: list[StageKept], planned_s: float) -> float:
    """How many times as long as planned the steps of the geometry fit took."""
    done = sum(WORK[k.name] * k.done for k in steps) / max(sum(WORK[k.name] * k.planned for k in steps), 1e-30)
    ratio = sum(k.seconds for k in steps) / max(done * planned_s, 1e-30)
    return min(max(ratio, FASTEST), SLOWEST) if steps else 1.0
