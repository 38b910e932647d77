"""What a head is made of at every point of the template: region, diffuse albedo and specular F0.

Notation: ``x`` template point in millimetres, folded to the left side where the template is symmetric. ``ks`` is the
specular scale of the real scenes (1 is F0 = 0.04); results carry ``s = F0 = 0.04 ks``. Every quantity is an exact
function of the template point and the head's parameters, so that it may be evaluated at ray hits.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import torch

from data_synth.head.hair import curls, hair_field_mm, smoothstep, strand_waves
from data_synth.head.params import HeadParams
from data_synth.head.skin import skin_albedo
from data_synth.head.template import eyeball_field, lid_opening, load_template


class Region(IntEnum):
    """What covers a point."""

    SKIN = 0
    LIPS = 1
    EYE = 2
    BROW = 3
    HAIR = 4
    CLOTH = 5


@dataclass(frozen=True)
class Masks:
    """Coverage in [0, 1] at N points: each (N,)."""

    lips: np.ndarray
    lip_line: np.ndarray
    eye: np.ndarray
    lashes: np.ndarray
    brow: np.ndarray
    hair: np.ndarray
    cloth: np.ndarray
    nostril: np.ndarray
    beard: np.ndarray


# outlines of the left half (mm), through the population's mean landmarks
_LIP_X = np.array([0.0, 3.5, 7.2, 12.0, 16.7, 21.0, 25.4])
_LIP_TOP = np.array([-61.2, -60.4, -60.2, -61.6, -63.6, -66.6, -70.3])
_LIP_BOTTOM = np.array([-78.9, -78.7, -78.2, -77.2, -75.6, -73.4, -70.4])
_SLIT_X = np.array([0.0, 5.0, 9.8, 16.0, 21.7, 25.4])
_SLIT_Y = np.array([-68.9, -68.6, -68.6, -69.2, -70.1, -70.5])
_BROW_X = np.array([9.0, 11.5, 17.0, 23.7, 30.0, 37.3, 43.0, 48.5, 57.1, 62.0])
_BROW_Y = np.array([19.0, 20.0, 21.4, 22.6, 23.6, 24.3, 23.8, 22.2, 16.0, 12.0])
_BROW_HALF = np.array([2.2, 3.2, 4.0, 4.0, 3.7, 3.2, 2.7, 2.2, 1.3, 0.6])
IRIS_MM, PUPIL_MM = 5.9, 2.0


def neckline_height(x_mm: np.ndarray, collar: float) -> np.ndarray:
    """Height (mm) below the edge of the shirt, positive on cloth. (N, 3) -> (N,)."""
    edge = -176.0 - 0.28 * (x_mm[:, 2] + 40.0) - 26.0 * collar + 0.35 * np.clip(np.abs(x_mm[:, 0]) - 48.0, 0, 60.0)
    return edge - x_mm[:, 1]


def cloth_cover(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Cloth's coverage in [0, 1]; none where the collar lies beyond 1.5."""
    if params.pigment.collar > 1.5:
        return np.zeros(len(x_mm))
    return smoothstep(neckline_height(x_mm, params.pigment.collar), 0.0, 1.6)


