"""Stages of a fit: cosine schedules, guarded steps, checkpoints inside a stage, and an interrupt that saves.

Notation: a fit is a list of stages; step s counts through all of them. Random numbers of a step are a function of
(seed, s), and a checkpoint holds every tensor that steps change, so that a killed fit goes on to the same result. A fit
that keeps a pace does as many steps as the clock lets it, so it cannot be gone on with exactly and keeps no checkpoint.
"""

import json
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from sira_assets.errors import InputError
from sira_assets.fit.pace import Pace, StageKept, progress
from sira_assets.train.adam import Adam
from sira_assets.train.batches import step_generator
from sira_assets.train.checkpoint import load_checkpoint, read_header, save_checkpoint
from sira_assets.train.guard import GuardedOptimiser

HISTORY_EVERY = 10
SAVE_EVERY_SECONDS = 10.0


@dataclass(frozen=True)
class Stage:
    """Some steps of one optimiser.

    Parameters
    ----------
    groups : (parameters, rate) each; rates fall to nothing along a cosine
    losses : (planned step of the stage, generator) -> weighted terms, whose sum is the loss
    begin : called before the first step
    enter : called whenever the stage is entered, also when it is gone on with
    before_step : called with each planned step of the stage, also with those that a pace skips
    work : how long a step takes, beside the other stages' steps; what a pace shares the time out by
    """

    name: str
    steps: int
    groups: Sequence[tuple[Sequence[Tensor], float]]
    losses: Callable[[int, torch.Generator], dict[str, Tensor]]
    begin: Callable[[], None] = lambda: None
    enter: Callable[[], None] = lambda: None
    before_step: Callable[[int, torch.Generator], None] = lambda step, generator: None
    work: float = 1.0


@dataclass(frozen=True)
class Checkpoint:
    """Where a fit keeps its state while it runs, and the key that says which fit it is."""

    path: Path
    key: str


@dataclass(frozen=True)
class FitRecord:
    """What a fit's stages leave besides their tensors.

    Parameters
    ----------
    history : (step, terms) every ten steps
    warnings : one line each, for the report
    seconds : of all sessions together
    """

    history: tuple[tuple[int, dict[str, float]], ...]
    warnings: tuple[str, ...]
    seconds: float


def run_stages(
    stages: Sequence[Stage],
    state: Mapping[str, Tensor],
    *,
    seed: int,
    device: str | torch.device = "cpu",
    bfloat16: bool = False,
    checkpoint: Checkpoint | None = None,
    pace: Pace | None = None,
    report: Callable[[int, int], None] = lambda step, steps: None,
) -> FitRecord:
    """Run all stages; with a checkpoint of this very fit, go on from it.

    Parameters
    ----------
    state : every tensor that a stage changes, all of them changed in place only
    bfloat16 : hidden layers run in bfloat16 (`fields.mlp.MLP`)
    pace : when to be over; not together with a checkpoint
    report : called with (steps done, steps in all), counted as planned

    Raises
    ------
    ValueError : a checkpoint and a pace.
    KeyboardInterrupt : Ctrl-C, after the running step, its state saved if there is a checkpoint.
    """
    if checkpoint is not None and pace is not None:
        raise ValueError("steps that depend on the clock cannot be gone on with from a checkpoint")
    began, total = time.monotonic(), sum(stage.steps for stage in stages)
    done, facts = _resumed(checkpoint, state)
    history, warnings = [tuple(row) for row in facts["history"]], list(facts["warnings"])
    saved_at = time.monotonic()
    ends = 0

    def save(optimiser):
        now = {"history": history, "warnings": warnings, "key": checkpoint.key}
        seconds = facts["seconds"] + time.monotonic() - began
        save_checkpoint(checkpoint.path, {"state": state}, optimiser, done, checkpoint.key, seconds, json.dumps(now))

    with _deferred_interrupt() as interrupted:
        for number, stage in enumerate(stages):
            start, ends = ends, ends + stage.steps
            if done >= ends:
                continue
            entered_at = pace.clock() if pace is not None else 0.0
            if done == start:
                stage.begin()
            stage.enter()
            optimiser = Adam([{"params": list(p), "lr": rate} for p, rate in stage.groups])
            if done > start:
                load_checkpoint(checkpoint.path, {"state": state}, optimiser, checkpoint.key)
            guard = GuardedOptimiser(optimiser)
            made, entered = 0, done - start
            work = [s.work * s.steps for s in stages[number:] if s.steps]
            for p in progress(stage.steps, first=done - start, pace=pace, work=work):
                # Exact where there is no pace: the step that p was made from.
                step = int(p * stage.steps + 1e-6)
                done = start + step
                # A pace that makes more steps than planned still draws other random numbers for each.
                generator = step_generator(seed, done if pace is None else start + made, device)
                turned = math.pi * step / stage.steps if pace is None else math.pi * p
                for group, (_, rate) in zip(optimiser.param_groups, stage.groups, strict=True):
                    group["lr"] = rate * 0.5 * (1.0 + math.cos(turned))
                for planned in range(entered, step + 1):
                    stage.before_step(planned, generator)
                entered = max(entered, step + 1)
                with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=bfloat16):
                    terms = stage.losses(step, generator)
                accepted = guard.backward(sum(terms.values())) and guard.step()
                if accepted and (done if pace is None else made) % HISTORY_EVERY == 0:
                    history.append((done, {name: float(value.detach()) for name, value in terms.items()}))
                done, made = done + 1, made + 1
                report(done, total)
                if guard.exhausted:
                    done = ends
                late = time.monotonic() - saved_at > SAVE_EVERY_SECONDS
                if checkpoint is not None and done < ends and (late or interrupted()):
                    save(optimiser)
                    saved_at = time.monotonic()
                if interrupted():
                    raise KeyboardInterrupt
                if guard.exhausted:
                    break
            done = ends
            if pace is not None:
                pace.note(StageKept(stage.name, stage.steps, made, pace.clock() - entered_at))
            if guard.refused:
                ended = ", and the stage was ended" if guard.exhausted else ""
                warnings.append(
                    f"{stage.name}: {guard.refused} step(s) were not finite; went back to the last finite state{ended}"
                )
    return FitRecord(tuple(history), tuple(warnings), facts["seconds"] + time.monotonic() - began)


def _resumed(checkpoint: Checkpoint | None, state: Mapping[str, Tensor]) -> tuple[int, dict]:
    """Steps done and facts of the checkpoint, its tensors in place; nothing done if it is none of this fit's."""
    fresh = {"history": [], "warnings": [], "seconds": 0.0}
    header = read_header(checkpoint.path) if checkpoint is not None else None
    if header is None or header.get("digest") != checkpoint.key:
        return 0, fresh
    try:
        step, seconds = load_checkpoint(checkpoint.path, {"state": state}, None, checkpoint.key)
    except InputError:  # of another version: as good as none
        return 0, fresh
    return step, json.loads(header["facts"]) | {"seconds": seconds}


@contextmanager
def _deferred_interrupt() -> Iterator[Callable[[], bool]]:
    """Ctrl-C is noted and asked for between steps; a second one interrupts at once."""
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    pressed = []
    before = signal.getsignal(signal.SIGINT)

    def note(number, frame):
        if pressed and callable(before):
            before(number, frame)
        pressed.append(number)

    # Where Ctrl-C is ignored (a job in the background), it stays ignored.
    if callable(before):
        signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(pressed)
    finally:
        if callable(before):
            signal.signal(signal.SIGINT, before)
