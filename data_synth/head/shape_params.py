"""Shape that has a name: parameters between and beyond the landmarks, and expression.

Notation: ``sigma`` units are standard deviations of the population; a named parameter of 0 is the mean head.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class NamedShape:
    """Shape between and beyond the landmarks, in sigma units (-3 to 3), and expression (0 to 1, brow -1 to 1).

    Positive means: forehead sloping back, higher, wider and longer cranium, fuller cheeks, wider neck, wider jaw
    angle, larger and more protruding ears, wider nose wings, eyes more open, wider shoulders, longer nape.
    """

    forehead_slope: float = 0.0
    forehead_height: float = 0.0
    cranium_width: float = 0.0
    cranium_length: float = 0.0
    occiput: float = 0.0
    cheek_fullness: float = 0.0
    temple_hollow: float = 0.0
    neck_width: float = 0.0
    neck_depth: float = 0.0
    jaw_angle: float = 0.0
    double_chin: float = 0.0
    ear_size: float = 0.0
    ear_protrusion: float = 0.0
    nose_wing_width: float = 0.0
    eyelid: float = 0.0
    brow_depth: float = 0.0
    shoulder_width: float = 0.0
    shoulder_height: float = 0.0
    asymmetry_jaw: float = 0.0
    asymmetry_brow: float = 0.0
    smile: float = 0.0
    mouth_open: float = 0.0
    brow_raise: float = 0.0
    sex: float = 0.0  # towards male: who has a beard, who long hair
    age: float = 0.0  # -1.73 (18 years) to 1.73 (80)
    gaze_left: float = 0.0  # -1 to 1, as gaze_up: the irises turn by up to 20 degrees
    gaze_up: float = 0.0


def sample_shape(rng: np.random.Generator) -> NamedShape:
    """Draw named shape and expression; every field from ``rng``."""
    sigma = np.clip(rng.normal(size=len(fields(NamedShape))), -2.5, 2.5)
    values = dict(zip((f.name for f in fields(NamedShape)), sigma.tolist(), strict=True))
    # neutral or nearly so two times in three, as in portraits
    mood = rng.random(3) < 0.35
    values["smile"] = float(rng.uniform(0, 0.8)) if mood[0] else 0.0
    values["mouth_open"] = float(rng.uniform(0, 0.7)) if mood[1] else 0.0
    values["brow_raise"] = float(rng.uniform(-0.7, 0.7)) if mood[2] else 0.0
    values["gaze_left"], values["gaze_up"] = (float(v) for v in np.clip(rng.normal(size=2) * (0.3, 0.15), -1, 1))
    values["age"] = float(rng.uniform(-1.73, 1.73))
    return NamedShape(**values)
