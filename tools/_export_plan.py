"""What `export_avatar.py` plans before it runs: settings by budget, or what chosen settings will take."""

import argparse
import json
import time

from sira_assets.fields.prior import Prior
from sira_assets.pipeline import Settings, Timetable
from sira_assets.plan.figures import read_figures
from sira_assets.plan.machine import benchmark
from sira_assets.plan.planner import Plan, plan_budget, plan_of, with_known_start
from sira_assets.plan.present import plan_json, plan_table
from sira_assets.plan.timetable import Keeping, timetable
from sira_assets.plan.tolerance import plan_tolerance


def asked_plan(
    args: argparse.Namespace, settings: Settings, prior: Prior, began: float, *, device: str
) -> tuple[Plan, Timetable | None, Keeping | None]:
    """The plan for the command line's wishes; with a budget, also the timetable and what will be noted of it.

    Parameters
    ----------
    began : when the run began, monotonic seconds

    Raises
    ------
    InputError : a budget that this machine cannot keep.
    """
    here = benchmark(prior, device=device)
    figures = with_known_start(read_figures(args.figures), here, time.monotonic() - began)
    if args.tolerance_mm is not None:
        return plan_tolerance(args.tolerance_mm, settings, figures, here), None, None
    if not args.budget:
        return plan_of(f"{settings.quality} quality", settings, figures, here), None, None
    plan = plan_budget(args.budget, settings, figures, here)
    keeping = Keeping()
    return plan, timetable(plan, figures, here, keeping, began=began), keeping


def print_plan(plan: Plan, *, as_json: bool) -> None:
    """To the terminal: a dry run's JSON to standard output, everything else as a table."""
    if as_json:
        print(json.dumps(plan_json(plan), indent=1))
        return
    from rich.console import Console

    Console().print(plan_table(plan))
