"""Sums of compact bells: the local displacements that named shape and relief are made of.

Notation: bell ``j`` has centre ``c_j`` and widths ``w_j`` (mm, one an axis) and moves points by
``v_j B((x - c_j) / w_j)`` with ``B(q) = (1 - |q|^2 / 12)^6`` inside ``|q|^2 < 12`` and 0 outside. ``B`` is within 0.05
of the Gaussian ``exp(-|q|^2 / 2)`` (``(1 - a / n)^n`` tends to ``exp(-a)``), five times differentiable, and exactly
zero beyond 3.47 widths, so that leaving out what does not reach a point changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

REACH = np.sqrt(12.0)


@dataclass(frozen=True)
class Bells:
    """Centres and widths (Q, 3) in millimetres and a vector (Q, C) each: C columns of the sum."""

    centre_mm: np.ndarray
    width_mm: np.ndarray
    vector: np.ndarray


def bell(squared: np.ndarray) -> np.ndarray:
    """``B`` of the squared scaled distance."""
    t = np.maximum(1.0 - squared / 12.0, 0.0)
    t = t * t
    return t * t * t


def join(parts: list[Bells]) -> Bells:
    """One sum of several."""
    return Bells(
        np.concatenate([p.centre_mm for p in parts]),
        np.concatenate([p.width_mm for p in parts]),
        np.concatenate([p.vector for p in parts]),
    )


def sum_bells(bells: Bells, x_mm: np.ndarray, cell_mm: float = 24.0) -> np.ndarray:
    """The sum at points (N, 3) in millimetres: (N, C). Points are taken cell by cell with the bells that reach it."""
    out = np.zeros((len(x_mm), bells.vector.shape[1]))
    live = np.any(bells.vector != 0.0, axis=1)
    if not live.any() or not len(x_mm):
        return out
    centre, width, vector = bells.centre_mm[live], bells.width_mm[live], bells.vector[live]
    key = np.floor(x_mm / cell_mm).astype(np.int64) + 512
    code = (key[:, 0] * 1024 + key[:, 1]) * 1024 + key[:, 2]
    order = np.argsort(code, kind="stable")
    starts = np.flatnonzero(np.diff(code[order], prepend=-1))
    for a, b in zip(starts, [*starts[1:], len(order)], strict=True):
        own = order[a:b]
        x = x_mm[own]
        low, high = x.min(0), x.max(0)
        # the scaled distance from a centre to the points' box
        away = np.maximum(np.maximum(low - centre, centre - high), 0.0) / width
        near = (away**2).sum(1) < REACH**2
        if near.any():
            c, inverse = centre[near], 1.0 / width[near]
            q = x[:, 0:1] * inverse[:, 0] - c[:, 0] * inverse[:, 0]
            squared = q * q
            for k in (1, 2):
                q = x[:, k : k + 1] * inverse[:, k] - c[:, k] * inverse[:, k]
                squared += q * q
            out[own] = bell(squared) @ vector[near]
    return out
