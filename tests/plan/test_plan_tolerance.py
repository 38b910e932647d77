"""Triangles for a tolerance: read off a power law exactly, and predicted without changing what was asked for."""

from dataclasses import replace

import pytest
from sample_figures import BENCH, figures

from sira_assets.pipeline import settings_for
from sira_assets.plan.figures import KnobCurve, Point
from sira_assets.plan.tolerance import plan_tolerance, triangles_for


def with_triangles():
    """Greatest distances of 2 mm at 10 thousand triangles, inversely as their number."""
    distance = lambda n: 2.0 * 1e4 / n  # noqa: E731
    points = tuple(
        Point(n, (("unwrap", n / 30000),), (("asset_max_mm", distance(n) - distance(30000)),), (), 10**9)
        for n in (5000, 10000, 30000, 60000)
    )
    f = figures()
    return replace(f, accuracy=(("asset_max_mm", distance(30000)),), curves=(*f.curves, KnobCurve("triangles", points)))


@pytest.mark.parametrize("tolerance", [0.1, 0.5, 1.0, 2.0, 5.0])
def test_a_power_law_is_read_exactly_inside_and_beyond(tolerance):
    assert triangles_for(tolerance, with_triangles()) == pytest.approx(2e4 / tolerance, rel=1e-3)


def test_without_a_falling_curve_nothing_is_promised():
    assert triangles_for(1.0, figures()) is None
    f = with_triangles()
    flat = KnobCurve("triangles", tuple(replace(p, losses=(("asset_max_mm", 0.0),)) for p in f.curves[-1].points))
    assert triangles_for(1.0, replace(f, curves=(flat,))) is None


def test_the_plan_counts_the_triangles_and_leaves_the_settings():
    f, settings = with_triangles(), settings_for("standard")
    plan = plan_tolerance(0.5, settings, f, BENCH)
    assert plan.settings == settings
    assert {c.knob: c.value for c in plan.choices}["triangles"] == pytest.approx(40000, rel=1e-3)
    assert dict(plan.stages)["unwrap"] == pytest.approx(6.0 * 40000 / 30000, rel=0.01)
