"""Keeping to a plan while it runs: the fits end on time, and maps shrink if time ran out before them.

Notation: a run began at b and is to be over at e = b + AIMED_SHARE * budget, on a monotonic clock; a fit is to be over
at e less what the plan says of the stages behind it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from sira_assets.fit.pace import Pace, StageKept
from sira_assets.pipeline import Settings, Timetable
from sira_assets.plan.figures import Benchmark, Figures
from sira_assets.plan.knobs import knob
from sira_assets.plan.planner import Plan, predicted

# Writing files is planned as well, but a stage can only be hurried while it fits: aim a little early.
AIMED_SHARE = 0.96
# A machine that turns out faster buys more steps than planned, up to this many times as many.
MOST_STEPS = 1.25


@dataclass
class Keeping:
    """What a run against the clock has done so far: filled while it runs."""

    steps: list[StageKept] = field(default_factory=list)
    texture_size: int | None = None  # where it was made smaller than planned


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
    texture = knob("texture size")

    def revised(settings: Settings) -> Settings:
        """Smaller maps, as long as what is left of the plan does not fit into the time left."""
        smaller = [v for v in texture.values if v < texture.read(settings)]
        while smaller and clock() + _behind_the_fits(settings, figures, here) > over:
            settings = texture.put(settings, smaller.pop())
            keeping.texture_size = int(texture.read(settings))
        return settings

    def pace(stage: str) -> Pace:
        return Pace(over - plan.after(stage), MOST_STEPS, clock, keeping.steps.append)

    return Timetable(pace("fit geometry"), pace("fit appearance"), revised)


def _behind_the_fits(settings: Settings, figures: Figures, here: Benchmark) -> float:
    stages, _ = predicted(settings, figures, here)
    names = [s.name for s in stages]
    return sum(s.seconds for s in stages[names.index("fit appearance") + 1 :])