def masks(x_mm: np.ndarray, params: HeadParams) -> Masks:
    """Coverage of every region at template points (N, 3) in millimetres."""
    x, y, z = np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]
    in_front = smoothstep(z, -12.0, -4.0)
    inside = np.minimum(np.interp(x, _LIP_X, _LIP_TOP) - y, y - np.interp(x, _LIP_X, _LIP_BOTTOM))
    lips = smoothstep(inside, -0.6, 0.9) * smoothstep(25.8 - x, 0.0, 1.5) * smoothstep(z, 6.0, 10.0)
    slit = np.exp(-0.5 * ((y - np.interp(x, _SLIT_X, _SLIT_Y)) / 0.75) ** 2)
    lip_line = slit * smoothstep(27.0 - x, 0.0, 3.0) * smoothstep(z, 6.0, 10.0)
    template = load_template()
    with torch.no_grad():
        p = torch.tensor(x_mm, dtype=template.eyeball.dtype)
        ball = eyeball_field(template, p).numpy()
        opening, upper, lower = (a.numpy() for a in lid_opening(template, p))
    # the narrow gap between lid and eyeball counts as eye
    eye = smoothstep(-np.abs(ball), -3.5, -2.5) * smoothstep(-opening, -0.3, 0.2) * smoothstep(z, -2.0, 0.0)
    corner = smoothstep(x, 15.5, 18.5) * smoothstep(47.0 - x, 0.0, 3.0)
    near_lid = corner * smoothstep(z, -4.0, 0.0) * (np.abs(ball) < 6.0)
    upper_line = np.exp(-0.5 * ((upper - 0.15) / 0.75) ** 2)
    lower_line = 0.45 * np.exp(-0.5 * ((lower - 0.1) / 0.6) ** 2)
    lashes = near_lid * np.maximum(upper_line, lower_line)
    middle = np.interp(x, _BROW_X, _BROW_Y)
    half = np.interp(x, _BROW_X, _BROW_HALF)
    lean = x - (0.5 + 0.02 * x) * (y - middle)
    hairs = 0.5 + 0.25 * np.sin(4.1 * lean + 2.0 * np.sin(0.7 * x + params.seed % 7)) + 0.25 * np.sin(6.3 * lean + y)
    band = smoothstep(1.0 - np.abs(y - middle) / half, -0.25, 0.75)
    brow = band * (0.72 + 0.28 * hairs) * smoothstep(x, 8.0, 13.0) * smoothstep(61.0 - x, 0.0, 6.0) * in_front
    hair = smoothstep(-hair_field_mm(x_mm, params), -2.6, -1.9)
    nostril = np.exp(-0.5 * (((x - 7.8) / 4.0) ** 2 + ((y + 40.0) / 2.2) ** 2 + ((z - 21.0) / 5.2) ** 2) ** 2)
    jaw = smoothstep(-(y + 50.0 + 0.28 * x), 0.0, 10.0) * smoothstep(y + 122.0, 0.0, 14.0) * smoothstep(z, -62.0, -48.0)
    beard = jaw * (1 - lips) * (1 - np.exp(-0.5 * (((x - 46) / 12) ** 2 + ((y + 60) / 9) ** 2)))
    eye = eye * (1 - hair)
    return Masks(lips, lip_line, eye, lashes, brow, hair, cloth_cover(x_mm, params), nostril, beard)


def _bump(x_mm: np.ndarray, centre: tuple[float, float, float], width: tuple[float, float, float]) -> np.ndarray:
    folded = np.stack([np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]], -1)
    return np.exp(-0.5 * (((folded - centre) / width) ** 2).sum(-1))


def hair_colour(params: HeadParams) -> np.ndarray:
    """Linear Rec. 709 albedo of clumped hair, (3,)."""
    p = params.pigment
    eumelanin, phaeomelanin = p.hair_melanin * (1 - 0.5 * p.hair_redness), 0.35 * p.hair_redness
    # absorption ratios of the two melanins after d'Eon et al. 2011, DOI 10.1111/j.1467-8659.2011.01976.x
    absorption = 8.0 * eumelanin * np.array([0.42, 0.70, 1.37]) + 3.9 * phaeomelanin * np.array([0.19, 0.40, 1.05])
    return 0.012 + 0.55 * np.exp(-1.15 * absorption)


def _skin(x_mm: np.ndarray, params: HeadParams, m: Masks) -> np.ndarray:
    p = params.pigment
    red = 0.9 * _bump(x_mm, (34, -36, 8), (15, 13, 16)) + 0.9 * _bump(x_mm, (0, -34, 38), (12, 9, 14))
    red += 1.0 * _bump(x_mm, (84, -28, -82), (9, 28, 18)) + 0.4 * _bump(x_mm, (0, -100, 16), (14, 10, 12))
    red += 0.5 * _bump(x_mm, (31, -10, 8), (11, 5, 8)) + 0.5 * _bump(x_mm, (18, -5, 7), (4, 4, 5))
    pale = 0.25 * _bump(x_mm, (0, 55, 10), (45, 25, 30))
    mottle = 0.8 * curls(x_mm, params.seed + 3, 30, 26.0) + 0.6 * curls(x_mm, params.seed + 4, 40, 6.0)
    blood = (
        p.haemoglobin * (1 + 1.1 * p.redness * red - pale + 0.10 * mottle) * (1 + (0.8 + 3.6 * p.lip_colour) * m.lips)
    )
    under_eye = _bump(x_mm, (28, -11, 8), (10, 4, 8)) + 0.7 * _bump(x_mm, (30, 8, 10), (12, 4, 8))
    melanin = p.melanin * (1 + 0.05 * mottle + 0.25 * under_eye + 0.35 * m.lips)
    if p.freckles:
        rng = np.random.default_rng([params.seed, 41])
        centre = rng.normal([0, -18, 22], [38, 22, 22], (110, 3))
        centre[90:] = rng.uniform([-70, -100, -40], [70, 80, 40], (20, 3))
        size = rng.uniform(0.5, 1.4, 110)
        for c, r in zip(centre, size, strict=True):
            melanin = melanin + 0.05 * p.freckles * np.exp(-0.5 * (((x_mm - c) / [r, r, 5.0]) ** 2).sum(-1))
    colour = skin_albedo(np.clip(melanin, 0.008, 0.5), np.clip(blood, 0.001, 0.08))
    beard = 0.45 * p.stubble * m.beard[:, None]
    return colour * (1 - beard) + beard * (0.35 * hair_colour(params) + 0.02)


