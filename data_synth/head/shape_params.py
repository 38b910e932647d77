"""Shape that has a name: cranium to neck, traits of the whole head, creases, and expression.

Notation: ``sigma`` units are standard deviations of the population; a named parameter of 0 is the mean head. Where each
parameter acts is in `data_synth.head.named`, what the traits do to the others in `data_synth.head.traits`, what an
expression does in `data_synth.head.expression`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from sira_assets.errors import InputError

BOUND_SIGMA = 3.0


@dataclass(frozen=True)
class NamedShape:
    """Named shape of a head: sigma units within -3 to 3, except where the table says otherwise.

    The last words of each line say what the positive direction does. Beyond these the identity coefficients carry the
    landmarks (see `data_synth.head.identity`) and the relief what has no name (`data_synth.head.relief`).

    Raises
    ------
    InputError : a value is not finite or out of its range.
    """

    # traits: act on the others
    sex: float = 0.0  # towards the male mean
    age: float = 0.0  # older
    weight: float = 0.0  # heavier
    # cranium
    cranium_width: float = 0.0  # wider
    cranium_length: float = 0.0  # longer backward
    cranium_height: float = 0.0  # higher vault
    occiput: float = 0.0  # protrudes
    parietal: float = 0.0  # fuller sides of the vault
    # forehead
    forehead_slope: float = 0.0  # slopes back
    forehead_height: float = 0.0  # higher
    forehead_width: float = 0.0  # wider at the temples' edge
    forehead_boss: float = 0.0  # frontal eminences fuller
    temple_hollow: float = 0.0  # hollower
    # brow
    brow_depth: float = 0.0  # ridge protrudes
    brow_outer: float = 0.0  # outer ridge protrudes and hangs
    glabella: float = 0.0  # protrudes
    # orbit and lids
    orbit_depth: float = 0.0  # hollow above the eye deeper
    eyelid: float = 0.0  # eyes more open
    eyelid_crease: float = 0.0  # crease deeper
    lid_fold: float = 0.0  # fold over the upper lid fuller, towards the inner corner
    eye_tilt: float = 0.0  # outer corners higher
    eye_bags: float = 0.0  # lower lid fuller
    tear_trough: float = 0.0  # groove below the inner eye deeper
    # nose
    nose_root: float = 0.0  # root higher
    nose_bridge_width: float = 0.0  # wider
    nose_hump: float = 0.0  # dorsum convex
    nose_tip_width: float = 0.0  # wider
    nose_tip_lift: float = 0.0  # turned up
    nose_wing_width: float = 0.0  # wider
    nose_wing_height: float = 0.0  # wings arch higher
    nostril: float = 0.0  # larger
    columella: float = 0.0  # hangs lower
    # cheek
    cheekbone: float = 0.0  # protrudes forward
    cheekbone_width: float = 0.0  # protrudes sideways
    cheek_fullness: float = 0.0  # fuller beside the mouth
    cheek_hollow: float = 0.0  # hollower below the cheekbone
    nasolabial_fold: float = 0.0  # deeper
    # lips and philtrum
    upper_lip_thickness: float = 0.0  # thicker
    lower_lip_thickness: float = 0.0  # thicker
    upper_lip_protrusion: float = 0.0  # protrudes
    lower_lip_protrusion: float = 0.0  # protrudes
    lip_border: float = 0.0  # sharper ridge along the vermilion
    mouth_corner: float = 0.0  # corners higher
    philtrum_depth: float = 0.0  # deeper
    marionette_fold: float = 0.0  # groove below the corners deeper
    # jaw and chin
    jaw_angle: float = 0.0  # wider
    jaw_line: float = 0.0  # edge sharper
    jaw_lower: float = 0.0  # edge lower (jowl)
    chin_protrusion: float = 0.0  # protrudes
    chin_width: float = 0.0  # wider
    chin_cleft: float = 0.0  # deeper
    mentolabial_fold: float = 0.0  # deeper
    double_chin: float = 0.0  # fuller
    # ears
    ear_size: float = 0.0  # larger
    ear_protrusion: float = 0.0  # stand out
    ear_tilt: float = 0.0  # tops lean back
    ear_lobe: float = 0.0  # lobes longer
    # neck and shoulders
    neck_width: float = 0.0  # wider
    neck_depth: float = 0.0  # deeper
    larynx: float = 0.0  # protrudes
    nape: float = 0.0  # fuller
    shoulder_width: float = 0.0  # wider
    shoulder_height: float = 0.0  # higher
    # mild asymmetry
    asymmetry_jaw: float = 0.0  # jaw to the subject's left
    asymmetry_brow: float = 0.0  # left brow higher
    asymmetry_nose: float = 0.0  # tip to the left
    asymmetry_mouth: float = 0.0  # left corner higher
    asymmetry_cheek: float = 0.0  # left cheek fuller
    # furrows, 0 (none) to 1
    forehead_lines: float = 0.0
    crow_feet: float = 0.0
    # expression, 0 to 1; brow_raise and gaze -1 to 1
    smile: float = 0.0
    mouth_open: float = 0.0
    eyes_closed: float = 0.0
    brow_raise: float = 0.0
    gaze_left: float = 0.0  # the irises turn left, by `data_synth.head.eyes.GAZE_DEGREES` at 1
    gaze_up: float = 0.0

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            low, high = bounds(name)
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(
                    expected=f"{name} within {low:g} and {high:g}", received=f"{value!r}", remedy="clip it to its range"
                )


TRAITS = ("sex", "age", "weight")
AMOUNTS = ("forehead_lines", "crow_feet")
EXPRESSION = ("smile", "mouth_open", "eyes_closed", "brow_raise", "gaze_left", "gaze_up")
SIGNED_EXPRESSION = ("brow_raise", "gaze_left", "gaze_up")
SIGMA_NAMES = tuple(f.name for f in fields(NamedShape) if f.name not in (*TRAITS, *AMOUNTS, *EXPRESSION))


def bounds(name: str) -> tuple[float, float]:
    """Lowest and highest value of a field of `NamedShape`."""
    if name in SIGNED_EXPRESSION:
        return -1.0, 1.0
    if name in AMOUNTS or name in EXPRESSION:
        return 0.0, 1.0
    return -BOUND_SIGMA, BOUND_SIGMA


def sigma_values(shape: NamedShape) -> np.ndarray:
    """The parameters in sigma units without the traits, in the order of `SIGMA_NAMES`."""
    return np.array([getattr(shape, name) for name in SIGMA_NAMES])


def trait_values(shape: NamedShape) -> np.ndarray:
    """Sex, age and weight: (3,)."""
    return np.array([getattr(shape, name) for name in TRAITS])


def neutral(shape: NamedShape) -> NamedShape:
    """The same shape without expression."""
    from dataclasses import replace

    return replace(shape, **dict.fromkeys(EXPRESSION, 0.0))


def sample_shape(rng: np.random.Generator) -> NamedShape:
    """Draw named shape and expression; every field from ``rng``."""
    sigma = np.clip(rng.normal(size=len(SIGMA_NAMES)), -BOUND_SIGMA, BOUND_SIGMA)
    values = dict(zip(SIGMA_NAMES, sigma.tolist(), strict=True))
    # two overlapping halves of unit variance together: 0.85^2 + 0.53^2 = 1
    values["sex"] = float(np.clip(rng.choice([-0.85, 0.85]) + 0.53 * rng.normal(), -BOUND_SIGMA, BOUND_SIGMA))
    # adults of 18 to 80 years about evenly: a uniform distribution of unit variance
    values["age"] = float(rng.uniform(-np.sqrt(3.0), np.sqrt(3.0)))
    values["weight"] = float(np.clip(rng.normal(), -BOUND_SIGMA, BOUND_SIGMA))
    older = np.clip(0.5 + 0.35 * values["age"], 0.0, 1.0)
    values["forehead_lines"] = float(older * rng.uniform(0.0, 0.9))
    values["crow_feet"] = float(older * rng.uniform(0.0, 0.9))
    # neutral or nearly so two times in three, as in portraits
    mood = rng.random(4) < (0.35, 0.35, 0.08, 0.35)
    values["smile"] = float(rng.uniform(0, 0.8)) if mood[0] else 0.0
    values["mouth_open"] = float(rng.uniform(0, 0.7)) if mood[1] else 0.0
    values["eyes_closed"] = float(rng.uniform(0.2, 1.0)) if mood[2] else 0.0
    values["brow_raise"] = float(rng.uniform(-0.7, 0.7)) if mood[3] else 0.0
    gaze = np.clip(rng.normal(size=2) * (0.3, 0.15), -1.0, 1.0)
    values["gaze_left"], values["gaze_up"] = float(gaze[0]), float(gaze[1])
    return NamedShape(**values)
