"""Checkpoints in safetensors: networks, codes, optimiser moments and the step, so that a resumed run is the same run.

Random numbers are functions of (seed, step), so no generator state is kept.
"""

import json
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from sira_assets.atomic import replacing


def save_checkpoint(path: Path, tensors: dict, optimiser, schedule, step: int) -> None:
    """Write `tensors` (name -> state dict) and the optimiser's state after `step` steps."""
    flat = {f"{name}/{key}": value for name, state in tensors.items() for key, value in state.items()}
    for index, state in optimiser.state_dict()["state"].items():
        flat |= {f"optimiser/{index}/{key}": torch.as_tensor(value) for key, value in state.items()}
    header = {"step": str(step), "schedule": json.dumps({"last_epoch": schedule.last_epoch})}
    with replacing(path) as temporary:
        save_file({key: value.detach().cpu().contiguous() for key, value in flat.items()}, temporary, header)


def load_checkpoint(path: Path, tensors: dict, optimiser, schedule) -> int:
    """Fill `tensors` (in place) and the optimiser from a checkpoint; the number of steps done."""
    from safetensors import safe_open

    flat = load_file(path)
    with safe_open(path, "pt") as file:
        header = file.metadata()
    with torch.no_grad():
        for name, state in tensors.items():
            for key, value in state.items():
                value.copy_(flat[f"{name}/{key}"])
    state: dict[int, dict] = {}
    for key, value in flat.items():
        if key.startswith("optimiser/"):
            _, index, name = key.split("/")
            state.setdefault(int(index), {})[name] = value
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
    step = int(header["step"])
    schedule.last_epoch = json.loads(header["schedule"])["last_epoch"]
    for group, base, factor in zip(optimiser.param_groups, schedule.base_lrs, schedule.lr_lambdas, strict=True):
        group["lr"] = base * factor(schedule.last_epoch)
    return step
