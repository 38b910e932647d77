"""Hair of the face: brows, stubble and beards, where they grow and how far they raise the skin.

Notation: template frame, millimetres; everything is a function of position alone, so that relief may be subtracted from
the template's field and colour laid on the surface. Grades in [0, 1].
"""

from __future__ import annotations

import numpy as np

from data_synth.head.noise import plane_noise, smoothstep
from data_synth.head.params import HeadParams

# outlines of the left half (mm), through the population's mean landmarks
LIP_X = np.array([0.0, 3.5, 7.2, 12.0, 16.7, 21.0, 25.4])
LIP_TOP = np.array([-61.2, -60.4, -60.2, -61.6, -63.6, -66.6, -70.3])
LIP_BOTTOM = np.array([-78.9, -78.7, -78.2, -77.2, -75.6, -73.4, -70.4])
_BROW_X = np.array([9.0, 11.5, 17.0, 23.7, 30.0, 37.3, 43.0, 48.5, 57.1, 62.0])
_BROW_Y = np.array([19.0, 20.0, 21.4, 22.6, 23.6, 24.3, 23.8, 22.2, 16.0, 12.0])
_BROW_HALF = np.array([2.2, 3.2, 4.0, 4.0, 3.7, 3.2, 2.7, 2.2, 1.3, 0.6])
# where a cheek's beard begins and ends: height over |x|
_CHEEK_X = np.array([0.0, 20.0, 32.0, 44.0, 54.0, 62.0, 70.0])
_CHEEK_Y = np.array([-46.0, -50.0, -60.0, -58.0, -46.0, -30.0, -8.0])


def inside_lips_mm(x_mm: np.ndarray) -> np.ndarray:
    """Height within the lips' outline, positive inside; (N,)."""
    x, y = np.abs(x_mm[:, 0]), x_mm[:, 1]
    return np.minimum(np.interp(x, LIP_X, LIP_TOP) - y, y - np.interp(x, LIP_X, LIP_BOTTOM)) - 4.0 * np.clip(
        x - 25.4, 0.0, None
    )


def brow_cover(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """The brows' density: a band of slanting hairs."""
    groom = params.groom
    x, y = np.abs(x_mm[:, 0]), x_mm[:, 1]
    middle = np.interp(x, _BROW_X, _BROW_Y) + 1.6 * groom.brow_arch * np.exp(-0.5 * ((x - 41.0) / 9.0) ** 2)
    half = np.interp(x, _BROW_X, _BROW_HALF) * (1.0 + 0.35 * groom.brow_thickness)
    # inner hairs stand up, outer ones lie along the brow; both meet along the upper edge
    lean = x - np.interp(x, [8.0, 16.0, 35.0, 60.0], [0.1, 0.6, 1.5, 2.4]) * (y - middle)
    drift = plane_noise(x_mm, params.seed + 51, 8, 9.0)
    hairs = 0.5 + 0.30 * np.cos(3.6 * lean + 1.6 * drift) + 0.20 * np.cos(5.7 * lean + 0.8 * y + 2.0 * drift)
    edge = 1.0 - np.abs(y - middle + 0.35 * drift) / half
    band = smoothstep(edge + 0.5 * (hairs - 0.5), -0.15, 0.75)
    ends = smoothstep(x + 1.5 * drift, 8.0, 16.0) * smoothstep(61.0 - x, 0.0, 9.0) * smoothstep(x_mm[:, 2], -14.0, -6.0)
    return band * ends * (0.62 + 0.38 * hairs)


def _join(*grades: np.ndarray) -> np.ndarray:
    """Union without creases where grades overlap."""
    free = np.ones(len(grades[0]))
    for grade in grades:
        free = free * (1.0 - grade)
    return 1.0 - free


def beard_zone(x_mm: np.ndarray, kind: str) -> np.ndarray:
    """Where a beard of a `BEARDS` kind grows, soft over some millimetres; ``full`` is where stubble grows as well."""
    x, y, z = np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]
    lip_top = np.interp(x, LIP_X, LIP_TOP)
    free = smoothstep(-inside_lips_mm(x_mm), 0.3, 3.0)
    rear = np.interp(y, [-126.0, -108.0, -92.0, -72.0, -45.0, -5.0], [-34.0, -40.0, -50.0, -60.0, -66.0, -66.0])
    front = smoothstep(z - rear, 0.0, 14.0) * smoothstep(-4.0 - y, 0.0, 14.0)
    below = smoothstep(y + 126.0 + 0.25 * np.clip(z - 10.0, -70.0, 0.0), 0.0, 10.0)
    moustache = smoothstep(-50.5 - 0.10 * x - y, 0.0, 4.0) * smoothstep(33.0 - x, 0.0, 8.0) * smoothstep(z, 0.0, 8.0)
    moustache = moustache * smoothstep(y - lip_top + 3.5 + 0.6 * np.clip(x - 20.0, 0.0, 12.0), 0.0, 2.5)
    corner = smoothstep(x, 22.0, 29.0) * smoothstep(38.0 - x, 0.0, 9.0) * smoothstep(-54.0 - y, 0.0, 8.0)
    # below the lip hair begins at once in the middle, a few millimetres lower at the sides
    start = -80.0 - 3.5 * np.exp(-0.5 * ((x - 13.0) / 4.5) ** 2)
    chin = smoothstep(34.0 - x, 0.0, 14.0) * smoothstep(start - y, -1.5, 4.0)
    cheek = smoothstep(np.interp(x, _CHEEK_X, _CHEEK_Y) - y, 0.0, 11.0) * smoothstep(x, 27.0, 36.0)
    jaw = np.maximum(cheek, smoothstep(-88.0 - y, 0.0, 10.0) * smoothstep(x, 18.0, 28.0))
    if kind == "moustache":
        zone = moustache
    elif kind == "goatee":
        zone = _join(moustache, corner * smoothstep(y + 102.0, 0.0, 10.0), chin * smoothstep(30.0 - x, 0.0, 8.0))
    elif kind == "chin_strap":
        line = np.interp(x, [0.0, 25.0, 45.0, 56.0, 62.0, 70.0], [-99.0, -97.0, -87.0, -72.0, -46.0, -8.0])
        zone = smoothstep(line - y, 0.0, 6.0) * smoothstep(y - line + 30.0, 0.0, 8.0)
    elif kind in ("full", "long"):
        zone = _join(moustache, corner, chin, jaw)
    else:
        return np.zeros(len(x_mm))
    return zone * free * front * below


