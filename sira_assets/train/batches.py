"""Batches of training samples: all scenes stacked in memory, drawn by (seed, step) alone, so that runs resume exactly.

Notation: N scenes; B scenes a batch; every tensor is (N, count, ...) in network units.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from sira_assets.train.scenes import SceneSamples


@dataclass(frozen=True)
class SampleTensors:
    """`SceneSamples` of N scenes, stacked; shorter scenes repeat pixels to the common length."""

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


def stack(samples: list[SceneSamples], *, device: str | torch.device = "cpu", dtype=torch.float32) -> SampleTensors:
    """Stack scenes; lengths are brought to the median by repeating or dropping samples evenly."""

    def column(name):
        arrays = [getattr(sample, name) for sample in samples]
        length = int(np.median([len(array) for array in arrays]))
        rows = [array[np.linspace(0, len(array) - 1, length).round().astype(int)] for array in arrays]
        return torch.as_tensor(np.stack(rows), dtype=dtype, device=device)

    return SampleTensors(*(column(name) for name in SampleTensors.__dataclass_fields__))


def step_generator(seed: int, step: int, device: str | torch.device = "cpu") -> torch.Generator:
    """The random generator of one training step: a function of seed and step only."""
    state = np.random.SeedSequence([seed, step]).generate_state(2, np.uint64)
    return torch.Generator(device=device).manual_seed(int(state[0] >> np.uint64(1)))


def draw(
    columns: tuple[Tensor, ...], scenes: Int[Tensor, " B"], count: int, generator: torch.Generator
) -> tuple[Tensor, ...]:
    """`count` samples of each drawn scene: tensors (B * count, ...), the same rows of every column."""
    index = torch.randint(columns[0].shape[1], (len(scenes), count), generator=generator, device=generator.device)
    rows = scenes[:, None].expand_as(index)
    return tuple(column[rows, index].flatten(0, 1) for column in columns)
