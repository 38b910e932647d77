"""Batches of training samples: drawn by (seed, step) alone, so that runs resume exactly, from memory or from disk.

Notation: N scenes; B scenes a batch, of which a process computes a run of b; every tensor is (N, count, ...) in network
units.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from sira_assets.atomic import write_text
from sira_assets.train.parallel import Share
from sira_assets.train.scenes import SceneSamples


@dataclass(frozen=True)
class SampleTensors:
    """`SceneSamples` of N scenes, stacked; shorter scenes repeat samples to the common length."""

    surface: Tensor
    surface_normals: Tensor
    volume: Tensor
    volume_sdf: Tensor
    anchors: Tensor
    pixels: Tensor
    pixel_normals: Tensor
    pixel_view: Tensor
    pixel_rgb: Tensor
    pixel_diffuse: Tensor
    pixel_specular: Tensor

    def __len__(self) -> int:
        return len(self.surface)

    def to(self, device: str | torch.device) -> "SampleTensors":
        """The samples in another device's memory."""
        return SampleTensors(*(getattr(self, field.name).to(device) for field in fields(self)))


def stack(
    samples: Sequence[SceneSamples], *, device: str | torch.device = "cpu", dtype: torch.dtype = torch.float32
) -> SampleTensors:
    """Stack scenes in memory; lengths are brought to the median by repeating or dropping samples evenly."""
    lengths = _lengths(samples)
    columns = (
        np.stack([_brought_to(getattr(sample, name), length, name) for sample in samples])
        for name, length in lengths.items()
    )
    return SampleTensors(*(torch.as_tensor(column, dtype=dtype, device=device) for column in columns))


def write_stack(samples: Sequence[SceneSamples], folder: Path) -> None:
    """`stack` as files in `folder`, one a column, for sets larger than memory; nothing if they are there already.

    Parameters
    ----------
    samples : a sequence that may load each scene as it is asked for; read twice, one scene at a time
    folder : name it by what it holds: it is not compared with the samples
    """
    done = folder / "complete"
    if done.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    columns: dict[str, np.memmap] = {}
    lengths = _lengths(samples)
    for row, sample in enumerate(samples):
        for name, length in lengths.items():
            values = _brought_to(getattr(sample, name), length, name).astype(np.float32)
            if row == 0:
                shape = (len(samples), *values.shape)
                columns[name] = np.lib.format.open_memmap(folder / f"{name}.npy", "w+", np.float32, shape)
            columns[name][row] = values
    for column in columns.values():
        column.flush()
    write_text(done, f"{len(samples)} scenes\n")


def open_stack(folder: Path) -> SampleTensors:
    """What `write_stack` wrote, memory-mapped: batches page in what they draw."""
    # Copy-on-write: torch wants writable memory, and nothing writes.
    opened = (np.load(folder / f"{field.name}.npy", mmap_mode="c") for field in fields(SampleTensors))
    return SampleTensors(*(torch.from_numpy(column) for column in opened))


def _lengths(samples: Sequence[SceneSamples]) -> dict[str, int]:
    """Rows of each column: the median over the scenes; of anchors, which are in correspondence, the most."""
    names = [field.name for field in fields(SceneSamples)]
    counts = np.array([[len(getattr(sample, name)) for name in names] for sample in samples])
    return {
        name: int(counts[:, k].max() if name == "anchors" else np.median(counts[:, k])) for k, name in enumerate(names)
    }


def _brought_to(array: np.ndarray, length: int, name: str) -> np.ndarray:
    if name == "anchors":  # unknown ones are NaN
        return np.concatenate([array, np.full((length - len(array), 3), np.nan, array.dtype)])
    return array[np.linspace(0, len(array) - 1, length).round().astype(int)]


def step_generator(seed: int, step: int, device: str | torch.device = "cpu") -> torch.Generator:
    """The random generator of one step: a function of seed and step only (and of the device that it draws on)."""
    state = np.random.SeedSequence([seed, step]).generate_state(2, np.uint64)
    return torch.Generator(device).manual_seed(int(state[0] >> np.uint64(1)))


@dataclass(frozen=True)
class Batch:
    """One step's draw: B scenes, of which this process computes `mine`; its tensors go to `device`."""

    scenes: Int[Tensor, " B"]
    mine: slice
    generator: torch.Generator
    device: torch.device

    @staticmethod
    def of_step(
        seed: int, step: int, scenes: int, in_all: int, share: Share = Share(), device: str | torch.device = "cpu"
    ) -> "Batch":
        """Draw `scenes` of `in_all` scenes."""
        generator = step_generator(seed, step)
        chosen = torch.randperm(in_all, generator=generator)[: min(scenes, in_all)]
        return Batch(chosen, share.rows(len(chosen)), generator, torch.device(device))

    @property
    def own(self) -> Int[Tensor, " b"]:
        """The scenes of this process."""
        return self.scenes[self.mine]

    def draw(self, columns: tuple[Tensor, ...], count: int) -> tuple[Tensor, ...]:
        """`count` samples of each of this process' scenes: tensors (b * count, ...), the same rows of every column."""
        index = torch.randint(columns[0].shape[1], (len(self.scenes), count), generator=self.generator)[self.mine]
        rows = self.own[:, None].expand_as(index)
        return tuple(self._take(column, (rows, index)).flatten(0, 1) for column in columns)

    def same_of_all(self, column: Tensor, count: int, always: int = 0) -> Tensor:
        """The same `count` rows of each of this process' scenes, (b, count, ...), the first `always` among them."""
        rest = always + torch.randperm(column.shape[1] - always, generator=self.generator)
        index = torch.cat([torch.arange(always), rest])[:count]
        return self._take(column, (self.own[:, None], index[None]))

    def normal(self, *shape: int) -> Tensor:
        """Gaussian numbers (b * n, ...) out of those (B * n, ...) of the whole step; shape = (n, ...)."""
        n = shape[0]
        numbers = torch.randn(len(self.scenes) * n, *shape[1:], generator=self.generator)
        return numbers[self.mine.start * n : self.mine.stop * n].to(self.device)

    def codes(self, table: Tensor, repeats: int = 1) -> Tensor:
        """This process' rows of a table of codes, each repeated."""
        return table[self.own.to(table.device)].repeat_interleave(repeats, 0)

    def _take(self, column: Tensor, index: tuple[Tensor, ...]) -> Tensor:
        return column[tuple(i.to(column.device) for i in index)].to(self.device)
