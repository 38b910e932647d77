"""Draw what covers a head, in combinations that people have.

Notation: ``dark`` in [0, 1] runs from the palest to the darkest skin; ``years`` is the age. Chances are estimates from
everyday experience, wide on purpose: a prior should know what is rare. Sex and age come from the shape, so that beard,
hairline, grey and jaw belong to one person.
"""

from __future__ import annotations

import numpy as np

from data_synth.head.cover_params import BEARDS, GARMENTS, HAIR_STYLES, HEADWEAR, PATTERNS, Dress, Groom, Pigment
from data_synth.head.shape_params import NamedShape

MELANIN_OF_DARK = (0.010, 0.30)
# style: (men, women, factor for the very dark-skinned, whose hair is mostly tightly curled)
_STYLE_CHANCE = {
    "bald": (0.07, 0.005, 1.5),
    "buzz": (0.11, 0.01, 2.2),
    "crop": (0.12, 0.01, 1.0),
    "short": (0.19, 0.05, 0.6),
    "side_part": (0.13, 0.03, 0.4),
    "swept_back": (0.08, 0.03, 0.4),
    "undercut": (0.06, 0.01, 0.6),
    "receding": (0.02, 0.0, 1.0),
    "curly": (0.06, 0.07, 2.0),
    "afro": (0.015, 0.02, 5.0),
    "fringe": (0.04, 0.09, 0.4),
    "bob": (0.01, 0.17, 0.7),
    "long": (0.02, 0.20, 0.6),
    "wavy": (0.03, 0.17, 0.8),
    "ponytail": (0.01, 0.11, 1.0),
    "bun": (0.015, 0.09, 1.4),
}
_BEARD_CHANCE = {"none": 0.54, "moustache": 0.05, "goatee": 0.10, "chin_strap": 0.04, "full": 0.21, "long": 0.06}
_HEADWEAR_CHANCE = {"none": 0.87, "cap": 0.045, "beanie": 0.05, "headband": 0.035}
_GARMENT_CHANCE = {
    "none": 0.09,
    "tshirt": 0.28,
    "vneck": 0.10,
    "tank": 0.06,
    "shirt": 0.18,
    "jumper": 0.14,
    "hoodie": 0.10,
    "scarf": 0.05,
}
_PATTERN_CHANCE = {"plain": 0.60, "melange": 0.16, "stripes": 0.11, "check": 0.08, "dots": 0.05}
_IRIS = {
    "brown": (0.070, 0.034, 0.016),
    "dark": (0.030, 0.016, 0.010),
    "blue": (0.080, 0.125, 0.180),
    "green": (0.085, 0.100, 0.050),
    "grey": (0.115, 0.125, 0.130),
}


def _pick(rng: np.random.Generator, names: tuple[str, ...], chance: dict[str, float]) -> str:
    p = np.array([chance[n] for n in names])
    return names[rng.choice(len(names), p=p / p.sum())]


def years_of(shape: NamedShape) -> float:
    """Age in years, 18 to 80, of a shape's age in sigma units (uniform in the population)."""
    return float(np.clip(49.0 + shape.age * 31.0 / np.sqrt(3.0), 18.0, 80.0))


def _colour(rng: np.random.Generator) -> tuple[float, float, float]:
    """A dye: mostly dark or muted, now and then strong."""
    grey = float(np.exp(rng.uniform(np.log(0.02), np.log(0.65))))
    tint = rng.normal(size=3) * rng.choice([0.04, 0.30, 0.75], p=[0.45, 0.35, 0.20])
    return tuple(float(c) for c in np.clip(grey * np.exp(tint - tint.mean()), 0.012, 0.75))