def beard_length_mm(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """How far the beard raises the skin where it is grown, before its edge; (N,)."""
    x, y = np.abs(x_mm[:, 0]), x_mm[:, 1]
    at_chin = smoothstep(-y, 78.0, 112.0) * smoothstep(48.0 - x, 0.0, 34.0)
    at_lip = smoothstep(y + 82.0, 0.0, 12.0) * smoothstep(36.0 - x, 0.0, 8.0)
    at_side = smoothstep(x, 48.0, 62.0) * smoothstep(y + 90.0, 0.0, 50.0)
    length = params.groom.beard_mm * (1 - 0.6 * at_side)
    return length * (0.55 + (1.0 if params.groom.beard == "long" else 0.5) * at_chin) * (1 - 0.45 * at_lip)


def face_hair_relief_mm(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """How far brows, stubble and beard raise the skin at points (N, 3); (N,) mm."""
    out = np.zeros(len(x_mm))
    brow = np.flatnonzero((x_mm[:, 1] > 0.0) & (x_mm[:, 2] > -16.0))
    out[brow] = (0.35 + 0.75 * params.pigment.brow_weight) * brow_cover(x_mm[brow], params)
    low = np.flatnonzero(x_mm[:, 1] <= 0.0)
    out[low] = _beard_relief_mm(x_mm[low], params)
    return out


def _beard_relief_mm(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    p, groom = params.pigment, params.groom
    out = np.zeros(len(x_mm))
    if p.stubble > 0.0:
        zone = beard_zone(x_mm, "full")
        out = out + 0.10 * p.stubble * zone * (1.0 + plane_noise(x_mm, params.seed + 55, 10, 4.0))
    if groom.beard != "none":
        zone = beard_zone(x_mm + 1.3 * plane_noise(x_mm, params.seed + 57, 8, 12.0)[:, None], groom.beard)
        length = beard_length_mm(x_mm, params)
        # locks run down from the ear and the lip, curled a little
        turn = np.arctan2(x_mm[:, 0], x_mm[:, 2] + 55.0)
        drift = plane_noise(x_mm, params.seed + 59, 10, 22.0)
        locks = np.abs(np.cos(17.0 * turn + 0.9 * drift + 0.02 * x_mm[:, 1]))
        curl = plane_noise(x_mm, params.seed + 61, 14, 9.0)
        relief = (0.16 * length + 0.4) * (locks - 0.65) + (0.05 * length + 0.15) * np.clip(curl, -2.0, 2.0)
        out = np.maximum(out, zone * np.maximum(length * smoothstep(zone, 0.0, 1.0) + relief, 0.2))
    return out


def beard_cover(x_mm: np.ndarray, params: HeadParams, streaks: np.ndarray) -> np.ndarray:
    """How far a beard hides the skin, [0, 1]; short beards let it through between hairs. ``streaks``: unit noise."""
    groom = params.groom
    if groom.beard == "none":
        return np.zeros(len(x_mm))
    zone = beard_zone(x_mm, groom.beard)
    density = np.clip(0.55 + 0.09 * groom.beard_mm, 0.0, 0.98)
    return density * smoothstep(zone + 0.10 * streaks, 0.08, 0.55)


def stubble_cover(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Grade of the stubble's shade, [0, 1]."""
    if params.pigment.stubble <= 0.0:
        return np.zeros(len(x_mm))
    uneven = 0.85 + 0.15 * plane_noise(x_mm, params.seed + 63, 10, 14.0)
    return params.pigment.stubble * beard_zone(x_mm, "full") * np.clip(uneven, 0.4, 1.2)
