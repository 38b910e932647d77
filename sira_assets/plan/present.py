"""A plan in words: for the terminal before a run, and for the report after it."""

from sira_assets.measure.report import Decision
from sira_assets.plan.knobs import Value
from sira_assets.plan.planner import Choice, Plan
from sira_assets.plan.timetable import Keeping


def plan_table(plan: Plan):
    """A rich table of what a run is to do and to take."""
    from rich.table import Table

    table = Table(title=f"Plan for {plan.asked}", title_justify="left")
    table.add_column("knob")
    table.add_column("value", justify="right")
    table.add_column("loss", justify="right")
    for choice in plan.choices:
        table.add_row(choice.knob, _said(choice), f"{choice.loss:.1f}")
    table.add_section()
    for name, seconds in plan.stages:
        table.add_row(name, f"{seconds:.1f} s", "")
    table.add_section()
    table.add_row("in all", f"{plan.seconds:.0f} s", "")
    table.add_row("memory at the peak", f"{plan.memory_bytes / 2**30:.1f} GiB", "")
    return table


def plan_json(plan: Plan) -> dict:
    """The same in types JSON has."""
    return {
        "asked": plan.asked,
        "knobs": {c.knob: c.value for c in plan.choices},
        "seconds": {name: round(s, 2) for name, s in plan.stages},
        "total_seconds": round(plan.seconds, 1),
        "peak_memory": plan.memory_bytes,
    }


def plan_decisions(plan: Plan, keeping: Keeping | None, seconds: float) -> tuple[Decision, ...]:
    """What was planned and what was kept, for the report.

    Parameters
    ----------
    seconds : from the photo until now
    """
    kept = [f"planned {plan.seconds:.0f} s, {seconds:.1f} s when this page was written"]
    if keeping is not None:
        kept += [f"{k.name} {k.done} of {k.planned} steps" for k in keeping.steps]
        if keeping.maps is not None:
            size, samples = keeping.maps
            kept.append(f"maps made smaller to keep the time: {size} texels a side, {samples} x {samples} samples each")
    knobs = (
        Decision(c.knob, _said(c), f"planned; {c.loss:.1f} steps worth seeing behind the best value measured")
        for c in plan.choices
    )
    return (Decision("plan", plan.asked, "; ".join(kept)), *knobs)


def _said(choice: Choice) -> str:
    return f"{_value(choice.value)} {choice.unit}".strip()


def _value(value: Value) -> str:
    return value if isinstance(value, str) else f"{value:.3g}" if isinstance(value, float) else str(value)
