"""One training loop for both models: schedule, guard, data parallelism, checkpoints, exact resume.

Notation: a step is a function of (seed, step) and of the state alone, so that a stopped run goes on as if it had never
stopped. The loss is sum_i weight_i term_i.
"""

import hashlib
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from sira_assets.errors import InputError
from sira_assets.train.adam import Adam
from sira_assets.train.checkpoint import load_checkpoint, save_checkpoint
from sira_assets.train.guard import GuardedOptimiser
from sira_assets.train.parallel import Share

WARM_UP = 100
LAST_RATE = 0.02
REPORT_EVERY = 50


@dataclass(frozen=True)
class Trainee:
    """What learns: networks at `rate`, tables of codes (one row a scene) at `code_rate`."""

    networks: nn.Module
    codes: Mapping[str, nn.Parameter]
    rate: float
    code_rate: float

    def parameters(self) -> list[nn.Parameter]:
        """All of it, networks first."""
        return [*self.networks.parameters(), *self.codes.values()]

    def optimiser(self) -> Adam:
        """Adam with the two rates."""
        return Adam(
            [
                {"params": list(self.networks.parameters()), "lr": self.rate},
                {"params": list(self.codes.values()), "lr": self.code_rate},
            ]
        )

    def tensors(self) -> dict[str, dict[str, Tensor]]:
        """State to keep, by name; the tensors themselves, not copies."""
        return {"model": self.networks.state_dict(), "codes": {k: v.data for k, v in self.codes.items()}}


@dataclass(frozen=True)
class LoopConfig:
    """Steps in all, steps between checkpoints, and whether to go on from the checkpoint that is there."""

    steps: int
    save_every: int = 500
    resume: bool = False


def digest(*parts: object) -> str:
    """Sixteen hex digits that change with anything that decides a run."""
    return hashlib.sha256("\n".join(map(repr, parts)).encode()).hexdigest()[:16]


def tensors_digest(tensors: Mapping[str, Tensor]) -> str:
    """Sixteen hex digits that change with any bit of named tensors."""
    summed = hashlib.sha256()
    for name, value in tensors.items():
        summed.update(f"{name} {value.dtype} {tuple(value.shape)} ".encode())
        summed.update(value.detach().cpu().contiguous().numpy().tobytes())
    return summed.hexdigest()[:16]


def learning_rate(step: int, steps: int) -> float:
    """Factor of the rate: 100 steps of warm-up, then a cosine to a fiftieth."""
    warm = min(1.0, (step + 1) / WARM_UP)
    fraction = min(step / max(steps, 1), 1.0)
    return warm * (LAST_RATE + (1.0 - LAST_RATE) * 0.5 * (1.0 + float(torch.cos(torch.tensor(torch.pi * fraction)))))


def train(
    trainee: Trainee,
    terms: Callable[[int], dict[str, Tensor]],
    weights: Mapping[str, float],
    path: Path,
    config: LoopConfig,
    *,
    run_digest: str,
    share: Share = Share(),
    after_backward: Callable[[int], None] = lambda step: None,
    report: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> float:
    """Train to `config.steps`, keeping the checkpoint at `path` up to date.

    Parameters
    ----------
    terms : step -> loss terms of this process' share of the step
    weights : of the terms, by name
    run_digest : of all that decides the run; a checkpoint with another one is refused
    after_backward : may change or drop the gradients of the whole step, the same in every process
    report : called every fifty steps with the terms (the first process only)

    Returns
    -------
    Seconds of all sessions of the run together.

    Raises
    ------
    InputError : the checkpoint is of another run, or the loss stopped being finite for good.
    """
    optimiser = trainee.optimiser()
    rates = [group["lr"] for group in optimiser.param_groups]
    start, before = 0, 0.0
    if config.resume and path.exists():
        start, before = load_checkpoint(path, trainee.tensors(), optimiser, run_digest)
    guard = GuardedOptimiser(optimiser, clip=1.0, clipped=list(trainee.networks.parameters()))
    began = time.monotonic()
    for step in range(start, config.steps):
        for group, rate in zip(optimiser.param_groups, rates, strict=True):
            group["lr"] = rate * learning_rate(step, config.steps)
        losses = terms(step)
        total = sum(weights[name] * value for name, value in losses.items())
        # A refusal must be every process' refusal: the averaged loss is finite only if each is.
        accepted = guard.backward(share.mean(total.detach()) * 0.0 + total)
        if accepted:
            # Averaging gives every parameter a gradient, so what is held is held after it.
            share.average_gradients(trainee.parameters())
            after_backward(step)
            accepted = guard.step()
        if not accepted:
            message = f"{path.stem}: step {step + 1} was not finite; went back to the last finite state"
            warnings.warn(message, stacklevel=2)
        if guard.exhausted:
            raise InputError(
                expected="finite losses",
                received=f"{guard.refused} steps whose loss or gradient was not finite, the last one {step + 1}",
                remedy="lower the rate, or check the scenes' images and distances",
            )
        done = step + 1
        if share.leads and (done % REPORT_EVERY == 0 or done == config.steps):
            report(done, {name: float(value.detach()) for name, value in losses.items()})
        if share.leads and (done % config.save_every == 0 or done == config.steps):
            seconds = before + time.monotonic() - began
            save_checkpoint(path, trainee.tensors(), optimiser, done, run_digest, seconds)
    return before + time.monotonic() - began