def sample_pigment(rng: np.random.Generator, shape: NamedShape, male: bool) -> Pigment:
    """Draw skin, hair and eye colour of one person."""
    years = years_of(shape)
    dark = float(rng.random())
    low, high = np.log(MELANIN_OF_DARK)
    melanin = float(np.clip(np.exp(low + (high - low) * dark + 0.06 * rng.normal()), 0.008, 0.32))
    hair = 1.0 - (1.0 - rng.uniform(0.02, 1.0) ** 1.4) * (1.0 - dark) ** 1.3
    red = float(rng.beta(1.1, 3.5) * (1.0 - 0.75 * dark))
    if rng.random() < 0.06 * (1 - dark) and hair < 0.8:
        hair, red = float(rng.uniform(0.3, 0.65)), float(rng.uniform(0.7, 1.0))
    grey = float(np.clip((years - 46.0) / 34.0 + 0.22 * rng.normal(), 0.0, 1.0))
    if rng.random() < (0.15 if male else 0.5):
        grey *= 0.15  # dyed
    chance = {"brown": 0.35, "dark": 0.08 + 2.2 * dark**1.5}
    light = (1 - dark) ** 2 * (1.2 - 0.7 * hair)
    chance.update(blue=0.55 * light, green=0.25 * light, grey=0.16 * light)
    iris = (
        np.array(_IRIS[_pick(rng, tuple(_IRIS), chance)]) * rng.uniform(0.75, 1.35) * np.exp(0.08 * rng.normal(size=3))
    )
    freckled = rng.random() < 0.12 + 0.35 * (1 - dark) * (red > 0.5) + 0.12 * (dark < 0.4)
    return Pigment(
        melanin=melanin,
        haemoglobin=float(np.exp(rng.uniform(np.log(0.009), np.log(0.036)))),
        scattering=float(np.clip(1.08 + 0.17 * rng.normal(), 0.75, 1.55)),
        redness=float(rng.uniform(0.2, 1.0)),
        freckles=float(rng.uniform(0.2, 1.0) * freckled),
        moles=float(rng.uniform(0, 1) ** 2),
        stubble=float(rng.uniform(0.15, 1.0) * (male and rng.random() < 0.55)),
        brow_weight=float(np.clip(rng.uniform(0.35, 1.0) + 0.1 * male - 0.25 * grey, 0.25, 1.0)),
        lip_colour=float(rng.uniform(0.1, 0.7) if male else rng.uniform(0.2, 1.0)),
        under_eye=float(np.clip(rng.uniform(0, 0.7) + 0.3 * (years - 18) / 62, 0, 1)),
        oil=float(rng.uniform(0, 1)),
        blotches=float(np.clip(rng.uniform(0.1, 0.7) + 0.3 * (years - 18) / 62, 0, 1)),
        hair_melanin=float(hair),
        hair_redness=red,
        grey=grey,
        iris=tuple(float(c) for c in iris),
    )


def sample_style(rng: np.random.Generator, shape: NamedShape, male: bool, melanin: float) -> tuple[str, float]:
    """Draw a hair style and the length of the hair (1 is as the style has it)."""
    years = years_of(shape)
    dark = float(np.clip((np.log(melanin) - np.log(0.1)) / (np.log(0.3) - np.log(0.1)), 0.0, 1.0))
    chance = {}
    for name, (men, women, curled) in _STYLE_CHANCE.items():
        chance[name] = (men if male else women) * curled**dark
    if male:
        chance["receding"] += 0.35 * max(years - 35.0, 0.0) / 45.0
        chance["bald"] += 0.18 * max(years - 30.0, 0.0) / 50.0
    return _pick(rng, HAIR_STYLES, chance), float(np.clip(1.0 + 0.16 * rng.normal(), 0.72, 1.35))


def sample_groom(rng: np.random.Generator, shape: NamedShape, male: bool) -> Groom:
    """Draw hairline, beard and brows."""
    years = years_of(shape)
    recede = rng.gamma(2.0, 1.6) + (rng.gamma(2.0, 3.0) * np.clip((years - 22) / 40, 0, 1) if male else 0.0)
    beard = _pick(rng, BEARDS, _BEARD_CHANCE)
    short = rng.uniform(2.0, 7.0) if rng.random() < 0.6 else rng.uniform(6.0, 12.0)
    length = {"moustache": rng.uniform(2.5, 6.0), "goatee": short, "full": short, "chin_strap": rng.uniform(2.0, 4.0)}
    return Groom(
        front_mm=float(np.clip(4.0 * rng.normal() + 2.0 * male, -7.0, 11.0)),
        recede_mm=float(np.clip(recede, 0.0, 20.0)),
        peak_mm=float(np.clip(abs(rng.normal()) * 3.2, 0.0, 9.0)),
        sideburn_mm=float(rng.uniform(-5.0, 18.0) if male else rng.uniform(-8.0, 3.0)),
        nape_mm=float(rng.uniform(-8.0, 10.0)),
        part=float(np.clip(rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 1.0) ** 0.5, -1, 1)),
        wave=float(rng.uniform(0.0, 1.0)),
        clump=float(rng.uniform(0.6, 1.4)),
        front_fall_mm=float(rng.uniform(0.0, 36.0)),
        beard=beard if male else "none",
        beard_mm=float(length.get(beard, rng.uniform(9.0, 17.0))),
        brow_thickness=float(np.clip(0.4 * rng.normal() + (0.35 if male else -0.3), -1.0, 1.0)),
        brow_arch=float(np.clip(0.5 * rng.normal() + (-0.1 if male else 0.35), -1.0, 1.0)),
    )


def sample_dress(rng: np.random.Generator, style: str) -> Dress:
    """Draw garment and headwear."""
    headwear = _pick(rng, HEADWEAR, _HEADWEAR_CHANCE)
    # hats sit on hair that goes below them
    if style in ("bun", "afro", "curly") or (headwear == "headband" and style == "bald"):
        headwear = "none"
    return Dress(
        garment=_pick(rng, GARMENTS, _GARMENT_CHANCE),
        neckline=float(rng.uniform(0.0, 1.0)),
        cloth=_colour(rng),
        second=_colour(rng),
        pattern=_pick(rng, PATTERNS, _PATTERN_CHANCE),
        headwear=headwear,
        headwear_colour=_colour(rng),
    )
