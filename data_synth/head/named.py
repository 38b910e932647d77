"""Where each named parameter acts on the template, in millimetres per sigma.

Notation: template points in millimetres, canonical frame, +X the subject's left. A push moves what lies in a bell
(`data_synth.head.bells`); ``pair`` adds its mirror image, ``odd`` adds its mirror image with the opposite amount
(asymmetry). A crease is a row of bells. Widths across a crease are its own, along the surface normal wide, so that a
crease shears space and does not fold it. Cranium, neck, shoulders and ears scale about a middle instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.head.bells import Bells, sum_bells
from data_synth.head.shape_params import AMOUNTS, SIGMA_NAMES
from data_synth.one_thread import one_thread

NAMES = (*SIGMA_NAMES, *AMOUNTS)


@dataclass(frozen=True)
class Push:
    """One bell: centre, widths and displacement at the centre (mm); ``mirror`` is +1 (pair), -1 (odd) or 0 (alone)."""

    centre: tuple[float, float, float]
    width: tuple[float, float, float]
    move: tuple[float, float, float]
    mirror: int = 0


def pair(centre: tuple, width: tuple, move: tuple) -> tuple[Push, ...]:
    """Left and right alike."""
    return (Push(centre, width, move, 1),)


def odd(centre: tuple, width: tuple, move: tuple) -> tuple[Push, ...]:
    """The left as given, the right by the opposite amount of its mirror image."""
    return (Push(centre, width, move, -1),)


def middle(centre: tuple, width: tuple, move: tuple) -> tuple[Push, ...]:
    """On the midline, or one side alone."""
    return (Push(centre, width, move),)


def crease(points: tuple, width: tuple, move: tuple, mirror: int = 1) -> tuple[Push, ...]:
    """A row of bells along a polyline, one every width; their sum along the row is ``move``."""
    p = np.array(points, float)
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))]
    step = min(width)
    count = max(int(np.ceil(length[-1] / step)), 1) + 1
    at = np.linspace(0.0, length[-1], count)
    centres = np.stack([np.interp(at, length, p[:, k]) for k in range(3)], 1)
    own = np.array(width, float)
    # the sum of the bells half way along the row
    total = sum_bells(Bells(centres, np.tile(own, (count, 1)), np.ones((count, 1))), centres[[count // 2]])[0, 0]
    scaled = tuple(float(m / total) for m in move)
    return tuple(Push(tuple(c), width, scaled, mirror) for c in centres.tolist())


_UPPER_BORDER = ((0, -60.6, 33), (7, -59.8, 32), (13, -61.6, 29.5), (19, -65, 24))
_LOWER_BORDER = ((0, -79, 30.5), (9, -78.3, 29), (15.5, -76.4, 26))
_FOREHEAD_LINES = (((-30, 46, 16), (0, 44, 22), (30, 46, 16)), ((-32, 57, 12), (0, 55, 19), (32, 57, 12)))
_CROW_FEET = (((49, 1, -1), (59, 6, -8)), ((50, -2, -2), (61, -3, -9)), ((49, -5, -1), (58, -11, -7)))

PUSHES: dict[str, tuple[Push, ...]] = {
    "parietal": pair((58, 55, -85), (30, 36, 45), (1.5, 0, 0)),
    "occiput": middle((0, 10, -165), (50, 45, 40), (0, 0, -3.0)),
    "forehead_slope": middle((0, 75, 0), (55, 30, 42), (0, 0, -3.2)),
    "forehead_width": pair((48, 45, 0), (20, 28, 28), (1.4, 0, 0.6)),
    "forehead_boss": pair((24, 60, 14), (17, 17, 18), (0.2, 0, 1.2)),
    "temple_hollow": pair((64, 18, -25), (20, 20, 24), (-1.8, 0, 0)),
    "brow_depth": pair((26, 20, 16), (17, 9, 16), (0, 0, 1.2)),
    "brow_outer": pair((46, 17, 4), (10, 8, 12), (0.5, -0.6, 0.9)),
    "glabella": middle((0, 18, 22), (10, 10, 12), (0, 0, 1.0)),
    "orbit_depth": pair((30, 12, 10), (12, 5.5, 10), (0, 0, -1.1)),
    "eyelid": pair((31, 6, 9), (10, 4.5, 8), (0, 0.45, 0)),
    "eyelid_crease": crease(((20, 3, 9.5), (26, 6.6, 12), (33, 7.4, 11.5), (41, 5, 8)), (2.4, 1.2, 6), (0, 0, -0.5)),
    "lid_fold": pair((24, 7.5, 11), (7.5, 3.2, 8), (0, -0.7, 0.6)),
    "eye_tilt": pair((43, -1, 3), (7, 6, 9), (0, 0.7, 0)) + pair((18, -3, 8), (5, 4, 6), (0, -0.3, 0)),
    "eye_bags": pair((31, -13, 9), (9, 4.2, 8), (0, 0, 0.8)),
    "tear_trough": crease(((18, -9, 10), (23, -14, 10), (30, -18.5, 9.5)), (3.2, 2.6, 8), (0, 0, -0.7)),
    "nose_root": middle((0, 4, 21), (6, 8, 10), (0, 0, 1.1)),
    "nose_bridge_width": pair((8, -10, 22), (4.5, 11, 9), (0.7, 0, 0)),
    "nose_hump": middle((0, -12, 30), (6, 7, 10), (0, 0, 0.9)),
    "nose_tip_width": pair((6, -32, 40), (5, 6, 8), (0.8, 0, 0)),
    "nose_tip_lift": middle((0, -34, 42), (9, 8, 10), (0, 1.0, 0.2)),
    "nose_wing_width": pair((14, -40, 22), (6, 7, 9), (0.9, 0, 0)),
    "nose_wing_height": pair((13, -43, 26), (5, 4, 8), (0, 0.7, 0)),
    "nostril": pair((6.5, -44, 29), (3.2, 3.5, 6), (0.3, 0.6, 0)),
    "columella": middle((0, -46, 33), (4, 5, 7), (0, -0.8, 0)),
    "cheekbone": pair((42, -25, 2), (14, 11, 15), (0.3, 0, 0.9)),
    "cheekbone_width": pair((60, -20, -20), (12, 12, 16), (1.1, 0, 0)),
    "cheek_fullness": pair((44, -54, 0), (17, 17, 20), (0.9, 0, 0.8)),
    "cheek_hollow": pair((48, -42, -6), (12, 11, 16), (-0.7, 0, -0.4)),
    "nasolabial_fold": crease(
        ((17, -44, 20), (22, -52, 18), (27, -61, 14), (30, -69, 10)), (2.4, 4, 9), (-0.2, 0, -0.6)
    )
    + crease(((24, -42, 17), (29, -51, 14), (34, -60, 9)), (4.5, 6, 10), (0.1, 0, 0.5)),
    "upper_lip_thickness": crease(_UPPER_BORDER, (4.5, 2.4, 8), (0, 0.6, 0.15)),
    "lower_lip_thickness": crease(_LOWER_BORDER, (4.5, 2.6, 8), (0, -0.7, 0.15)),
    "upper_lip_protrusion": middle((0, -63, 30), (14, 5, 9), (0, 0, 0.9)),
    "lower_lip_protrusion": middle((0, -75, 28), (13, 5, 9), (0, 0, 0.9)),
    "lip_border": crease(_UPPER_BORDER, (2.4, 1.2, 6), (0, 0, 0.35))
    + crease(_LOWER_BORDER, (2.4, 1.3, 6), (0, 0, 0.25)),
    "mouth_corner": pair((25.5, -70, 16), (5, 4.5, 9), (0, 0.7, 0)),
    "philtrum_depth": middle((0, -55, 29), (2.4, 5, 8), (0, 0, -0.5))
    + pair((4.8, -55, 28.5), (2.0, 5, 8), (0, 0, 0.25)),
    "marionette_fold": crease(((27, -74, 12), (28, -82, 10), (27, -90, 8)), (2.6, 4, 9), (0, 0, -0.6)),
    "jaw_angle": pair((58, -76, -38), (21, 23, 26), (1.6, -0.6, 0)),
    "jaw_line": pair((46, -92, -14), (14, 6, 14), (0.5, -0.3, 0)) + pair((40, -104, -22), (16, 7, 18), (-0.2, 0.8, 0)),
    "jaw_lower": pair((36, -98, -6), (13, 10, 16), (0.2, -1.2, 0)),
    "chin_protrusion": middle((0, -103, 16), (16, 12, 14), (0, 0, 1.4)),
    "chin_width": pair((14, -102, 14), (8, 9, 10), (1.0, 0, 0)),
    "chin_cleft": middle((0, -103, 21), (2.6, 6, 8), (0, 0, -0.5)),
    "mentolabial_fold": middle((0, -87, 22), (15, 4, 9), (0, 0, -0.8)),
    "double_chin": middle((0, -118, -15), (30, 16, 26), (0, -3.0, 1.0)),
    "ear_lobe": pair((81, -54, -76), (8, 9, 10), (0, -1.6, 0)),
    "larynx": middle((0, -145, -30), (7, 10, 12), (0, 0, 1.3)),
    "nape": middle((0, -95, -130), (34, 32, 24), (0, 0, -2.5)),
    "asymmetry_jaw": middle((0, -95, 0), (58, 34, 40), (0.8, 0, 0)),
    "asymmetry_brow": odd((32, 16, 10), (22, 16, 24), (0, 0.5, 0)),
    "asymmetry_nose": middle((0, -33, 40), (10, 12, 14), (0.6, 0, 0)),
    "asymmetry_mouth": odd((25, -70, 16), (9, 7, 12), (0, 0.4, 0)),
    "asymmetry_cheek": odd((45, -40, 0), (17, 19, 20), (0.4, 0, 0.5)),
    "forehead_lines": crease(_FOREHEAD_LINES[0], (5, 1.5, 9), (0, 0, -0.7), 0)
    + crease(_FOREHEAD_LINES[1], (5, 1.5, 9), (0, 0, -0.6), 0),
    "crow_feet": tuple(p for line in _CROW_FEET for p in crease(line, (2.4, 1.2, 8), (-0.25, 0, -0.35))),
}
SCALED = (
    "cranium_width",
    "cranium_length",
    "cranium_height",
    "forehead_height",
    "ear_size",
    "ear_protrusion",
    "ear_tilt",
    "neck_width",
    "neck_depth",
    "shoulder_width",
    "shoulder_height",
)


@lru_cache(maxsize=1)
@one_thread
def named_bells() -> tuple[Bells, np.ndarray]:
    """All bells with their vectors per sigma, (Q, 3), and the parameter's index in `NAMES` each belongs to, (Q,)."""
    rows: list[tuple[int, tuple, tuple, tuple]] = []
    for name, pushes in PUSHES.items():
        index = NAMES.index(name)
        for p in pushes:
            rows.append((index, p.centre, p.width, p.move))
            # a bell on the midline is its own mirror image
            if p.mirror and p.centre[0] != 0.0:
                move = (-p.move[0] * p.mirror, p.move[1] * p.mirror, p.move[2] * p.mirror)
                rows.append((index, (-p.centre[0], *p.centre[1:]), p.width, move))
    return (
        Bells(
            np.array([r[1] for r in rows], float), np.array([r[2] for r in rows], float), np.array([r[3] for r in rows])
        ),
        np.array([r[0] for r in rows]),
    )


