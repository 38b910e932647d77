"""Plans: within their time, better with more of it, refused where there is too little; and how they are kept to."""

import itertools
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from sample_figures import BENCH, STEPS, figures

from sira_assets.errors import InputError
from sira_assets.fit.pace import StageKept
from sira_assets.pipeline import Settings, settings_for
from sira_assets.plan.figures import Benchmark, KnobCurve, read_figures, write_figures
from sira_assets.plan.knobs import knob
from sira_assets.plan.machine import speed
from sira_assets.plan.planner import PLANNED_SHARE, plan_budget, plan_of, predicted, with_known_start
from sira_assets.plan.present import plan_decisions, plan_json
from sira_assets.plan.timetable import AIMED_SHARE, Keeping, timetable


def loss(plan):
    return predicted(plan.settings, figures(), BENCH)[1]


def test_the_reference_is_predicted_as_it_was_measured():
    reference = Settings()
    stages, _ = predicted(reference, figures(), BENCH)
    assert {s.name: s.seconds for s in stages} == pytest.approx({s.name: s.seconds for s in figures().reference})
    # A machine on which everything takes twice as long.
    slow = Benchmark(*(2 * t for t in (BENCH.network_s, BENCH.rays_s, BENCH.arrays_s)))
    assert [s.seconds for s in predicted(reference, figures(), slow)[0]] == pytest.approx(
        [2 * s.seconds for s in figures().reference]
    )
    assert speed("bake", replace(BENCH, network_s=1.0), BENCH) == pytest.approx(1.0 / BENCH.network_s)
    assert speed("unwrap", replace(BENCH, network_s=1.0), BENCH) == 1.0


def test_knobs_multiply():
    half = knob("geometry steps").put(knob("texture size").put(settings_for("standard"), 2048), 0.5)
    stages = {s.name: s.seconds for s in predicted(half, figures(), BENCH)[0]}
    assert stages["fit geometry"] == pytest.approx(25.0)
    assert stages["bake"] == pytest.approx(80.0)
    assert stages["write"] == pytest.approx(16.0)
    between = knob("geometry steps").put(settings_for("standard"), np.sqrt(0.5))
    stages = {s.name: s.seconds for s in predicted(between, figures(), BENCH)[0]}
    assert stages["fit geometry"] == pytest.approx(50 * np.sqrt(0.5), rel=0.01)  # whole steps


@pytest.mark.parametrize("budget", [30.0, 45.0, 60.0, 120.0, 200.0, 600.0])
def test_a_plan_fits_and_nothing_affordable_is_left(budget):
    plan = plan_budget(budget, settings_for("standard"), figures(), BENCH)
    assert plan.seconds <= PLANNED_SHARE * budget * 1.001
    # Steps are rounded to whole ones when the plan is put into settings, hence the thousandth.
    assert plan.budget_s == budget
    steps, size = knob("geometry steps").read(plan.settings), knob("texture size").read(plan.settings)
    # Both fits stand on equal curves in cost but not in what they buy: the albedo's is dearer per second.
    assert size in (256, 512, 1024, 2048)
    assert 0.05 < steps <= 2.01


def test_more_time_is_never_less_accurate():
    plans = [plan_budget(t, settings_for("standard"), figures(), BENCH) for t in (30, 40, 60, 90, 150, 300, 600)]
    losses = [loss(p) for p in plans]
    assert all(b <= a + 1e-9 for a, b in itertools.pairwise(losses))
    assert losses[-1] < losses[0]
    # With time for everything, everything measured as better is bought, if the difference is worth seeing.
    assert knob("texture size").read(plans[-1].settings) == 2048  # by one and a half steps
    assert knob("geometry steps").read(plans[-1].settings) == 1.5  # as standard; twice as many: by a fifth of one
    assert knob("appearance steps").read(plans[-1].settings) == 1.0


def test_the_greedy_plan_is_near_the_best_of_all():
    """Against every combination of measured values; the greedy rule may miss by what its last step would have cost."""
    f, start = figures(), settings_for("standard")
    grid = []
    for g, a, t in itertools.product(STEPS, STEPS, (256, 512, 1024, 2048)):
        s = knob("texture size").put(knob("appearance steps").put(knob("geometry steps").put(start, g), a), t)
        stages, lost = predicted(s, f, BENCH)
        grid.append((sum(x.seconds for x in stages), lost))
    for budget in (40.0, 60.0, 100.0, 250.0):
        best = min(lost for seconds, lost in grid if seconds <= PLANNED_SHARE * budget)
        # Values between the measured ones are open to the plan only, so it may be better as well.
        assert loss(plan_budget(budget, start, f, BENCH)) <= best + 0.6


def test_noise_buys_nothing():
    """A dearer value that was measured as worse is not worse: it is averaged with its neighbour, and not bought."""
    f = figures()
    noisy = [replace(p, losses=(("bake_rms", 5.0 if p.value == 2048 else 0.0),)) for p in f.curves[2].points]
    f = replace(f, curves=(*f.curves[:2], KnobCurve("texture size", tuple(noisy))))
    plan = plan_budget(600.0, knob("texture size").put(settings_for("standard"), 256), f, BENCH)
    assert knob("texture size").read(plan.settings) == 256


