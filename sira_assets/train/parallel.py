"""Data-parallel training: every process takes its share of a step's scenes, and all see the gradient of the whole step.

Notation: R processes, rank r; a step of B scenes is cut into R equal runs. Every process draws the same random numbers
for the whole step and computes on its run only, so that R processes make the step that one would, up to rounding.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from sira_assets.errors import InputError


@dataclass(frozen=True)
class Share:
    """What this process does of each step: run `rank` of `size`."""

    rank: int = 0
    size: int = 1

    def rows(self, count: int) -> slice:
        """This process' run of `count` scenes.

        Raises
        ------
        InputError : they cannot be cut into equal runs.
        """
        if count % self.size:
            raise InputError(
                expected=f"scenes a step that {self.size} processes can share evenly",
                received=f"{count}",
                remedy="give torchrun a number of processes that divides it",
            )
        each = count // self.size
        return slice(self.rank * each, (self.rank + 1) * each)

    def mean(self, values: Tensor) -> Tensor:
        """The mean over all processes of equally many values each, with its gradient."""
        return values if self.size == 1 else _Sum.apply(values) / self.size

    def average_gradients(self, parameters: list[nn.Parameter]) -> None:
        """Replace each gradient by its mean over the processes, in one message."""
        if self.size == 1:
            return
        import torch.distributed as dist

        for parameter in parameters:
            if parameter.grad is None:
                parameter.grad = torch.zeros_like(parameter)
        flat = torch.cat([p.grad.flatten() for p in parameters])
        dist.all_reduce(flat)
        flat /= self.size
        for parameter, part in zip(parameters, flat.split([p.numel() for p in parameters]), strict=True):
            parameter.grad.copy_(part.view_as(parameter))

    def wait(self) -> None:
        """Until all processes are here."""
        if self.size > 1:
            import torch.distributed as dist

            dist.barrier()

    @property
    def leads(self) -> bool:
        """Whether this process writes files and reports."""
        return self.rank == 0


class _Sum(torch.autograd.Function):
    """Sum over the processes; as each process' loss depends on each one's values, gradients are summed as well."""

    @staticmethod
    def forward(context, values: Tensor) -> Tensor:
        import torch.distributed as dist

        out = values.clone()
        dist.all_reduce(out)
        return out

    @staticmethod
    def backward(context, gradient: Tensor) -> Tensor:
        import torch.distributed as dist

        out = gradient.clone()
        dist.all_reduce(out)
        return out


@contextmanager
def joined_share(device: str | torch.device = "cpu") -> Iterator[Share]:
    """This process' share, as torchrun's environment says it: gloo on CPU, NCCL on CUDA; alone without torchrun."""
    size = int(os.environ.get("WORLD_SIZE", "1"))
    if size == 1:
        yield Share()
        return
    import torch.distributed as dist

    cuda = torch.device(device).type == "cuda"
    if cuda:
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    dist.init_process_group("nccl" if cuda else "gloo")
    try:
        yield Share(dist.get_rank(), dist.get_world_size())
        dist.barrier()  # nobody leaves while another still waits for an answer
    finally:
        dist.destroy_process_group()
