"""Which way hair runs: strand coordinates on the scalp, and the relief of its clumps.

Notation: ``u`` the angle across strands (radians, periodic), ``w`` the way along them in units of 75 mm. A *pole* is
where all strands start, a direction from the skull's middle ``SKULL``: strands are the meridians from it. *Parted* hair
starts at a line x = const on top, falls to both sides and hangs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.head.noise import smoothstep

SKULL = np.array([0.0, 22.0, -86.0])


@dataclass(frozen=True)
class Flow:
    """``pole``: a direction, or None for parted hair; ``side``: how far the pole's x follows the parting."""

    pole: tuple[float, float, float] | None = (0.0, 0.94, -0.34)
    side: float = 0.0


def strand_coordinates(x_mm: np.ndarray, flow: Flow, part: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``u``, ``w`` and a fade (0 at the pole, where strands meet) at points (N, 3); each (N,)."""
    d = x_mm - SKULL
    if flow.pole is None:
        # the parting ends at the crown; behind it hair falls from there
        top = smoothstep(x_mm[:, 1], 15.0, 95.0) * smoothstep(x_mm[:, 2], -135.0, -85.0)
        across = np.abs(d[:, 0] - 30.0 * part * top) + 130.0 * top
        return np.arctan2(across, d[:, 2]), -x_mm[:, 1] / 75.0 + across / 150.0, np.ones(len(d))
    a = np.array([flow.pole[0] + flow.side * part, *flow.pole[1:]])
    a = a / np.linalg.norm(a)
    e1 = np.cross(a, [1.0, 0.0, 0.0])
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(a, e1)
    p, q = d @ e1, d @ e2
    r = np.hypot(p, q)
    return np.arctan2(p, q), np.arctan2(r, d @ a) * 1.2, smoothstep(r, 8.0, 32.0)


def _drift(u: np.ndarray, w: np.ndarray, rng: np.random.Generator, count: int, most: int) -> np.ndarray:
    out = np.zeros(len(u))
    for _ in range(count):
        k, slope, phase = int(rng.integers(1, most + 1)), rng.normal() * 1.3, rng.uniform(0, 2 * np.pi)
        out += np.cos(k * u + slope * w + phase)
    return out * np.sqrt(2.0 / count)


def clumps(u: np.ndarray, w: np.ndarray, count: int, seed: int, wave: float = 0.0) -> np.ndarray:
    """Rounded locks with grooves between them, -0.65 to 0.35: ``count`` around the head, of three strands; (N,)."""
    rng = np.random.default_rng([seed, 17])
    even = 2 * max(int(count) // 2, 2)
    u = u + wave * 0.10 * np.sin(3.2 * w + 2.0 * _drift(u, w, rng, 2, 3))
    u = u + (1.9 / even) * _drift(u, w, rng, 5, max(even // 3, 2))
    lock = np.sqrt(np.abs(np.cos(0.5 * even * u)))
    strand = np.abs(np.cos(1.5 * even * u + 1.3 * _drift(u, w, rng, 4, even)))
    return 0.7 * lock + 0.3 * strand - 0.65


def strands(u: np.ndarray, w: np.ndarray, count: int, seed: int, waves: int = 12) -> np.ndarray:
    """Fine streaks along the strands, unit RMS; (N,)."""
    rng = np.random.default_rng([seed, 23])
    out = np.zeros(len(u))
    for _ in range(waves):
        k = int(rng.integers(max(count // 3, 3), count))
        slope, phase, bend = rng.normal() * 3.0, rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.04) * k
        out += np.cos(k * u + slope * w + phase + bend * np.sin(1.7 * w + phase))
    return out * np.sqrt(2.0 / waves)