def test_time_that_is_left_buys_the_presets_own_values():
    """A knob that the measured scenes had no use for: another scene may have."""
    f = figures()
    useless = [replace(p, losses=(("bake_rms", 0.0),)) for p in f.curves[2].points]
    f = replace(f, curves=(*f.curves[:2], KnobCurve("texture size", tuple(useless))))
    sizes = [
        knob("texture size").read(plan_budget(t, settings_for("standard"), f, BENCH).settings) for t in (60.0, 600.0)
    ]
    assert sizes == [
        knob("texture size").read(settings_for("draft")),
        knob("texture size").read(settings_for("standard")),
    ]
    # And never more than the preset's.
    assert knob("geometry steps").read(plan_budget(6000.0, settings_for("standard"), f, BENCH).settings) < 2.01


def test_nothing_is_saved_below_the_draft_for_another_knob():
    # In these figures the geometry's steps buy nothing, and the appearance's much.
    f = figures()
    useless = [replace(p, losses=(("face_mm", 0.0),)) for p in f.curves[0].points]
    f = replace(f, curves=(KnobCurve(f.curves[0].name, tuple(useless)), *f.curves[1:]))
    draft = settings_for("draft")
    takes = sum(s.seconds for s in predicted(draft, f, BENCH)[0]) / PLANNED_SHARE
    names = [c.name for c in f.curves]
    enough = plan_budget(1.3 * takes, settings_for("standard"), f, BENCH).settings
    assert all(knob(n).read(enough) >= knob(n).read(draft) - 1e-9 for n in names)
    too_little = plan_budget(0.8 * takes, settings_for("standard"), f, BENCH).settings
    assert knob(names[0]).read(too_little) < knob(names[0]).read(draft)


def test_too_little_time_is_refused_with_what_it_would_take():
    least = sum(s.seconds for s in predicted(cheapest(), figures(), BENCH)[0])
    with pytest.raises(InputError, match=f"{np.ceil(least / PLANNED_SHARE):.0f} s or more"):
        plan_budget(10.0, settings_for("standard"), figures(), BENCH)
    plan_budget(np.ceil(least), settings_for("standard"), figures(), BENCH)


def cheapest():
    s = settings_for("standard")
    for name, value in (("geometry steps", 0.06), ("appearance steps", 0.06), ("texture size", 256)):
        s = knob(name).put(s, value)
    return s


def test_memory_grows_with_what_needs_more():
    f = figures()
    small, big = (plan_of("x", knob("texture size").put(settings_for("standard"), s), f, BENCH) for s in (512, 2048))
    assert small.memory_bytes == 2 * 10**9  # the reference's own peak: no less is promised
    assert big.memory_bytes == pytest.approx(2 * 10**9 + (10**9 + 700 * 2048**2 - 2 * 10**9))


def test_what_is_written_is_read_again(tmp_path):
    write_figures(figures(), tmp_path / "f.json")
    again = read_figures(tmp_path / "f.json")
    write_figures(again, tmp_path / "g.json")
    assert (tmp_path / "f.json").read_bytes() == (tmp_path / "g.json").read_bytes()
    # Numbers are written with six digits.
    ours, theirs = (predicted(cheapest(), f, BENCH) for f in (figures(), again))
    assert [s.seconds for s in ours[0]] == pytest.approx([s.seconds for s in theirs[0]], rel=1e-5)
    assert ours[1] == pytest.approx(theirs[1], rel=1e-5)
    (tmp_path / "f.json").write_text("{}")
    with pytest.raises(InputError, match="measure_tradeoff"):
        read_figures(tmp_path / "f.json")


def test_the_shipped_figures_plan_on_the_machine_they_were_measured_on():
    shipped = files("sira_assets.plan") / "figures.json"
    if not shipped.is_file():
        pytest.skip("no curves ship with this version")
    f = read_figures()
    plans = [plan_budget(t, settings_for("standard"), f, f.benchmark) for t in (120.0, 600.0)]
    assert plans[0].seconds <= 120.0
    assert predicted(plans[1].settings, f, f.benchmark)[1] <= predicted(plans[0].settings, f, f.benchmark)[1]


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def ahead():
    """A plan for 100 s that began at 100 s, its timetable, and what it notes."""
    clock, keeping = Clock(), Keeping()
    plan = plan_budget(100.0, settings_for("standard", texture_size=1024), figures(), BENCH)
    return plan, timetable(plan, figures(), BENCH, keeping, began=100.0, clock=clock), keeping, clock


