"""Cap, beanie and headband: layers over the scalp, and a cap's peak.

Notation: template frame, millimetres; ``D`` distance from the earless scalp, ``edge`` the height of the lower rim over
azimuth, ``g`` the headwear's field (negative inside).
"""

from __future__ import annotations

import numpy as np

from data_synth.head.hair_styles import STYLES
from data_synth.head.noise import bump, plane_noise, smooth_max, smooth_min, smoothstep
from data_synth.head.params import HeadParams

# azimuth (degrees) from the face and the rim's height there; it passes over the ears, which reach y = 0
_AZIMUTH = np.array([0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0])
_RIM = {
    "cap": np.array([52.0, 48.0, 32.0, 12.0, -2.0, -10.0, -14.0]),
    "beanie": np.array([44.0, 40.0, 24.0, 5.0, -16.0, -30.0, -34.0]),
    "headband": np.array([62.0, 59.0, 44.0, 18.0, -2.0, -16.0, -22.0]),
}
BAND_MM = 36.0  # height of a headband
VISOR_FRONT_MM = 92.0


def _rim(x_mm: np.ndarray, kind: str) -> np.ndarray:
    """Height above the lower rim, (N,)."""
    from scipy.interpolate import PchipInterpolator

    theta = np.degrees(np.arctan2(np.abs(x_mm[:, 0]), x_mm[:, 2] + 82.0))
    return x_mm[:, 1] - PchipInterpolator(_AZIMUTH, _RIM[kind])(theta)


def headwear_zone(x_mm: np.ndarray, kind: str) -> np.ndarray:
    """Where headwear lies on the head, [0, 1], whatever the distance."""
    if kind == "none":
        return np.zeros(len(x_mm))
    above = _rim(x_mm, kind)
    zone = smoothstep(above, -1.0, 1.5)
    return zone * smoothstep(BAND_MM - above, -1.0, 1.5) if kind == "headband" else zone


def _thickness(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    kind, style = params.dress.headwear, STYLES[params.hair_style]
    above = _rim(x_mm, kind)
    upper = smoothstep(x_mm[:, 1], 30.0, 90.0)
    # hair below is pressed flat, not away
    hair = 0.22 * (style.top * upper + style.side * (1 - upper)) * params.hair_length
    turn = np.arctan2(x_mm[:, 0], x_mm[:, 2] + 86.0)
    crown = smoothstep(np.hypot(x_mm[:, 0], x_mm[:, 2] + 86.0), 8.0, 30.0)
    if kind == "beanie":
        rib = 0.55 * np.cos(64 * turn + 0.5 * np.sin(5 * turn)) * crown
        fold = 2.6 * smoothstep(40.0 + 1.5 * np.sin(3 * turn + params.seed % 7) - above, 0.0, 3.0)
        slack = 9.0 * bump(x_mm, (0.0, 112.0, -105.0), (42.0, 26.0, 46.0))
        return 4.2 + hair + rib + fold + slack + 0.8 * plane_noise(x_mm, params.seed + 71, 8, 60.0)
    if kind == "cap":
        seam = -0.7 * np.exp(-0.5 * (np.sin(3 * turn) * np.hypot(x_mm[:, 0], x_mm[:, 2] + 86.0) / 3.6) ** 2) * crown
        button = 2.5 * np.exp(-0.5 * ((x_mm[:, 0] / 6.0) ** 2 + ((x_mm[:, 2] + 86.0) / 6.0) ** 2))
        stiff = 5.0 * bump(x_mm, (0.0, 88.0, -30.0), (46.0, 24.0, 36.0))
        band = 0.6 * smoothstep(18.0 - above, 0.0, 2.0)
        return 4.0 + hair + seam + band + stiff + button * (x_mm[:, 1] > 100.0)
    fold = 0.5 * np.cos(2 * np.pi * above / 12.0) + 0.6 * plane_noise(x_mm, params.seed + 73, 8, 30.0)
    return 3.4 + hair + fold


def _visor_mm(x_mm: np.ndarray) -> np.ndarray:
    """A curved plate before the forehead."""
    x, y, z = x_mm.T
    height = 56.0 - 0.20 * (z - 12.0) - 0.0042 * x * x
    front = VISOR_FRONT_MM - 0.0155 * x * x
    plate = np.abs(y - height) - 2.3
    return smooth_max(smooth_max(plate, z - front, 3.0), np.maximum(-12.0 - z, np.abs(x) - 72.0), 3.0)


def headwear_reach(x_mm: np.ndarray, kind: str) -> np.ndarray:
    """Where headwear can be at all, [0, 1]: its zone, and a cap's peak."""
    zone = headwear_zone(x_mm, kind)
    return np.maximum(zone, smoothstep(-_visor_mm(x_mm), -4.0, -2.0)) if kind == "cap" else zone


def headwear_field_mm(x_mm: np.ndarray, params: HeadParams, d_mm: np.ndarray) -> np.ndarray:
    """Field ``g`` (mm) at points (N, 3), whose distance from the scalp is ``d_mm``; +inf without headwear."""
    kind = params.dress.headwear
    if kind == "none":
        return np.full(len(x_mm), np.inf)
    zone = headwear_zone(x_mm, kind)
    layer = d_mm - (_thickness(x_mm, params) * zone - 4.0 * (1 - zone))
    return smooth_min(layer, _visor_mm(x_mm), 5.0) if kind == "cap" else layer


def under_headwear(h_mm: np.ndarray, g_mm: np.ndarray, x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """The hair's field, pressed at least 2 mm below the headwear where that lies; none at all (+inf) stays none."""
    kind = params.dress.headwear
    if kind == "none":
        return h_mm
    return h_mm + headwear_zone(x_mm, kind) * np.maximum(g_mm + 2.0 - h_mm, 0.0)


def headwear_colour(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Diffuse albedo of the fabric, (N, 3)."""
    colour = np.array(params.dress.headwear_colour)
    turn = np.arctan2(x_mm[:, 0], x_mm[:, 2] + 86.0)
    shade = 1.0 + 0.03 * plane_noise(x_mm, params.seed + 75, 12, 5.0)
    if params.dress.headwear == "beanie":
        shade = shade * (1.0 + 0.14 * np.cos(64 * turn + 0.5 * np.sin(5 * turn)))
    return colour * np.clip(shade, 0.5, 1.5)[:, None]
