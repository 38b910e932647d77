"""Evaluate many pairs of point and lobe in blocks that fit a core's cache, with or without gradient.

A sum over M lobes at N points makes some twenty arrays of N x M numbers on its way. In blocks they stay in the cache,
and memory does not grow with N; the gradient, too, is taken block by block, from values computed a second time.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

# Twenty float32 arrays of this many numbers are 2.6 MB: a core's second-level cache.
PAIRS = 1 << 15


def in_blocks(
    function: Callable[..., Tensor], per_point: Sequence[Tensor | None], shared: Sequence[Tensor], *, pairs: int
) -> Tensor:
    """function(*per_point, *shared), evaluated for some points at a time.

    Parameters
    ----------
    function : gives one row for each row of `per_point`, independent of the other rows
    per_point : (N, ...) each; None is handed on as it is
    shared : whatever else the function takes
    pairs : numbers that one point costs, the count of lobes

    Returns
    -------
    (N, ...), differentiable any number of times
    """
    rows = max(1, PAIRS // max(pairs, 1))
    if len(per_point[0]) <= rows:
        return function(*per_point, *shared)
    given = [t for t in per_point if t is not None]

    def filled(*tensors: Tensor) -> Tensor:
        points = iter(tensors[: len(given)])
        return function(*(t if t is None else next(points) for t in per_point), *tensors[len(given) :])

    if torch.is_grad_enabled() and any(t.requires_grad for t in (*given, *shared)):
        return _Blocks.apply(filled, rows, len(given), *given, *shared)
    return _forward(filled, rows, given, shared)


def _forward(function: Callable[..., Tensor], rows: int, points: Sequence[Tensor], shared: Sequence[Tensor]) -> Tensor:
    return torch.cat([function(*block, *shared) for block in zip(*(t.split(rows) for t in points), strict=True)])


class _Blocks(torch.autograd.Function):
    """The blocks' values; the graph of each is built, used and dropped within the backward pass."""

    @staticmethod
    def forward(ctx, function, rows, count, *tensors):
        ctx.function, ctx.rows, ctx.count = function, rows, count
        ctx.save_for_backward(*tensors)
        return _forward(function, rows, tensors[:count], tensors[count:])

    @staticmethod
    def backward(ctx, gradient):
        tensors, needed = ctx.saved_tensors, ctx.needs_input_grad[3:]
        if torch.is_grad_enabled():  # asked for a gradient of the gradient: the whole graph is needed
            value = ctx.function(*tensors)
            wanted = [t for t, need in zip(tensors, needed, strict=True) if need]
            found = iter(torch.autograd.grad(value, wanted, gradient, create_graph=True))
            return None, None, None, *(next(found) if need else None for need in needed)
        points, shared = tensors[: ctx.count], tensors[ctx.count :]
        parts: list[list[Tensor]] = [[] for _ in points]
        total: list[Tensor | None] = [None] * len(shared)
        for part, *block in zip(gradient.split(ctx.rows), *(t.split(ctx.rows) for t in points), strict=True):
            leaves = [t.detach().requires_grad_(n) for t, n in zip((*block, *shared), needed, strict=True)]
            with torch.enable_grad():
                value = ctx.function(*leaves)
            found = iter(torch.autograd.grad(value, [t for t in leaves if t.requires_grad], part))
            for i, need in enumerate(needed):
                if need and i < ctx.count:
                    parts[i].append(next(found))
                elif need:
                    j = i - ctx.count
                    one = next(found)
                    total[j] = one if total[j] is None else total[j] + one
        return None, None, None, *(torch.cat(p) if p else None for p in parts), *total
