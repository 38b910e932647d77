"""Sex, age and weight: directions over the named parameters and the landmarks.

Notation: trait ``t`` in sigma units; parameter ``p_eff = sqrt(1 - |m|^2) p + m . t`` with the row ``m`` of loadings, so
that every parameter keeps unit variance in the population. Landmark coefficients get ``gamma t``.

Which parameters a trait moves and in which direction follows the literature; how much is this generator's judgement,
except the landmarks' sex direction, which is calibrated: it is the least unusual displacement of the population's
landmarks that makes the published mean differences (minimum Mahalanobis length).

References: sex: Z. Zhuang and B. Bradtmiller 2005, DOI 10.1080/15459620500324727 (the survey behind ISO/TS 16976-2),
and M. Kesterke et al. 2016, DOI 10.1186/s13293-016-0076-8 (3D Facial Norms, FaceBase); age and weight: Z. Skomina
et al. 2020, DOI 10.1371/journal.pone.0231983.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from data_synth.head.named import NAMES
from data_synth.head.population import load_population
from data_synth.head.shape_params import TRAITS
from data_synth.one_thread import one_thread

LOADINGS: dict[str, dict[str, float]] = {
    "sex": {
        "brow_depth": 0.45,
        "brow_outer": 0.30,
        "glabella": 0.35,
        "forehead_slope": 0.30,
        "forehead_boss": -0.30,
        "orbit_depth": 0.30,
        "eyelid": -0.20,
        "nose_hump": 0.20,
        "cheek_fullness": -0.20,
        "cheekbone": -0.20,
        "upper_lip_thickness": -0.20,
        "lower_lip_thickness": -0.15,
        "jaw_angle": 0.40,
        "jaw_line": 0.30,
        "chin_width": 0.35,
        "chin_protrusion": 0.25,
        "ear_size": 0.30,
        "larynx": 0.70,
        "neck_width": 0.50,
        "neck_depth": 0.35,
        "shoulder_width": 0.50,
    },
    "age": {
        "nasolabial_fold": 0.55,
        "marionette_fold": 0.50,
        "eye_bags": 0.40,
        "tear_trough": 0.45,
        "lid_fold": 0.40,
        "eyelid": -0.25,
        "brow_outer": 0.15,
        "temple_hollow": 0.35,
        "cheek_hollow": 0.30,
        "jaw_lower": 0.45,
        "jaw_line": -0.30,
        "double_chin": 0.20,
        "upper_lip_thickness": -0.45,
        "lower_lip_thickness": -0.30,
        "lip_border": -0.30,
        "mouth_corner": -0.30,
        "philtrum_depth": -0.30,
        "nose_tip_lift": -0.35,
        "ear_size": 0.40,
        "ear_lobe": 0.40,
    },
    "weight": {
        "cheek_fullness": 0.65,
        "cheek_hollow": -0.45,
        "cheekbone_width": 0.20,
        "temple_hollow": -0.40,
        "double_chin": 0.60,
        "jaw_angle": 0.30,
        "jaw_line": -0.40,
        "jaw_lower": 0.25,
        "chin_width": 0.20,
        "nose_wing_width": 0.15,
        "neck_width": 0.45,
        "neck_depth": 0.40,
        "nape": 0.50,
        "larynx": -0.25,
        "shoulder_width": 0.25,
    },
}

# Two landmarks (iBUG, 0-based) and the axis their distance is measured along; male over female mean of the survey:
# bizygomatic 143.5/135.1, bigonial 120.4/110.1, nose breadth 36.6/33.2, lip length 51.1/48.0, menton-sellion
# 122.7/113.4, subnasale-sellion 52.0/48.2, interpupillary 64.5/61.9 mm.
_SEX_RATIOS = (
    (1, 15, 0, 143.5 / 135.1),
    (4, 12, 0, 120.4 / 110.1),
    (31, 35, 0, 36.6 / 33.2),
    (48, 54, 0, 51.1 / 48.0),
    (8, 27, 1, 122.7 / 113.4),
    (33, 27, 1, 52.0 / 48.2),
    (36, 45, 0, 64.5 / 61.9),
)
# between the means of the two sexes as `sample_shape` draws them
_SEX_SIGMAS = 1.7
# per sigma, millimetres: thinner lips and a longer upper lip with age; a wider lower face with weight
_AGE_MM = ((51, 62, 1, 0.35), (57, 66, 1, -0.30), (33, 51, 1, -0.35))
_WEIGHT_MM = ((1, 15, 0, 1.2), (3, 13, 0, 1.8), (4, 12, 0, 1.8), (31, 35, 0, 0.3))
# how exactly the differences are met
_TOLERANCE_MM = 0.3


@lru_cache(maxsize=1)
@one_thread
def trait_loadings() -> np.ndarray:
    """Loadings ``m``: (len(NAMES), 3)."""
    out = np.zeros((len(NAMES), len(TRAITS)))
    for k, trait in enumerate(TRAITS):
        for name, loading in LOADINGS[trait].items():
            out[NAMES.index(name), k] = loading
    return out


def effective_values(own: np.ndarray, traits: np.ndarray) -> np.ndarray:
    """``p_eff`` (len(NAMES),) of own values (len(NAMES),) and traits (3,). Amounts (furrows) pass unchanged."""
    m = trait_loadings()
    return np.sqrt(1.0 - (m**2).sum(1)) * own + m @ traits


def _least_unusual(rows: list[tuple[int, int, int, float]]) -> np.ndarray:
    """Coefficients (30,) that change the signed distances ``b - a`` along an axis by so many millimetres."""
    modes = load_population().modes_m * 1e3
    g = np.stack([modes[:, b, k] - modes[:, a, k] for a, b, k, _ in rows])
    want = np.array([r[3] for r in rows])
    return g.T @ np.linalg.solve(g @ g.T + _TOLERANCE_MM**2 * np.eye(len(g)), want)


@lru_cache(maxsize=1)
@one_thread
def trait_coefficients() -> np.ndarray:
    """``gamma``: landmark coefficients per sigma of each trait, (30, 3)."""
    mean = load_population().mean_m * 1e3
    # sizes are normalised in the canonical frame: what counts is each ratio over the faces' mean ratio
    size = float(np.exp(np.mean([np.log(r[3]) for r in _SEX_RATIOS[3:]])))
    sex = []
    for a, b, axis, ratio in _SEX_RATIOS:
        distance = mean[b, axis] - mean[a, axis]
        sex.append((a, b, axis, distance * (ratio / size - 1.0) / _SEX_SIGMAS))
    return np.stack([_least_unusual(sex), _least_unusual(list(_AGE_MM)), _least_unusual(list(_WEIGHT_MM))], 1)