def _eye(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    centre = load_template().eyeball[:3].numpy()
    r = np.hypot(np.abs(x_mm[:, 0]) - centre[0], x_mm[:, 1] - centre[1])
    angle = np.arctan2(x_mm[:, 1] - centre[1], np.abs(x_mm[:, 0]) - centre[0])
    sclera = np.array([0.46, 0.41, 0.38]) * (1 - 0.25 * smoothstep(r, 7.0, 12.0))[:, None]
    sclera[:, 1:] *= (1 - 0.30 * smoothstep(-(np.abs(x_mm[:, 0]) - 20.5), 0.0, 2.5))[:, None]
    fibres = 1 + 0.22 * np.sin(23 * angle + 3 * np.sin(5 * angle + params.seed % 11))
    iris = np.array(params.pigment.iris) * (fibres * (0.8 + 0.5 * smoothstep(-r, -5.0, -2.5)))[:, None]
    iris = iris * (1 - 0.75 * smoothstep(r, 4.9, 5.8))[:, None]
    colour = sclera + (iris - sclera) * smoothstep(-r, -IRIS_MM - 0.25, -IRIS_MM + 0.35)[:, None]
    return colour + (0.004 - colour) * smoothstep(-r, -PUPIL_MM - 0.2, -PUPIL_MM + 0.2)[:, None]


def evaluate_material(x_template_m: np.ndarray, params: HeadParams) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse albedo (N, 3), linear Rec. 709, and monochrome specular F0 (N,) at template points (N, 3) in metres."""
    x_mm = np.asarray(x_template_m, np.float64) * 1e3
    m, p = masks(x_mm, params), params.pigment
    colour = _skin(x_mm, params, m)

    def cover(amount: np.ndarray, new: np.ndarray) -> None:
        nonlocal colour
        colour = colour + (new - colour) * amount[:, None]

    hair = hair_colour(params)
    cover(0.93 * m.nostril, np.array([0.018, 0.008, 0.006]))
    cover(0.72 * m.lip_line, 0.14 * colour)
    cover((0.45 + 0.5 * p.brow_weight) * m.brow, 0.25 * hair + 0.018)
    cover(m.eye, _eye(x_mm, params))
    cover(0.85 * m.lashes * (1 - 0.3 * m.eye), 0.3 * hair + 0.006)
    strands = strand_waves(x_mm, 150.0, params.seed + 9, 18) if m.hair.any() else np.zeros(len(x_mm))
    cover(m.hair, hair * np.clip(1 + 0.22 * strands, 0.35, 1.8)[:, None])
    weave = 1 + 0.04 * curls(x_mm, params.seed + 8, 10, 6.0)
    cover(m.cloth * (1 - m.hair), np.array(p.cloth) * weave[:, None])

    ks = np.full(len(x_mm), 0.72)
    ks += 0.38 * _bump(x_mm, (0, -28, 40), (9, 14, 14)) + 0.22 * _bump(x_mm, (0, 48, 14), (34, 20, 26))
    ks += 0.15 * _bump(x_mm, (0, -100, 18), (12, 9, 12)) - 0.22 * _bump(x_mm, (46, -45, -5), (18, 20, 22))
    ks += 0.04 * curls(x_mm, params.seed + 6, 10, 20.0)
    for amount, level in (
        (m.lips, 1.0),
        (m.brow, 0.45),
        (m.nostril, 0.3),
        (m.eye, 1.0),
        (m.hair, 0.6),
        (m.cloth * (1 - m.hair), 0.3),
    ):
        ks = ks + (level - ks) * amount
    return np.clip(colour, 0.003, 0.9), 0.04 * np.clip(ks, 0.05, 1.25)


def region_of(x_template_m: np.ndarray, params: HeadParams) -> np.ndarray:
    """`Region` of each template point, (N,) int64."""
    m = masks(np.asarray(x_template_m, np.float64) * 1e3, params)
    region = np.full(len(x_template_m), int(Region.SKIN))
    for cover, value in (
        (m.lips, Region.LIPS),
        (m.brow, Region.BROW),
        (m.eye, Region.EYE),
        (m.cloth, Region.CLOTH),
        (m.hair, Region.HAIR),
    ):
        region[cover > 0.5] = int(value)
    return region
