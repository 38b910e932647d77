"""What a head is made from: identity, named shape, hair and pigment, all explicit.

Notation: ``sigma`` units are standard deviations of the population; a named parameter of 0 is the mean head.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from data_synth.head.cover_params import HAIR_STYLES, Dress, Groom, Pigment, one_of
from data_synth.head.cover_sampling import sample_dress, sample_groom, sample_pigment, sample_style
from data_synth.head.population import IDENTITY_SIZE
from data_synth.head.relief_params import RELIEF_SIZE, sample_relief
from data_synth.head.shape_params import NamedShape, sample_shape
from sira_assets.errors import InputError


@dataclass(frozen=True)
class HeadParams:
    """All of one head.

    Attributes
    ----------
    seed : int
    identity : (30,) float64
        Landmark coefficients in sigma units, before the named parameters' share (`data_synth.head.identity`).
    shape : NamedShape
    hair_style, hair_length, pigment, groom, dress
        What covers the head, and its colours.
    relief : (RELIEF_SIZE,) float64
        Surface between the landmarks, in sigma units (`data_synth.head.relief_params`).
    """

    seed: int
    identity: np.ndarray = field(default_factory=lambda: np.zeros(IDENTITY_SIZE))
    shape: NamedShape = field(default_factory=NamedShape)
    hair_style: str = "bald"
    hair_length: float = 1.0
    pigment: Pigment = field(default_factory=Pigment)
    groom: Groom = field(default_factory=Groom)
    dress: Dress = field(default_factory=Dress)
    relief: np.ndarray = field(default_factory=lambda: np.zeros(RELIEF_SIZE))

    def __post_init__(self) -> None:
        for name, size in (("identity", IDENTITY_SIZE), ("relief", RELIEF_SIZE)):
            value = np.asarray(getattr(self, name), np.float64)
            if value.shape != (size,) or not np.isfinite(value).all():
                raise InputError(
                    expected=f"{size} finite {name} coefficients",
                    received=f"an array of shape {value.shape}",
                    remedy="draw them with sample_params",
                )
            object.__setattr__(self, name, value)
        one_of("a hair style", self.hair_style, HAIR_STYLES)


def mean_params(hair_style: str = "bald") -> HeadParams:
    """The population's mean head."""
    return HeadParams(seed=0, hair_style=hair_style)


def sample_params(rng: np.random.Generator) -> HeadParams:
    """Draw one head from the population; everything from ``rng``, so the same seed gives the same head."""
    seed = int(rng.integers(2**31 - 1))
    identity = np.clip(rng.normal(size=IDENTITY_SIZE), -3.0, 3.0)
    shape = sample_shape(rng)
    relief = sample_relief(rng)
    male = bool(shape.sex + 0.3 * rng.normal() > 0.0)
    pigment = sample_pigment(rng, shape, male)
    style, length = sample_style(rng, shape, male, pigment.melanin)
    groom = sample_groom(rng, shape, male)
    return HeadParams(seed, identity, shape, style, length, pigment, groom, sample_dress(rng, style), relief)
