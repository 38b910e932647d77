"""Checkpoints in safetensors: networks, codes, optimiser moments and the step, so that a resumed run is the same run.

Random numbers are functions of (seed, step), so no generator state is kept.
"""

from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor

from sira_assets.errors import InputError
from sira_assets.fields.tensor_file import write_tensors


def save_checkpoint(
    path: Path,
    tensors: dict[str, Mapping[str, Tensor]],
    optimiser: torch.optim.Optimizer,
    step: int,
    run_digest: str,
    seconds: float,
    facts: str = "",
) -> None:
    """Write `tensors` (name -> state dict) and the optimiser's state after `step` steps and `seconds` of work.

    `facts` is kept as it is, for `read_header`.
    """
    flat = {f"{name}/{key}": value for name, state in tensors.items() for key, value in state.items()}
    for index, state in optimiser.state_dict()["state"].items():
        flat |= {f"optimiser/{index}/{key}": torch.as_tensor(value) for key, value in state.items()}
    header = {
        "step": str(step),
        "digest": run_digest,
        "seconds": repr(float(seconds)),
        "facts": facts,
    }
    write_tensors(path, flat, header)


def read_header(path: Path) -> dict[str, str] | None:
    """step, digest, seconds and facts of a checkpoint; None if there is none that can be read."""
    try:
        with safe_open(path, "pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError):
        return None


def load_checkpoint(
    path: Path,
    tensors: dict[str, Mapping[str, Tensor]],
    optimiser: torch.optim.Optimizer | None,
    run_digest: str,
) -> tuple[int, float]:
    """Fill `tensors` (in place) and the optimiser, if one is given, from a checkpoint.

    Returns
    -------
    step, seconds : steps and seconds of work behind it.

    Raises
    ------
    InputError : damaged, of a run with other settings or scenes, or without some of the tensors.
    """
    header = read_header(path)
    if header is None:
        raise InputError(
            expected=f"a checkpoint at {path}", received="a damaged file", remedy="remove it, or go without --resume"
        )
    if header.get("digest") != run_digest:
        raise InputError(
            expected=f"a checkpoint of this very run at {path}",
            received="one of other settings or scenes",
            remedy="give the settings it was begun with, another --run, or go without --resume",
        )
    flat = load_file(path)
    wanted = {f"{name}/{key}": value.shape for name, state in tensors.items() for key, value in state.items()}
    if any(key not in flat or flat[key].shape != shape for key, shape in wanted.items()):
        raise InputError(
            expected=f"a checkpoint with this run's tensors at {path}",
            received="one of another version",
            remedy="begin anew: remove it, or go without --resume",
        )
    with torch.no_grad():
        for name, state in tensors.items():
            for key, value in state.items():
                value.copy_(flat[f"{name}/{key}"])
    if optimiser is None:
        return int(header["step"]), float(header["seconds"])
    state: dict[int, dict] = {}
    for key, value in flat.items():
        if key.startswith("optimiser/"):
            _, index, name = key.split("/")
            state.setdefault(int(index), {})[name] = value
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
    return int(header["step"]), float(header["seconds"])