def weighted_bells(values: np.ndarray) -> Bells:
    """The bells of parameter values (len(NAMES),): vectors (Q, 3) in millimetres."""
    bells, index = named_bells()
    return Bells(bells.centre_mm, bells.width_mm, bells.vector * values[index][:, None])


def smooth_step(x: np.ndarray, start: float, width: float) -> np.ndarray:
    """Smooth step from 0 below ``start - width`` to 1 above ``start + width``; twice differentiable."""
    t = np.clip((x - (start - width)) / (2 * width), 0.0, 1.0)
    return t * t * t * (t * (6 * t - 15) + 10)


def scaled_displacement_mm(x_mm: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Displacement (N, 3) of cranium, ears, neck and shoulders at (N, 3), millimetres; linear in ``values``."""
    v = dict(zip(NAMES, values.tolist(), strict=True))
    u = np.zeros_like(x_mm)
    x, y, z = x_mm.T
    if any(v[name] for name in ("cranium_width", "cranium_length", "cranium_height", "forehead_height")):
        above = smooth_step(y, 40.0, 35.0) * smooth_step(-z, -5.0, 40.0)
        above = np.clip(above + smooth_step(-z, 75.0, 35.0) * smooth_step(y, -25.0, 40.0), 0.0, 1.0)
        behind = smooth_step(-z, 60.0, 60.0) * smooth_step(y, -40.0, 60.0)
        u[:, 0] += 0.030 * v["cranium_width"] * above * x
        u[:, 2] += 0.035 * v["cranium_length"] * behind * (z + 60.0)
        u[:, 1] += 0.026 * v["cranium_height"] * smooth_step(y, 75.0, 70.0) * (y - 10.0)
        u[:, 1] += 0.030 * v["forehead_height"] * smooth_step(y, 55.0, 45.0) * smooth_step(z, -40.0, 50.0) * (y - 10.0)
    if any(v[name] for name in ("neck_width", "neck_depth", "shoulder_width", "shoulder_height")):
        neck = smooth_step(-y, 115.0, 30.0) * (1 - smooth_step(-y, 185.0, 40.0))
        shoulders = smooth_step(-y, 195.0, 35.0)
        u[:, 0] += (0.055 * v["neck_width"] * neck + 0.07 * v["shoulder_width"] * shoulders) * x
        u[:, 2] += 0.05 * v["neck_depth"] * neck * (z + 75.0)
        high = smooth_step(-y, 165.0, 30.0) * smooth_step(np.abs(x), 75.0, 45.0)
        u[:, 1] += 4.0 * v["shoulder_height"] * high
    if any(v[name] for name in ("ear_size", "ear_protrusion", "ear_tilt")):
        # about the root; outward behind it
        q = (np.stack([np.abs(x), y, z], 1) - (84.0, -28.0, -82.0)) / (9.0, 26.0, 20.0)
        ear = np.clip(1.5 * np.exp(-0.5 * (q**2).sum(1)), 0.0, 1.0)
        u[:, 1] += (0.055 * v["ear_size"] * (y + 28.0) + 0.05 * v["ear_tilt"] * (z + 82.0)) * ear
        u[:, 2] += (0.055 * v["ear_size"] * (z + 70.0) - 0.05 * v["ear_tilt"] * (y + 28.0)) * ear
        u[:, 0] += 1.6 * v["ear_protrusion"] * ear * np.sign(x) * smooth_step(-z, 80.0, 18.0)
    return u


def named_displacement_mm(x_mm: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Displacement (N, 3) of all named parameters at template points (N, 3), millimetres.

    ``values``: (len(NAMES),) effective values in sigma units, in the order of `NAMES`.
    """
    return scaled_displacement_mm(x_mm, values) + sum_bells(weighted_bells(values), x_mm)
