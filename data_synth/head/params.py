"""What a head is made from: identity, named shape, hair and pigment, all explicit.

Notation: ``sigma`` units are standard deviations of the population; a named parameter of 0 is the mean head.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from data_synth.head.shape_params import NamedShape, sample_shape
from sira_assets.errors import InputError

HAIR_STYLES = ("bald", "buzz", "short", "side_part", "receding", "curly", "bob", "long", "bun")
IDENTITY_SIZE = 30


@dataclass(frozen=True)
class Pigment:
    """Colour of a head.

    Attributes
    ----------
    melanin : float
        Volume fraction of melanosomes in the epidermis, 0.013 (pale) to 0.43 (very dark).
    haemoglobin : float
        Volume fraction of blood in the dermis, 0.003 to 0.03.
    redness, freckles, stubble, brow_weight, lip_colour : float
        Strength of each, 0 to 1.
    hair_melanin : float
        0 (white) to 1 (black).
    hair_redness : float
        0 (ash) to 1 (red).
    iris : (3,) tuple of float
        Linear Rec. 709.
    cloth : (3,) tuple of float
        Linear Rec. 709.
    collar : float
        How far the cloth's neckline lies from the neck, 0 (crew neck) to 1 (wide); above 1.5 there is no cloth.
    """

    melanin: float = 0.05
    haemoglobin: float = 0.009
    redness: float = 0.5
    freckles: float = 0.0
    stubble: float = 0.2
    brow_weight: float = 0.7
    lip_colour: float = 0.5
    hair_melanin: float = 0.75
    hair_redness: float = 0.2
    iris: tuple[float, float, float] = (0.08, 0.05, 0.03)
    cloth: tuple[float, float, float] = (0.1, 0.12, 0.16)
    collar: float = 0.3


@dataclass(frozen=True)
class HeadParams:
    """All of one head. ``identity``: (30,) float64 in sigma units of the population's principal directions."""

    seed: int
    identity: np.ndarray = field(default_factory=lambda: np.zeros(IDENTITY_SIZE))
    shape: NamedShape = field(default_factory=NamedShape)
    hair_style: str = "bald"
    hair_length: float = 1.0
    pigment: Pigment = field(default_factory=Pigment)

    def __post_init__(self) -> None:
        identity = np.asarray(self.identity, np.float64)
        if identity.shape != (IDENTITY_SIZE,) or not np.isfinite(identity).all():
            raise InputError(
                expected=f"{IDENTITY_SIZE} finite identity coefficients",
                received=f"an array of shape {identity.shape}",
                remedy="draw them with sample_params",
            )
        if self.hair_style not in HAIR_STYLES:
            raise InputError(
                expected="a hair style among " + ", ".join(HAIR_STYLES),
                received=repr(self.hair_style),
                remedy="choose one of these",
            )
        object.__setattr__(self, "identity", identity)


def mean_params(hair_style: str = "bald") -> HeadParams:
    """The population's mean head."""
    return HeadParams(seed=0, hair_style=hair_style)


def _sample_pigment(rng: np.random.Generator) -> Pigment:
    melanin = float(np.exp(rng.uniform(np.log(0.013), np.log(0.30))))
    dark = np.clip((np.log(melanin) - np.log(0.013)) / (np.log(0.30) - np.log(0.013)), 0, 1)
    hair = 1.0 - (1.0 - rng.uniform(0.05, 1.0)) * (1.0 - dark) ** 0.5
    if rng.random() < 0.12:
        hair = rng.uniform(0.0, 0.15)
    eyes = ((0.10, 0.055, 0.025), (0.045, 0.025, 0.014), (0.09, 0.14, 0.19), (0.10, 0.12, 0.06), (0.13, 0.13, 0.12))
    p_eyes = np.array([0.3, 0.2 + 2.0 * dark, 0.25 * (1 - dark), 0.15 * (1 - dark), 0.1 * (1 - dark)])
    iris = np.array(eyes[rng.choice(5, p=p_eyes / p_eyes.sum())]) * rng.uniform(0.7, 1.3)
    grey = rng.uniform(0.02, 0.6)
    cloth = np.clip(grey * np.exp(rng.normal(size=3) * rng.choice([0.05, 0.5])), 0.015, 0.75)
    return Pigment(
        melanin=melanin,
        haemoglobin=float(rng.uniform(0.004, 0.016)),
        redness=float(rng.uniform(0.1, 1.0)),
        freckles=float(rng.uniform(0, 1) * (rng.random() < 0.35)),
        stubble=float(rng.uniform(0.2, 1) * (rng.random() < 0.4)),
        brow_weight=float(rng.uniform(0.4, 1.0)),
        lip_colour=float(rng.uniform(0.2, 1.0)),
        hair_melanin=float(hair),
        hair_redness=float(rng.beta(1.2, 3.0)),
        iris=tuple(float(c) for c in iris),
        cloth=tuple(float(c) for c in cloth),
        collar=float(rng.uniform(0.0, 1.8)),
    )


def sample_params(rng: np.random.Generator) -> HeadParams:
    """Draw one head from the population; everything from ``rng``, so the same seed gives the same head."""
    seed = int(rng.integers(2**31 - 1))
    identity = np.clip(rng.normal(size=IDENTITY_SIZE), -3.0, 3.0)
    shape = sample_shape(rng)
    chance = {
        "bald": 0.08,
        "buzz": 0.10,
        "short": 0.24,
        "side_part": 0.16,
        "receding": 0.08,
        "curly": 0.08,
        "bob": 0.10,
        "long": 0.10,
        "bun": 0.06,
    }
    style = HAIR_STYLES[rng.choice(len(HAIR_STYLES), p=[chance[s] for s in HAIR_STYLES])]
    return HeadParams(seed, identity, shape, style, float(rng.uniform(0.75, 1.3)), _sample_pigment(rng))
