"""Skin over the face: where blood and melanin are more or less, and how oily it is.

Notation: template frame, millimetres. Pigments are multiplied region by region and then turned into colour by
`data_synth.head.skin`; ``ks`` is the specular scale of the real scenes (1 is F0 = 0.04).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.head.beard import LIP_X, inside_lips_mm
from data_synth.head.noise import bump, plane_noise, smoothstep
from data_synth.head.params import HeadParams
from data_synth.head.skin import skin_albedo

_SLIT_X = np.array([0.0, 5.0, 9.8, 16.0, 21.7, 25.4])
_SLIT_Y = np.array([-68.9, -68.6, -68.6, -69.2, -70.1, -70.5])
_SLIT_Z = np.array([26.5, 26.0, 25.0, 22.0, 18.5, 15.5])


@dataclass(frozen=True)
class MouthMasks:
    """At N points, [0, 1]: vermilion, the line where the lips meet, and what lies behind it."""

    lips: np.ndarray
    line: np.ndarray
    inner: np.ndarray


def mouth_masks(x_mm: np.ndarray, params: HeadParams) -> MouthMasks:
    """Coverage at template points (N, 3)."""
    x, y, z = np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]
    front = smoothstep(z, 6.0, 10.0)
    ragged = 0.18 * plane_noise(x_mm, params.seed + 111, 10, 3.0)
    lips = smoothstep(inside_lips_mm(x_mm) + ragged, -0.9, 0.9) * smoothstep(LIP_X[-1] + 0.6 - x, 0.0, 2.5) * front
    off = y - np.interp(x, _SLIT_X, _SLIT_Y)
    line = np.exp(-0.5 * (off / 0.7) ** 2) * smoothstep(27.0 - x, 0.0, 3.0) * front
    behind = smoothstep(np.interp(x, _SLIT_X, _SLIT_Z) - 2.2 - z, 0.0, 2.5)
    inner = behind * np.exp(-0.5 * (off / 2.2) ** 4) * smoothstep(26.0 - x, 0.0, 3.0) * smoothstep(z, -20.0, -10.0)
    return MouthMasks(lips, line, inner)


def nostril_mask(x_mm: np.ndarray) -> np.ndarray:
    """The inside of the nostrils, [0, 1]."""
    x, y, z = np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]
    return np.exp(-0.5 * (((x - 7.8) / 4.0) ** 2 + ((y + 40.0) / 2.2) ** 2 + ((z - 21.0) / 5.2) ** 2) ** 2)


def _spots(x_mm: np.ndarray, centre: np.ndarray, size: np.ndarray, strength: np.ndarray) -> np.ndarray:
    out = np.zeros(len(x_mm))
    for c, r, s in zip(centre, size, strength, strict=True):
        near = np.flatnonzero(np.abs(x_mm - c).max(1) < 12.0)
        out[near] += s * np.exp(-0.5 * (((x_mm[near] - c) / [r, r, 4.0]) ** 2).sum(-1))
    return out


def _melanin_spots(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Melanin (volume fraction) that freckles and moles add."""
    p = params.pigment
    out = np.zeros(len(x_mm))
    rng = np.random.default_rng([params.seed, 41])
    if p.freckles:
        centre = rng.normal([0, -18, 22], [34, 18, 20], (170, 3))
        centre[140:] = rng.uniform([-70, -100, -40], [70, 80, 40], (30, 3))
        strength = p.freckles * rng.uniform(0.015, 0.06, 170)
        out += _spots(x_mm, centre, rng.uniform(0.45, 1.2, 170), strength)
    count = int(rng.poisson(7.0 * p.moles))
    if count:
        centre = rng.uniform([-75, -170, -60], [75, 70, 30], (count, 3))
        out += _spots(x_mm, centre, rng.uniform(0.6, 1.7, count), rng.uniform(0.08, 0.30, count))
    return out


