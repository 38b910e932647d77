"""Colour of hair: eumelanin and phaeomelanin, white hairs, strand by strand.

Notation: absorption of the two melanins as ratios over R, G, B after d'Eon et al. 2011, DOI
10.1111/j.1467-8659.2011.01976.x; the albedo of a clump falls off exponentially with it.
"""

from __future__ import annotations

import numpy as np

from data_synth.head.cover_params import Pigment
from data_synth.head.hair_styles import STYLES
from data_synth.head.noise import plane_noise, smoothstep
from data_synth.head.params import HeadParams

EUMELANIN = np.array([0.419, 0.697, 1.37])
PHAEOMELANIN = np.array([0.187, 0.400, 1.05])
WHITE = np.array([0.58, 0.56, 0.53])


def hair_albedo(p: Pigment, darker: float = 1.0) -> np.ndarray:
    """Linear Rec. 709 albedo (3,) of pigmented hair; ``darker`` multiplies the pigment."""
    dark = p.hair_melanin**1.4
    eumelanin = dark * (1 - 0.75 * p.hair_redness)
    phaeomelanin = 0.04 + 1.3 * p.hair_redness * (0.3 + 0.7 * np.sqrt(dark))
    absorption = 9.5 * eumelanin * EUMELANIN + 3.4 * phaeomelanin * PHAEOMELANIN
    return 0.008 + 0.52 * np.exp(-1.1 * darker * absorption)


def strand_albedo(x_mm: np.ndarray, params: HeadParams, streaks: np.ndarray, beard: bool = False) -> np.ndarray:
    """Albedo (N, 3) at template points, with ``streaks`` (N,) the strands' unit noise: roots darker, tips lighter."""
    p = params.pigment
    # a person's beard is often darker or redder than the hair
    colour = hair_albedo(p, 1.15 if beard else 1.0)
    if beard:
        colour = colour * np.array([1.0, 0.94, 0.86])
    tip = smoothstep(-x_mm[:, 1], -60.0, 130.0) if STYLES[params.hair_style].curtain is not None else 0.35
    wide = plane_noise(x_mm, params.seed + 121, 10, 30.0)
    light = np.clip(0.85 + 0.30 * tip + 0.17 * streaks + 0.06 * wide, 0.3, 1.9)
    # lighter strands are yellower: the pigment thins out
    out = colour ** (1.0 - 0.10 * np.clip(streaks + 0.5 * tip, -1.5, 1.5))[:, None] * light[:, None]
    white = p.grey * (1.15 if beard else 1.0)
    grey = smoothstep(white * 2.0 + 0.20 * np.clip(streaks, -2, 2) + 0.12 * wide, 0.3, 2.0) * min(6.0 * white, 1.0)
    # white begins at the temples
    side = smoothstep(np.abs(x_mm[:, 0]), 25.0, 65.0) * smoothstep(40.0 - x_mm[:, 1], -40.0, 20.0)
    side = side * smoothstep(x_mm[:, 1], -75.0, -25.0)
    grey = np.clip(grey + 0.45 * side * smoothstep(np.array(p.grey), 0.05, 0.4), 0.0, 1.0)
    return out + (WHITE * np.clip(0.9 + 0.14 * streaks, 0.4, 1.3)[:, None] - out) * grey[:, None]
