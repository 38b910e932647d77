"""Stages go on from a checkpoint to the identical result, survive steps that are not finite, and heed Ctrl-C."""

import os
import signal

import pytest
import torch

from sira_assets.fit.geometry import fit_geometry
from sira_assets.fit.loop import Checkpoint, Stage, run_stages


def problem(count=12, poison=()):
    """Two stages of noisy descent on |x - 1|^2; at the steps of `poison` the loss is NaN."""
    x = torch.nn.Parameter(torch.zeros(5))
    seen = torch.zeros(1)

    def losses(step, generator):
        seen.add_(1.0)
        noise = 0.1 * torch.randn(5, generator=generator)
        return {"far": (x - 1.0 + noise).square().sum() * (torch.nan if int(seen) in poison else 1.0)}

    stages = [Stage("one", count, [([x], 0.2)], losses), Stage("two", count, [([x], 0.05)], losses)]
    return stages, {"x": x, "seen": seen}


class Killed(Exception):
    pass


@pytest.mark.parametrize("at", [1, 5, 11, 12, 13, 20, 23])
def test_a_killed_fit_goes_on_to_the_identical_result(at, tmp_path, monkeypatch):
    monkeypatch.setattr("sira_assets.fit.loop.SAVE_EVERY_SECONDS", -1.0)  # after every step
    stages, whole = problem()
    record = run_stages(stages, whole, seed=3)

    def kill(step, steps):
        if step == at:
            raise Killed

    checkpoint = Checkpoint(tmp_path / "fit.safetensors", "key")
    stages, broken = problem()
    with pytest.raises(Killed):
        run_stages(stages, broken, seed=3, checkpoint=checkpoint, report=kill)
    stages, resumed = problem()
    again = run_stages(stages, resumed, seed=3, checkpoint=checkpoint)
    for name in whole:
        torch.testing.assert_close(whole[name], resumed[name], rtol=0, atol=0)
    assert again.history == record.history


def test_a_checkpoint_of_another_fit_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr("sira_assets.fit.loop.SAVE_EVERY_SECONDS", -1.0)
    stages, state = problem()
    run_stages(stages, state, seed=3, checkpoint=Checkpoint(tmp_path / "fit.safetensors", "another"))
    stages, state = problem()
    run_stages(stages, state, seed=3, checkpoint=Checkpoint(tmp_path / "fit.safetensors", "key"))
    assert int(state["seen"]) == 24


def test_steps_that_are_not_finite_are_taken_back_and_said():
    stages, state = problem(count=60, poison=(7, 30))
    record = run_stages(stages, state, seed=0)
    assert record.warnings == ("one: 2 step(s) were not finite; went back to the last finite state",)
    assert (state["x"] - 1.0).abs().max() < 0.1  # the noise, averaged by a falling rate


def test_a_stage_that_stays_not_finite_ends_early_and_finite():
    stages, state = problem(count=60, poison=range(10, 61))
    record = run_stages(stages, state, seed=0)
    assert "stage was ended" in record.warnings[0]
    assert torch.isfinite(state["x"]).all()
    assert int(state["seen"]) < 100


def test_ctrl_c_saves_after_the_running_step(tmp_path, request):
    checkpoint = Checkpoint(tmp_path / "fit.safetensors", "key")
    stages, whole = problem()
    run_stages(stages, whole, seed=3)
    # A test runner started in the background has SIGINT ignored.
    found = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, found))
    before = signal.getsignal(signal.SIGINT)
    stages, state = problem()

    def press(step, steps):
        if step == 9:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run_stages(stages, state, seed=3, checkpoint=checkpoint, report=press)
    assert signal.getsignal(signal.SIGINT) is before
    stages, resumed = problem()
    run_stages(stages, resumed, seed=3, checkpoint=checkpoint)
    torch.testing.assert_close(whole["x"], resumed["x"], rtol=0, atol=0)
    assert int(resumed["seen"]) == 24  # the nine steps before were not done again


@pytest.mark.parametrize("at", [2, 4, 7, 10, 12])
def test_a_killed_geometry_fit_goes_on_to_the_identical_result(at, tmp_path, monkeypatch):
    from small_portrait import portrait
    from test_fit import GEOMETRY, ball_prior

    monkeypatch.setattr("sira_assets.fit.loop.SAVE_EVERY_SECONDS", -1.0)

    def kill(step, steps):
        if step == at:
            raise Killed

    checkpoint = Checkpoint(tmp_path / "fit.safetensors", "key")
    with pytest.raises(Killed):
        fit_geometry(portrait(), ball_prior(), GEOMETRY, checkpoint=checkpoint, report=kill)
    resumed = fit_geometry(portrait(), ball_prior(), GEOMETRY, checkpoint=checkpoint)
    whole = fit_geometry(portrait(), ball_prior(), GEOMETRY)
    torch.testing.assert_close(whole.z_sdf, resumed.z_sdf, rtol=0, atol=0)
    for a, b in zip(whole.shape.parameters(), resumed.shape.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)
    assert whole.history == resumed.history


def test_a_checkpoint_without_a_tensor_that_is_wanted_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr("sira_assets.fit.loop.SAVE_EVERY_SECONDS", -1.0)
    checkpoint = Checkpoint(tmp_path / "fit.safetensors", "key")
    stages, state = problem()
    run_stages(stages, {k: v for k, v in state.items() if k != "seen"}, seed=3, checkpoint=checkpoint)
    stages, state = problem()
    before = {name: value.clone() for name, value in state.items()}
    run_stages(stages, state, seed=3, checkpoint=checkpoint)
    stages, fresh = problem()
    run_stages(stages, fresh, seed=3)
    for name in before:
        torch.testing.assert_close(state[name], fresh[name], rtol=0, atol=0)
