"""From a tolerance in millimetres to what it will take: how many triangles the measured curve says it needs.

Notation: t the greatest distance of the exported mesh from the fitted field, canonical mm; a part of it is the
extraction's, the rest the decimation's, and the run measures both (`mesh`); here is the prediction alone. Greatest
distances of decimated meshes fall as a power of the number of triangles, so the curve is read on logarithms.
"""

from dataclasses import replace

import numpy as np

from sira_assets.pipeline import Settings
from sira_assets.plan.figures import Benchmark, Figures
from sira_assets.plan.knobs import knob
from sira_assets.plan.planner import Plan, plan_of

# A curve flatter than this is no law: 1000 times the triangles would not take a third off the distance.
FLATTEST = -0.05
MOST_TRIANGLES = 2_000_000


def triangles_for(tolerance_mm: float, figures: Figures) -> int | None:
    """Triangles at which the greatest distance is expected to be within a tolerance, by the measured curve.

    Beyond its ends the curve is continued by the power law of its whole; None where there is no falling curve.
    """
    curve, accuracy = figures.curve("triangles"), dict(figures.accuracy)
    if curve is None or "asset_max_mm" not in accuracy:
        return None
    reference = accuracy["asset_max_mm"]
    points = [(float(p.value), reference + dict(p.losses).get("asset_max_mm", 0.0)) for p in curve.points]
    points = sorted((count, far) for count, far in points if far > 0)
    if len(points) < 2:
        return None
    count, far = (np.log([p[i] for p in points]) for i in (0, 1))
    slope, offset = np.polyfit(count, far, 1)
    if slope > FLATTEST:
        return None
    return round(float(np.exp(min((np.log(tolerance_mm) - offset) / slope, np.log(MOST_TRIANGLES)))))


def plan_tolerance(tolerance_mm: float, settings: Settings, figures: Figures, here: Benchmark) -> Plan:
    """What a run to a tolerance is expected to take; its settings are kept as they are, for the run decides itself."""
    count = triangles_for(tolerance_mm, figures)
    expected = settings if count is None else knob("triangles").put(settings, max(count, 100))
    plan = plan_of(f"{tolerance_mm:g} mm", expected, figures, here)
    return replace(plan, settings=settings)