def skin_colour(x_mm: np.ndarray, params: HeadParams, mouth: MouthMasks, moist: np.ndarray) -> np.ndarray:
    """Diffuse albedo (N, 3) of bare skin, lips included, linear Rec. 709."""
    p = params.pigment
    red = 1.0 * bump(x_mm, (36, -36, 8), (15, 13, 18)) + 1.1 * bump(x_mm, (0, -34, 38), (11, 9, 14))
    red += 0.5 * bump(x_mm, (13, -40, 22), (5, 6, 8)) + 0.3 * bump(x_mm, (0, -100, 16), (14, 10, 12))
    red += 1.3 * bump(x_mm, (86, -28, -84), (9, 28, 18))
    red += 0.5 * bump(x_mm, (31, -10, 8), (11, 5, 8)) + 0.5 * bump(x_mm, (18, -5, 7), (4, 4, 5)) + 1.6 * moist
    pale = 0.22 * bump(x_mm, (0, 55, 10), (45, 25, 30)) + 0.2 * bump(x_mm, (0, -58, 26), (14, 5, 14))
    wide = plane_noise(x_mm, params.seed + 3, 24, 26.0)
    fine = plane_noise(x_mm, params.seed + 4, 32, 5.0)
    pore = plane_noise(x_mm, params.seed + 7, 24, 1.8)
    blotch = p.blotches * (0.10 * wide + 0.06 * fine)
    blood = p.haemoglobin * np.clip(1 + 2.8 * p.redness * red - pale + 1.2 * blotch + 0.05 * pore, 0.3, 6.0)
    blood = blood * (1 + (0.9 + 2.2 * p.lip_colour) * mouth.lips)
    under_eye = bump(x_mm, (27, -11, 8), (9, 4, 8)) + 0.4 * bump(x_mm, (30, 8, 10), (12, 4, 8))
    under_eye += 0.3 * bump(x_mm, (16, -2, 8), (5, 7, 8))
    sun = 0.10 * bump(x_mm, (0, 50, 10), (50, 25, 30)) + 0.08 * bump(x_mm, (0, -30, 38), (12, 16, 14))
    sun = sun - 0.12 * smoothstep(-x_mm[:, 1], 105.0, 135.0) * smoothstep(x_mm[:, 2], -80.0, -40.0)
    around_mouth = 0.22 * bump(x_mm, (22, -76, 12), (10, 9, 10)) * smoothstep(p.melanin, 0.05, 0.15)
    melanin = p.melanin * np.clip(
        1 + sun + around_mouth + 0.5 * p.under_eye * under_eye + 0.9 * blotch + 0.03 * pore, 0.3, 3.0
    )
    melanin = melanin * (1 + 0.25 * mouth.lips) * (1 - 0.35 * moist) + 0.012 * mouth.lips
    melanin = melanin + _melanin_spots(x_mm, params)
    # the vermilion has little to scatter back above its vessels
    colour = skin_albedo(melanin, np.clip(blood, 0.001, 0.12), p.scattering)
    folds = np.cos(2.2 * x_mm[:, 0] + 1.4 * plane_noise(x_mm, params.seed + 113, 8, 8.0))
    colour = colour * (1 - mouth.lips * (0.20 + 0.05 * folds))[:, None] ** np.array([0.6, 2.0, 1.6])
    return colour


def skin_ks(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Specular scale of bare skin, (N,): refractive index 1.4 where dry (0.70), towards 1.5 under a film of sebum."""
    oil = params.pigment.oil
    tzone = bump(x_mm, (0, -28, 40), (9, 15, 14)) + 0.6 * bump(x_mm, (0, 46, 14), (34, 20, 26))
    tzone += 0.4 * bump(x_mm, (0, -100, 18), (12, 9, 12)) + 0.3 * bump(x_mm, (40, -22, 8), (10, 8, 12))
    dry = bump(x_mm, (48, -48, -5), (18, 22, 24))
    ks = 0.74 + 0.34 * oil + (0.10 + 0.22 * oil) * tzone - 0.12 * dry
    return ks * (1.0 + 0.04 * plane_noise(x_mm, params.seed + 6, 10, 20.0))
