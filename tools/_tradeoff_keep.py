"""Stages that are measured once and kept: the same stage of the same inputs is not run again.

Notation: a stage's key is a digest of its name and of everything it was given, content by content, so a stage behind an
unchanged one is found again whatever setting led there.
"""

import gc
import hashlib
import os
import pickle
import re
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path

import numpy as np

# Seconds of these are worth a file; the others are kept in memory, the last few of each.
ON_DISK = ("fit geometry", "fit appearance")
IN_MEMORY = 3
# Options that do not change a stage's result, or that make it depend on the clock.
ASIDE = ("report", "checkpoint")


@dataclass(frozen=True)
class StageRun:
    """What a stage took: processor seconds with its children's, wall-clock seconds, memory resident at its peak."""

    name: str
    cpu_s: float
    wall_s: float
    memory_bytes: int


class FarEnough(Exception):
    """A run that was asked to end here."""


class StageKeeper:
    """A `pipeline.run` runner that measures stages and keeps what they made.

    Parameters
    ----------
    folder : for what is kept on disk

    Attributes
    ----------
    runs : measurements since `begin`
    made : stage -> what it made last
    """

    def __init__(self, folder: Path):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._held: dict[str, OrderedDict[str, tuple[object, StageRun]]] = {}
        self.begin()

    def begin(self, *, last: str | None = None, left_out: tuple[str, ...] = ()) -> None:
        """Forget the last run's measurements.

        Parameters
        ----------
        last : raise `FarEnough` when this stage is done
        left_out : stages that are not run where they can be helped: what they made last is given instead
        """
        self.runs: list[StageRun] = []
        self.made: dict[str, object] = {}
        self._last, self._left_out = last, left_out

    def __call__(self, name: str, function: Callable, *arguments, **options):
        """Run the stage or find it; its measurement goes to `runs`."""
        if name in self._left_out and self._held.get(name):
            return next(reversed(self._held[name].values()))[0]
        given = {k: v for k, v in options.items() if k not in ASIDE}
        key = digest((name, arguments, given))
        out, run = self._find(name, key)
        if run is None:
            out, run = measured(name, function, *arguments, **options)
            self._keep(name, key, out, run)
        self.runs.append(run)
        self.made[name] = out
        if name == self._last:
            raise FarEnough
        return out

    def _find(self, name: str, key: str) -> tuple[object, StageRun | None]:
        held = self._held.setdefault(name, OrderedDict())
        if key in held:
            held.move_to_end(key)
            return held[key]
        path = self.folder / f"{key}.pickle"
        if name in ON_DISK and path.is_file():
            try:
                found = pickle.loads(path.read_bytes())
            except (EOFError, pickle.UnpicklingError, AttributeError, ImportError):
                return None, None
            held[key] = found
            return found
        return None, None

    def _keep(self, name: str, key: str, out: object, run: StageRun) -> None:
        from sira_assets.atomic import replacing

        held = self._held.setdefault(name, OrderedDict())
        held[key] = (out, run)
        while len(held) > IN_MEMORY:
            held.popitem(last=False)
        if name in ON_DISK:
            with replacing(self.folder / f"{key}.pickle") as temporary:
                temporary.write_bytes(pickle.dumps((out, run)))


def measured(name: str, function: Callable, *arguments, **options) -> tuple[object, StageRun]:
    """Call a function and say what it took."""
    gc.collect()
    reset = reset_peak()
    cpu, wall = processor_seconds(), time.perf_counter()
    out = function(*arguments, **options)
    run = StageRun(name, processor_seconds() - cpu, time.perf_counter() - wall, peak_bytes() if reset else 0)
    return out, run


def processor_seconds() -> float:
    """Of this process and of its children that have ended."""
    t = os.times()
    return t.user + t.system + t.children_user + t.children_system


def reset_peak() -> bool:
    """Make the kernel forget this process's peak of memory (Linux: proc(5), clear_refs); whether it did."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def peak_bytes() -> int:
    """Most memory resident since `reset_peak`; 0 where the system does not say."""
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    except OSError:
        return 0
    return 1024 * int(found.group(1)) if found else 0


def digest(value: object) -> str:
    """Hexadecimal digest of what a value holds: arrays, tensors, networks, dataclasses, and what Python prints exactly.

    Raises
    ------
    TypeError : a value of which it cannot be told.
    """
    into = hashlib.sha256()
    _feed(value, into)
    return into.hexdigest()[:32]


def _feed(value: object, into) -> None:
    import torch

    into.update(type(value).__name__.encode() + b"(")
    if value is None or isinstance(value, bool | int | float | str | bytes | Path):
        into.update(repr(value).encode())
    elif isinstance(value, np.ndarray):
        into.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, torch.Tensor):
        _feed(value.detach().cpu().numpy(), into)
    elif isinstance(value, torch.nn.Module):
        _feed(getattr(value, "config", None), into)
        _feed(dict(value.state_dict()), into)
    elif is_dataclass(value):
        for field in fields(value):
            into.update(field.name.encode())
            _feed(getattr(value, field.name), into)
    elif isinstance(value, Mapping):
        for key in sorted(value, key=repr):
            into.update(repr(key).encode())
            _feed(value[key], into)
    elif isinstance(value, tuple | list):
        for item in value:
            _feed(item, into)
    elif isinstance(value, np.generic | torch.device | torch.dtype):
        into.update(repr(value).encode())
    else:
        raise TypeError(f"no digest of a {type(value).__name__}")
    into.update(b")")
