"""A stage that keeps a pace ends on time whatever its steps cost, and its schedule keeps its shape."""

import itertools
import math

import pytest
import torch

from sira_assets.fit.light import FreeLight
from sira_assets.fit.loop import Checkpoint, Stage, run_stages
from sira_assets.fit.pace import FEWEST, Pace, StageKept, progress, stage_ends


class Clock:
    """Seconds that pass only when told to."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def played(steps, seconds_of, ends_at, most=1.0):
    """p of every step, and when the last ended; step n takes seconds_of(n)."""
    clock = Clock()
    pace = Pace(ends_at, most, clock)
    out = []
    for p in progress(steps, pace=pace):
        clock.now += seconds_of(len(out))
        out.append(p)
    return out, clock.now


def test_without_a_pace_every_step_is_made():
    assert list(progress(8)) == [n / 8 for n in range(8)]
    assert list(progress(8, first=5)) == [5 / 8, 6 / 8, 7 / 8]
    assert list(progress(0)) == []


@pytest.mark.parametrize("seconds", [0.5, 1.0, 2.0, 7.0])
def test_a_stage_ends_when_it_should(seconds):
    p, ended = played(200, lambda n: seconds, 100.0)
    # One step more or less; a stage that has time enough does what was planned.
    assert ended == pytest.approx(min(100.0, 200 * seconds), abs=seconds + 1e-6)
    assert p[0] == 0.0
    assert all(b > a for a, b in itertools.pairwise(p))
    # The schedule runs to its end: what is left is one step, of those after the first few, which are as planned.
    assert 1.0 - p[-1] <= 1.5 / (len(p) - FEWEST)


def test_time_to_spare_is_used_as_far_as_allowed():
    p, ended = played(100, lambda n: 0.1, 100.0, most=1.5)
    assert len(p) == 150
    assert ended == pytest.approx(15.0)


def test_a_machine_that_slows_down_or_has_slow_steps_now_and_then_is_followed():
    slow_later = lambda n: 0.2 if n < 100 else 0.8  # noqa: E731
    p, ended = played(300, slow_later, 60.0)
    assert ended == pytest.approx(60.0, abs=1.0)
    assert max(b - a for a, b in itertools.pairwise(p)) < 0.05  # no leap in the schedule
    traced_anew = lambda n: 5.0 if n % 40 == 0 else 0.2  # noqa: E731
    p, ended = played(200, traced_anew, 30.0)
    assert ended == pytest.approx(30.0, abs=5.0)
    assert max(b - a for a, b in itertools.pairwise(p)) < 0.1


def test_no_time_at_all_is_one_step():
    p, _ = played(100, lambda n: 1.0, 0.0)
    assert p == [0.0]
    assert len(played(100, lambda n: 10.0, 5.0)[0]) <= FEWEST


def test_time_is_shared_out_by_work():
    clock = Clock()
    assert stage_ends(Pace(90.0, clock=clock), [10.0, 20.0]) == pytest.approx(30.0)
    assert stage_ends(Pace(90.0, clock=clock), [10.0, 20.0], 15.0) == pytest.approx(25.0)
    assert stage_ends(Pace(90.0, clock=clock), [10.0, 20.0], 100.0) == 0.0
    clock.now = 100.0
    assert stage_ends(Pace(90.0, clock=clock), [10.0, 20.0]) == 100.0


def stages_and_state(count, clock=None, seconds=0.0):
    x = torch.nn.Parameter(torch.zeros(3))
    seen = {"before": [], "losses": []}

    def losses(step, generator):
        if clock is not None:
            clock.now += seconds
        seen["losses"].append(step)
        return {"far": (x - 1.0).square().sum()}

    def before(step, generator):
        seen["before"].append(step)

    rates = [([x], 0.2)]
    stages = [
        Stage("one", count, rates, losses, before_step=before),
        Stage("two", count, rates, losses, before_step=before, work=3.0),
    ]
    return stages, {"x": x}, seen


@pytest.mark.parametrize(("seconds", "ends_at"), [(1.0, 40.0), (1.0, 400.0), (3.0, 40.0)])
def test_stages_are_over_in_time_and_enter_every_planned_step(seconds, ends_at):
    clock, kept = Clock(), []
    stages, state, seen = stages_and_state(60, clock, seconds)
    run_stages(stages, state, seed=0, pace=Pace(ends_at, clock=clock, note=kept.append))
    assert clock.now == pytest.approx(min(ends_at, 120 * seconds), abs=2 * seconds)
    # Work done now and then (rays traced anew) is neither skipped nor done twice.
    last = [max(part) for part in (seen["before"][: seen["before"].index(0, 1)], seen["before"])]
    assert seen["before"] == [*range(last[0] + 1), *range(len(seen["before"]) - last[0] - 1)]
    assert [k.name for k in kept] == ["one", "two"]
    assert sum(k.done for k in kept) == len(seen["losses"])
    assert all(k == StageKept(k.name, 60, k.done, seconds * k.done) for k in kept)
    if ends_at == 40.0 and seconds == 1.0:
        assert kept[1].done == pytest.approx(3 * kept[0].done, abs=3)  # three times the work planned


def test_a_short_stage_outlives_a_slow_first_step():
    """Two stages, one tenth of the work in the first: setting out takes longer than its share of the time."""
    clock, made = Clock(), []
    pace = Pace(100.0, clock=clock)
    for work in ([10.0, 90.0], [90.0]):
        steps = 0
        for _ in progress(100, pace=pace, work=work):
            clock.now += 0.2 if steps else 20.0
            steps += 1
        made.append(steps)
    # A tenth of what is left after both first steps; then all that is left.
    assert made[0] == pytest.approx(6.0 / 0.2, abs=2)
    assert made[1] == 100
    assert clock.now == pytest.approx(26.0 + 20.0 + 99 * 0.2, abs=0.5)


def test_the_last_stage_does_not_pay_for_the_others_setting_out():
    clock, made = Clock(), []
    pace, works = Pace(100.0, clock=clock), [1.0, 1.0, 1.0, 1.0]
    for k in range(len(works)):
        steps = 0
        for _ in progress(100, pace=pace, work=works[k:]):
            clock.now += 0.5 if steps else 5.0
            steps += 1
        made.append(steps)
    assert made == pytest.approx([20.0 / 0.5] * 4, abs=2)  # 100 s less four times 5, shared evenly


def test_a_stage_without_steps_takes_no_time_from_the_others():
    done = []
    for between in ([], [Stage("none", 0, [], lambda step, generator: {})]):
        clock, kept = Clock(), []
        x = torch.nn.Parameter(torch.zeros(3))

        def losses(step, generator, x=x, clock=clock):
            clock.now += 0.5 if step else 20.0
            return {"far": (x - 1.0).square().sum()}

        one, two = (Stage(name, 200, [([x], 0.2)], losses) for name in ("one", "two"))
        run_stages([one, *between, two], {"x": x}, seed=0, pace=Pace(100.0, clock=clock, note=kept.append))
        done.append([k.done for k in kept if k.planned])
    assert done[1] == done[0]


def test_a_pace_with_time_enough_is_the_plain_fit():
    plain, state, _ = stages_and_state(30)
    run_stages(plain, state, seed=0)
    clock = Clock()
    paced, other, _ = stages_and_state(30, clock, 1e-3)
    run_stages(paced, other, seed=0, pace=Pace(1e6, clock=clock))
    # The cosine is read at the same places up to rounding.
    torch.testing.assert_close(state["x"], other["x"], rtol=1e-5, atol=1e-6)


def test_a_pace_takes_no_checkpoint(tmp_path):
    stages, state, _ = stages_and_state(3)
    with pytest.raises(ValueError, match="clock"):
        run_stages(stages, state, seed=0, checkpoint=Checkpoint(tmp_path / "c", "key"), pace=Pace(math.inf))


def test_the_fits_keep_a_pace():
    from small_portrait import portrait
    from test_fit import GEOMETRY, ball_prior

    from sira_assets.fit.geometry import fit_geometry

    kept = []
    fit_geometry(portrait(), ball_prior(), GEOMETRY, pace=Pace(-math.inf, note=kept.append))
    assert [k.done for k in kept] == [1] * len(kept)
    assert [k.name for k in kept] == ["appearance code", "codes", "networks", "cover"]


def test_fewer_lobes_are_the_strongest():
    from test_fit import ball_prior

    from sira_assets.numerics.sg import sg_integral

    prior = ball_prior()
    whole, few = FreeLight(prior), FreeLight(prior, lobes=3)
    flux = sg_integral(whole.lobes()[1], whole.lobes()[2]).mean(-1)
    kept = sg_integral(few.lobes()[1], few.lobes()[2]).mean(-1)
    torch.testing.assert_close(kept.sort().values, flux.topk(3).values.sort().values)
    assert len(FreeLight(prior, lobes=99).log_sharpness) == len(flux)
