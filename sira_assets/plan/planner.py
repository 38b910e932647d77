"""From a time to settings: the knobs that buy most accuracy for it, by the measured curves.

Notation: a stage's seconds are the reference's, times the machine's speed, times each knob's ratio for it; the loss
of a combination is the sum of its knobs' losses. Both are what one-at-a-time curves can say: knobs are taken as
independent.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sira_assets.errors import InputError
from sira_assets.pipeline import Settings, settings_for
from sira_assets.plan.figures import Benchmark, Figures, KnobCurve, StageCost
from sira_assets.plan.front import convex_steps
from sira_assets.plan.knobs import KNOBS, Knob, Value, place
from sira_assets.plan.machine import speed

# Share of the time that is planned: the rest is for predictions that fall short. The fits take up what is not needed.
# The cheapest plan is begun without that reserve as well: its fits can give way.
PLANNED_SHARE = 0.92
# Between two measured values of a knob in steps, so many are offered.
BETWEEN = 3
# What is this near the best, in steps worth seeing, is as good: seeds alone move a run by more.
AS_GOOD = 0.5


@dataclass(frozen=True)
class Choice:
    """A knob's value in a plan, with what the curves say of it.

    Parameters
    ----------
    loss : beside the best value measured, in steps worth seeing
    """

    knob: str
    value: Value
    unit: str
    loss: float


@dataclass(frozen=True)
class Plan:
    """What a run is to do, and what it should take.

    Parameters
    ----------
    asked : in the user's words
    stages : (name, seconds) in order, wall-clock on this machine
    memory_bytes : at the peak
    budget_s : None where no time was asked for
    """

    asked: str
    settings: Settings
    choices: tuple[Choice, ...]
    stages: tuple[tuple[str, float], ...]
    memory_bytes: int
    budget_s: float | None = None

    @property
    def seconds(self) -> float:
        """From the photo to the written avatar."""
        return sum(s for _, s in self.stages)

    def after(self, stage: str) -> float:
        """Seconds of all stages behind one."""
        names = [name for name, _ in self.stages]
        return sum(s for _, s in self.stages[names.index(stage) + 1 :]) if stage in names else 0.0


def with_known_start(figures: Figures, here: Benchmark, seconds: float) -> Figures:
    """The figures of a run that took so long to set out: what is known need not be predicted."""
    own = seconds / speed("start", here, figures.benchmark)
    reference = tuple(replace(s, seconds=own) if s.name == "start" else s for s in figures.reference)
    return replace(figures, reference=reference)


def predicted(settings: Settings, figures: Figures, here: Benchmark) -> tuple[tuple[StageCost, ...], float]:
    """Stages of a run of these settings on this machine, and its loss."""
    at = {k.name: _position(k, k.read(settings), figures.curve(k.name)) for k in KNOBS if figures.curve(k.name)}
    return _predicted(at, figures, here)


def plan_of(asked: str, settings: Settings, figures: Figures, here: Benchmark, budget_s: float | None = None) -> Plan:
    """The plan of settings that were chosen already."""
    stages, _ = predicted(settings, figures, here)
    choices = []
    for k in KNOBS:
        curve = figures.curve(k.name)
        if curve is not None:
            losses = curve.losses()
            value = k.read(settings)
            loss = _between(losses, _position(k, value, curve)) - float(losses.min())
            choices.append(Choice(k.name, value, k.unit, loss))
    memory = max(s.memory_bytes for s in stages)
    return Plan(asked, settings, tuple(choices), tuple((s.name, s.seconds) for s in stages), memory, budget_s)


def plan_budget(seconds: float, settings: Settings, figures: Figures, here: Benchmark) -> Plan:
    """The settings that lose least within a time.

    Parameters
    ----------
    seconds : wall-clock, photo to written avatar
    settings : a preset; what no knob touches is kept from it
    here : this machine's benchmark

    Raises
    ------
    InputError : even the cheapest values measured take longer.

    Notes
    -----
    From the draft's values upwards (the preset's, where they are cheaper), or from every knob's cheapest where the
    draft takes too long, always the step that buys most per second and still fits (the greedy rule for a knapsack of
    convex choices; Sinha and Zoltners 1979, DOI 10.1287/opre.27.3.503), as long as a knob is not as good as at its
    best. Nothing is saved below the draft for the sake of another knob: the curves are of procedural heads, and
    photographs are further from the models. Then, cheapest first, the preset's own value of any knob that stands below
    it and was not measured to be worse, where time is left: the curves are of a few scenes, and what those had no use
    for this one may need. The texture size is the most that the time allows: where the photo shows less, a run makes
    its maps smaller.
    """
    offers = {k: _offers(k, curve, figures, here) for k in KNOBS if (curve := figures.curve(k.name)) is not None}
    level = dict.fromkeys(offers, 0)

    def total(at: dict[Knob, Position]) -> float:
        return _seconds({k.name: p for k, p in at.items()}, figures, here)

    preset, draft = (
        {k: _position(k, k.read(s), figures.curve(k.name)) for k in offers} for s in (settings, settings_for("draft"))
    )
    chosen = {k: min(preset[k], draft[k], key=lambda p, k=k: total({k: p})) for k in offers}
    limit = PLANNED_SHARE * seconds
    if total(chosen) <= limit:
        offers = {k: [chosen[k], *_beyond(chosen[k], k, offers[k], figures, here)] for k in offers}
    else:
        chosen = {k: offers[k][0] for k in offers}
    now = total(chosen)
    if now > seconds:
        raise InputError(
            expected=f"a budget that this machine can keep: {np.ceil(now / PLANNED_SHARE):.0f} s or more",
            received=f"{seconds:g} s",
            remedy="allow more time, or use a smaller photo",
        )
    while True:
        best, best_rate = None, 0.0
        for k in offers:
            if level[k] + 1 >= len(offers[k]):
                continue
            raised = offers[k][level[k] + 1]
            cost = total(chosen | {k: raised})
            losses = figures.curve(k.name).losses()
            gain = _between(losses, chosen[k]) - _between(losses, raised)
            rate = gain / max(cost - now, 1e-6)
            if cost <= limit and rate > best_rate:
                best, best_rate = k, rate
        if best is None:
            break
        level[best] += 1
        chosen[best] = offers[best][level[best]]
        now = total(chosen)
    for k in sorted(offers, key=lambda k: total(chosen | {k: preset[k]})):
        # As measured, not as made monotone: what was seen to lose something is not bought back for its price.
        losses = [p.loss for p in figures.curve(k.name).points]
        no_worse = _between(losses, preset[k]) <= _between(losses, chosen[k])
        if no_worse and now < (cost := total(chosen | {k: preset[k]})) <= limit:
            chosen[k], now = preset[k], cost
    photo_decides = settings.texels_per_pixel is not None
    for k, position in chosen.items():
        settings = k.put(settings, _value(k, position, figures.curve(k.name)))
    if photo_decides:
        finest = settings_for("high").texels_per_pixel
        settings = replace(settings, texels_per_pixel=finest, largest_texture=settings.bake.size)
    return plan_of(f"{seconds:g} s", settings, figures, here, seconds)


# Where on a knob's curve: between points i and j, so far from i.
Position = tuple[int, int, float]


def _position(knob: Knob, value: Value, curve: KnobCurve) -> Position:
    return place(tuple(p.value for p in curve.points), value)


def _between(values: Sequence[float], position: Position) -> float:
    i, j, share = position
    return float((1.0 - share) * values[i] + share * values[j])


def _value(knob: Knob, position: Position, curve: KnobCurve) -> Value:
    i, j, share = position
    a, b = curve.points[i].value, curve.points[j].value
    return a if i == j else float(a ** (1.0 - share) * b**share)


def _offers(knob: Knob, curve: KnobCurve, figures: Figures, here: Benchmark) -> list[Position]:
    """The knob's values worth having, cheapest first: on the convex hull of its own curve, the others as referenced, up
    to the first that is as good as the best."""
    positions: list[Position] = []
    for i in range(len(curve.points)):
        positions.append((i, i, 0.0))
        if knob.steps and i + 1 < len(curve.points):
            positions += [(i, i + 1, n / (BETWEEN + 1)) for n in range(1, BETWEEN + 1)]
    costs = [_seconds({knob.name: p}, figures, here) for p in positions]
    losses = [_between(curve.losses(), p) for p in positions]
    hull = convex_steps(costs, losses)
    enough = next(n for n, i in enumerate(hull) if losses[i] <= min(losses) + AS_GOOD)
    return [positions[i] for i in hull[: enough + 1]]


def _beyond(
    position: Position, knob: Knob, offers: Sequence[Position], figures: Figures, here: Benchmark
) -> list[Position]:
    """Those of a knob's offers that cost more than a position and are better."""
    losses = figures.curve(knob.name).losses()
    cost = _seconds({knob.name: position}, figures, here)
    return [
        o
        for o in offers
        if _seconds({knob.name: o}, figures, here) > cost and _between(losses, o) < _between(losses, position)
    ]


def _seconds(at: dict[str, Position], figures: Figures, here: Benchmark) -> float:
    """What a combination takes; knobs that are not named are as in the reference."""
    return sum(s.seconds for s in _predicted(at, figures, here)[0])


def _predicted(at: dict[str, Position], figures: Figures, here: Benchmark) -> tuple[tuple[StageCost, ...], float]:
    """Stages and loss of a combination; knobs that are not named are as in the reference."""
    curves = {name: figures.curve(name) for name in at}
    memory, reference_memory = 0.0, max(s.memory_bytes for s in figures.reference)
    # Memory beyond the reference's adds up; what less would save is not counted on.
    for name, position in at.items():
        memory += max(0.0, _between([p.memory_bytes for p in curves[name].points], position) - reference_memory)
    stages = []
    for stage in figures.reference:
        seconds = stage.seconds * speed(stage.name, here, figures.benchmark)
        for name, position in at.items():
            ratios = [max(p.ratio(stage.name), 1e-6) for p in curves[name].points]
            seconds *= float(np.exp(_between(np.log(ratios), position)))
        stages.append(StageCost(stage.name, seconds, round(stage.memory_bytes + memory)))
    return tuple(stages), sum(_between(curves[n].losses(), p) for n, p in at.items())