def test_a_timetable_leaves_the_later_stages_their_time(ahead):
    plan, table, keeping, clock = ahead
    over, planned = 100.0 + AIMED_SHARE * 100.0, dict(plan.stages)
    asset = planned["unwrap"] + planned["bake"] + planned["write"]
    # What the plan leaves over goes to both fits alike.
    left = over - asset - 100.0 - planned["start"]
    fits = planned["fit geometry"] + planned["fit appearance"]
    assert table.geometry.ends_at == pytest.approx(105.0 + left * planned["fit geometry"] / fits)
    clock.now = table.geometry.ends_at
    settings, pace = table.appearance(plan.settings)
    assert settings == plan.settings
    assert pace.ends_at == pytest.approx(over - asset)
    clock.now = pace.ends_at + 0.5 * (1 - AIMED_SHARE) * 100.0  # a little late, which what was left aside is there for
    assert table.revised(settings) == settings
    assert keeping.maps is None
    with pytest.raises(ValueError, match="budget"):
        timetable(replace(plan, budget_s=None), figures(), BENCH, keeping, began=0.0)


def test_maps_shrink_where_time_ran_out_and_that_is_noted(ahead):
    plan, table, keeping, clock = ahead
    clock.now = 200.0 - 12.0  # unwrap 6 s, write at least 2 s
    late = table.revised(plan.settings)
    assert knob("texture size").read(late) == keeping.maps[0] < knob("texture size").read(plan.settings)
    words = plan_decisions(plan, keeping, 98.7)[0].evidence
    assert "98.7 s" in words
    assert f"{keeping.maps[0]} texels" in words
    clock.now = 300.0  # there is no going back: the least there is
    assert knob("texture size").read(table.revised(plan.settings)) == 256


def test_slow_steps_shrink_maps_before_the_second_fit_where_its_steps_are_worth_more(ahead):
    plan, table, keeping, clock = ahead
    finest = replace(plan.settings, bake=replace(plan.settings.bake, size=2048))
    planned_s, steps = dict(plan.stages)["fit geometry"], plan.settings.geometry.steps_codes
    for slower in (1.0, 3.0):
        keeping.steps[:] = [StageKept("codes", steps, steps, slower * planned_s)]
        clock.now = 130.0
        settings, pace = table.appearance(finest)
        behind = sum(s.seconds for s in predicted(settings, figures(), BENCH)[0][-3:])
        assert pace.ends_at == pytest.approx(100.0 + AIMED_SHARE * 100.0 - behind)
        options = {}
        for size in (256, 512, 1024, 2048):
            option = knob("texture size").put(finest, size)
            stages, _ = predicted(option, figures(), BENCH)
            left = 66.0 - sum(s.seconds for s in stages[-3:])
            share = min(1.0, left / (slower * dict(plan.stages)["fit appearance"]))
            factor = knob("appearance steps").read(option) * max(share, 1e-3)
            options[size] = predicted(knob("appearance steps").put(option, factor), figures(), BENCH)[1]
        assert options[settings.bake.size] == pytest.approx(min(options.values()))
        assert settings.bake.size < 2048  # whose bake takes 80 of the 66 s left


@pytest.mark.parametrize(
    ("factor", "most"), [(0.25, (2.0, 2.0)), (0.8, (1.875, 2.0)), (1.6, (1.0, 1.25)), (2.0, (1.0, 1.0))]
)
def test_time_left_over_buys_no_more_steps_than_the_curves_say_are_of_use(ahead, factor, most):
    plan, keeping = ahead[0], Keeping()
    settings = plan.settings
    for name in ("geometry steps", "appearance steps"):
        settings = knob(name).put(settings, factor)
    table = timetable(replace(plan, settings=settings), figures(), BENCH, keeping, began=100.0, clock=Clock())
    found = (table.geometry.most, table.appearance(settings)[1].most)
    assert found == pytest.approx(most, rel=0.01)  # steps are whole


def test_the_photo_bounds_the_texture_size_of_a_budget_unless_a_size_was_asked_for():
    free = plan_budget(100.0, settings_for("standard"), figures(), BENCH)
    asked = plan_budget(100.0, settings_for("standard", texture_size=512), figures(), BENCH)
    assert free.settings.texels_per_pixel == settings_for("high").texels_per_pixel
    assert free.settings.largest_texture == free.settings.bake.size == knob("texture size").read(free.settings)
    assert asked.settings.texels_per_pixel is None
    assert [c.value for c in free.choices] == [c.value for c in asked.choices]


def test_a_plan_in_json_adds_up():
    plan = plan_budget(100.0, settings_for("standard"), figures(), BENCH)
    said = plan_json(plan)
    assert sum(said["seconds"].values()) == pytest.approx(said["total_seconds"], abs=0.1)
    assert set(said["knobs"]) == {"geometry steps", "appearance steps", "texture size"}


def test_the_start_is_what_it_took():
    known = with_known_start(figures(), BENCH, 7.25)
    at_rest = lambda f: dict((s.name, s.seconds) for s in predicted(cheapest(), f, BENCH)[0])  # noqa: E731
    before, after = at_rest(figures()), at_rest(known)
    assert after.pop("start") == pytest.approx(7.25)
    assert after == {name: s for name, s in before.items() if name != "start"}
