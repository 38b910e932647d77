"""Which of some choices are worth having: not dominated, monotone, convex, and where a curve bends.

Notation: a choice has a cost and one or more losses; less of each is better. a dominates b if it is nowhere worse
than b and somewhere better.
"""

from collections.abc import Sequence

import numpy as np


def dominated(costs: Sequence[float], losses: np.ndarray, *, noise: np.ndarray | float = 0.0) -> np.ndarray:
    """(N,) bool: choices that another one dominates.

    Parameters
    ----------
    costs : (N,)
    losses : (N, M)
    noise : (M,) or one number; a loss that is better by no more than this is not better
    """
    costs, losses = np.asarray(costs, np.float64), np.asarray(losses, np.float64).reshape(len(costs), -1)
    out = np.zeros(len(costs), bool)
    for i in range(len(costs)):
        better_somewhere = (losses[i] < losses - noise).any(1)  # i has something that the other has not
        cheaper = costs[i] < costs
        same = (costs == costs[i]) & (losses == losses[i]).all(1)
        out[i] = bool((~better_somewhere & ~cheaper & ~same).any())
    return out


def monotone(losses: Sequence[float], weights: Sequence[float] | None = None) -> np.ndarray:
    """The non-increasing sequence nearest to the losses in least squares (pool adjacent violators).

    What costs more is then never measured as worse: noise is averaged with its neighbours and buys nothing.

    References
    ----------
    Barlow, Bartholomew, Bremner and Brunk 1972, Statistical Inference under Order Restrictions, ISBN 0-471-04970-0.
    """
    blocks: list[list[float]] = []  # mean, weight, length
    for value, weight in zip(losses, weights if weights is not None else [1.0] * len(losses), strict=True):
        blocks.append([float(value), float(weight), 1])
        while len(blocks) > 1 and blocks[-2][0] < blocks[-1][0]:
            mean, weight_, length = blocks.pop()
            before = blocks[-1]
            total = before[1] + weight_
            before[0] = (before[0] * before[1] + mean * weight_) / total
            before[1], before[2] = total, before[2] + length
    return np.concatenate([np.full(int(length), mean) for mean, _, length in blocks]) if blocks else np.zeros(0)


def convex_steps(costs: Sequence[float], losses: Sequence[float]) -> list[int]:
    """The choices on the lower convex hull of (cost, loss), by cost: each step buys less per cost than the one before.

    Parameters
    ----------
    costs : (N,), any order
    losses : (N,)
    """
    order = sorted(range(len(costs)), key=lambda i: (costs[i], losses[i]))
    hull: list[int] = []
    for i in order:
        if hull and losses[i] >= losses[hull[-1]]:
            continue
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            bought = (losses[a] - losses[b]) * (costs[i] - costs[a])
            if bought > (losses[a] - losses[i]) * (costs[b] - costs[a]):
                break
            hull.pop()
        hull.append(i)
    return hull


def knee(costs: Sequence[float], losses: Sequence[float]) -> int | None:
    """Where a curve bends most: the choice furthest below the chord from the cheapest to the best; None if none is.

    Both axes are scaled to the chord's own extent, the cost by its logarithm (Satopaa et al. 2011, Kneedle, DOI
    10.1109/ICDCSW.2011.20).
    """
    if len(costs) < 2:
        return None
    flat = monotone([losses[i] for i in np.argsort(costs, kind="stable")])
    order = np.argsort(costs, kind="stable")
    x = np.log(np.maximum(np.asarray(costs, np.float64)[order], 1e-12))
    if x[-1] <= x[0] or flat[0] <= flat[-1]:
        return None
    x, y = (x - x[0]) / (x[-1] - x[0]), (flat - flat[-1]) / (flat[0] - flat[-1])
    below = (1.0 - x) - y
    return int(order[int(np.argmax(below))]) if below.max() > 1e-9 else None
