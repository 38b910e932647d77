"""Landmark statistics of people, as the identity space uses them.

Notation: ``c`` (30,) coefficients in sigma units; landmarks = mean + sum_k c_k s_k d_k with principal standard
deviations ``s`` and directions ``d``. Metres, canonical head frame.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np

IDENTITY_SIZE = 30


@dataclass(frozen=True)
class Population:
    """Landmark statistics: mean and std (68, 3), principal std (30,) and directions (30, 68, 3); metres."""

    mean_m: np.ndarray
    std_m: np.ndarray
    principal_std_m: np.ndarray
    directions: np.ndarray

    @property
    def modes_m(self) -> np.ndarray:
        """Displacement of the landmarks per sigma: (30, 68, 3)."""
        return self.principal_std_m[:, None, None] * self.directions


@lru_cache(maxsize=1)
def load_population() -> Population:
    """The figures that ship with the package."""
    data = json.loads(resources.files("data_synth").joinpath("data/population.json").read_text(encoding="utf-8"))
    return Population(
        np.array(data["mean_m"]),
        np.array(data["std_m"]),
        np.array(data["principal_std_m"]),
        np.array(data["principal_directions"]).reshape(-1, 68, 3),
    )


def coefficients(landmarks_move_m: np.ndarray) -> np.ndarray:
    """Least-squares coefficients (30,) in sigma units of a displacement (68, 3) of the landmarks.

    The shipped directions are rounded to five digits, so they are orthogonal to 1e-4 only; hence least squares.
    """
    modes = load_population().modes_m.reshape(IDENTITY_SIZE, -1)
    return np.linalg.lstsq(modes.T, landmarks_move_m.reshape(-1), rcond=None)[0]
