"""Smooth noise and ramps, as exact functions of position.

Notation: points (N, 3) in millimetres; every function is a finite sum of waves, so it may be evaluated anywhere and at
any resolution, and is the same for the same seed.
"""

from __future__ import annotations

import numpy as np


def smoothstep(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below ``low``, 1 above ``high``, a cubic between."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def plane_noise(x_mm: np.ndarray, seed: int, count: int, wavelength_mm: float) -> np.ndarray:
    """Isotropic noise of unit RMS made of plane waves of 0.6 to 1.8 times the wavelength; (N,)."""
    rng = np.random.default_rng([seed, 29])
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = 2 * np.pi / (wavelength_mm * rng.uniform(0.6, 1.8, (count, 1)))
    phase = rng.uniform(0, 2 * np.pi, count)
    # cosines in single precision: phases stay below some 1e3 rad, so a wave errs by less than 1e-4, and cost a third
    waves = np.cos((x_mm @ (direction * wave).T + phase).astype(np.float32))
    return (waves @ np.full(count, np.sqrt(2.0 / count), np.float32)).astype(np.float64)


def bump(x_mm: np.ndarray, centre: tuple[float, float, float], width: tuple[float, float, float]) -> np.ndarray:
    """Gaussian bumps on both sides of the head: 1 at ``centre`` and at its mirror image; (N,)."""
    folded = np.stack([np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]], -1)
    return np.exp(-0.5 * (((folded - centre) / width) ** 2).sum(-1))


def smooth_min(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Polynomial smooth minimum; equals ``min`` where ``|a - b| >= width``."""
    gap = np.clip(width - np.abs(a - b), 0.0, None)
    return np.minimum(a, b) - gap * gap / (4 * width)


def smooth_max(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Polynomial smooth maximum."""
    return -smooth_min(-a, -b, width)
