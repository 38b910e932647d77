"""What a head is made of at every point of the template: region, diffuse albedo and specular F0.

Notation: ``x`` template point in millimetres. ``ks`` is the specular scale of the real scenes (1 is F0 = 0.04); results
carry ``s = F0 = 0.04 ks``. Every quantity is an exact function of the template point and the head's parameters, so that
it may be evaluated at ray hits.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from data_synth.head.beard import beard_cover, brow_cover, stubble_cover
from data_synth.head.cloth import ClothLayer, cloth_colour, cloth_layer
from data_synth.head.eyes import EyeMasks, eye_colour, eye_ks, eye_masks
from data_synth.head.hair import hair_cover
from data_synth.head.hair_colour import hair_albedo, strand_albedo
from data_synth.head.hair_flow import strand_coordinates, strands
from data_synth.head.hair_styles import STYLES
from data_synth.head.headwear import headwear_colour, headwear_field_mm, headwear_reach
from data_synth.head.noise import plane_noise, smoothstep
from data_synth.head.params import HeadParams
from data_synth.head.scalp import interpolate_scalp
from data_synth.head.skin_regions import MouthMasks, mouth_masks, nostril_mask, skin_colour, skin_ks

F0_OF_KS = 0.04
KS_RANGE = (0.05, 1.25)
ALBEDO_RANGE = (0.003, 0.9)


class Region(IntEnum):
    """What covers a point."""

    SKIN = 0
    LIPS = 1
    EYE = 2
    BROW = 3
    HAIR = 4
    CLOTH = 5
    BEARD = 6
    HEADWEAR = 7
    MOUTH = 8  # behind the lips


@dataclass(frozen=True)
class Masks:
    """Coverage in [0, 1] at N points, each (N,), not yet hidden by what lies above; ``streaks``: unit strand noise."""

    mouth: MouthMasks
    eyes: EyeMasks
    brow: np.ndarray
    nostril: np.ndarray
    stubble: np.ndarray
    beard: np.ndarray
    cloth: ClothLayer
    hair: np.ndarray
    headwear: np.ndarray
    streaks: np.ndarray


def masks(x_mm: np.ndarray, params: HeadParams) -> Masks:
    """Coverage of every region at template points (N, 3) in millimetres."""
    style = STYLES[params.hair_style]
    if style.curl > 1.0:
        streaks = 0.9 * plane_noise(x_mm, params.seed + 9, 24, 3.5)
    else:
        u, w, fade = strand_coordinates(x_mm, style.flow, params.groom.part)
        streaks = fade * strands(u, w, 230, params.seed + 9) * 0.75
        streaks = streaks + 0.55 * fade**2 * strands(u, w, 420, params.seed + 10)
    hair, _ = hair_cover(x_mm, params, streaks)
    headwear = np.zeros(len(x_mm))
    kind = params.dress.headwear
    if kind != "none":
        g = headwear_field_mm(x_mm, params, interpolate_scalp(x_mm))
        headwear = smoothstep(-g, -1.4, -0.8)
        headwear = headwear * smoothstep(headwear_reach(x_mm, kind), 0.2, 0.6)
    down = np.arctan2(x_mm[:, 0], x_mm[:, 2] + 40.0)
    whiskers = 0.8 * strands(down, x_mm[:, 1] / 20.0, 190, params.seed + 12, 10)
    return Masks(
        mouth=mouth_masks(x_mm, params),
        eyes=eye_masks(x_mm, params),
        brow=brow_cover(x_mm, params),
        nostril=nostril_mask(x_mm),
        stubble=stubble_cover(x_mm, params),
        beard=beard_cover(x_mm, params, whiskers),
        cloth=cloth_layer(x_mm, params),
        hair=hair,
        headwear=headwear,
        streaks=np.where(hair > 0.02, streaks, whiskers),
    )


def evaluate_material(x_template_m: np.ndarray, params: HeadParams) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse albedo (N, 3), linear Rec. 709, and monochrome specular F0 (N,) at template points (N, 3) in metres."""
    x_mm = np.asarray(x_template_m, np.float64) * 1e3
    m, p = masks(x_mm, params), params.pigment
    colour = skin_colour(x_mm, params, m.mouth, m.eyes.moist)
    hair = hair_albedo(p)
    short = 0.55 * hair + 0.35 * hair_albedo(p, darker=1.5)

    def cover(amount: np.ndarray, new: np.ndarray) -> None:
        nonlocal colour
        colour = colour + (new - colour) * np.clip(amount, 0.0, 1.0)[:, None]

    cover(0.42 * m.stubble, 0.30 * colour + 0.25 * short)
    cover(0.93 * m.nostril, np.array([0.020, 0.009, 0.007]))
    cover(0.66 * m.mouth.line, 0.16 * colour)
    cover(0.92 * m.mouth.inner, np.array([0.050, 0.014, 0.012]))
    cover((0.55 + 0.42 * p.brow_weight) * m.brow, 0.5 * short + 0.006 + 0.22 * p.grey**2)
    cover(m.eyes.eye, eye_colour(x_mm, params))
    cover(0.95 * m.eyes.lashes, 0.25 * short + 0.006)
    cover(m.beard * (1 - m.mouth.inner), strand_albedo(x_mm, params, m.streaks, beard=True))
    cover(m.cloth.cover, cloth_colour(x_mm, params, m.cloth))
    cover(m.hair, strand_albedo(x_mm, params, m.streaks))
    cover(m.headwear, headwear_colour(x_mm, params))

    ks = skin_ks(x_mm, params)
    for amount, level in (
        (m.mouth.lips, 1.05 + 0.1 * p.oil),
        (m.stubble, 0.85),
        (m.brow, 0.55),
        (m.nostril, 0.3),
        (m.mouth.inner, 0.6),
        (m.eyes.moist, 1.15),
        (m.eyes.eye, eye_ks(x_mm, params)),
        (m.eyes.lashes, 0.5),
        (m.beard, 0.5),
        (m.cloth.cover, 0.35),
        (m.hair, 0.62 + 0.08 * m.streaks),
        (m.headwear, 0.35),
    ):
        ks = ks + (level - ks) * np.clip(amount, 0.0, 1.0)
    return np.clip(colour, *ALBEDO_RANGE), F0_OF_KS * np.clip(ks, *KS_RANGE)


def region_of(x_template_m: np.ndarray, params: HeadParams) -> np.ndarray:
    """`Region` of each template point, (N,) int64: the uppermost that covers it by more than half (a brow: a fifth)."""
    m = masks(np.asarray(x_template_m, np.float64) * 1e3, params)
    region = np.full(len(x_template_m), int(Region.SKIN))
    for cover, value in (
        (m.mouth.lips, Region.LIPS),
        (m.mouth.inner, Region.MOUTH),
        (m.brow, Region.BROW),
        (m.eyes.eye, Region.EYE),
        (m.beard, Region.BEARD),
        (m.cloth.cover, Region.CLOTH),
        (m.hair, Region.HAIR),
        (m.headwear, Region.HEADWEAR),
    ):
        region[cover > (0.2 if value == Region.BROW else 0.5)] = int(value)
    return region
