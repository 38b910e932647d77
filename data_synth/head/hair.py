"""Hair as geometry: a layer over the scalp, a fringe, hanging hair and knots, all one field.

Notation (millimetres, template frame): ``D`` distance from the earless scalp, ``T`` thickness of the layer there,
``h = D - T`` its field (negative inside; ``T = -3`` where nothing grows). Relief follows the strands of
`data_synth.head.hair_flow`.
"""

from __future__ import annotations

import numpy as np

from data_synth.head.hair_flow import clumps, strand_coordinates
from data_synth.head.hair_styles import STYLES, Curtain, HairStyle, hairline_height
from data_synth.head.noise import plane_noise, smooth_max, smooth_min, smoothstep
from data_synth.head.params import HeadParams
from data_synth.head.scalp import interpolate_scalp

NONE_MM = -3.0
RELIEF_REACH_MM = 8.0
LOWEST_LAYER_MM = -110.0


def thickness_mm(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Thickness ``T`` of the layer over the scalp at points (N, 3), `NONE_MM` where no hair grows; (N,)."""
    style, groom, size = STYLES[params.hair_style], params.groom, params.hair_length
    y, z = x_mm[:, 1], x_mm[:, 2]
    upper, rear = smoothstep(y, 22.0, 84.0), smoothstep(-z, 90.0, 140.0)
    thick = (style.side * (1 - rear) + style.back * rear) * (1 - upper) + style.top * upper
    thick = thick + style.quiff * upper * smoothstep(z, -75.0, -25.0)
    if style.thin_crown:
        thick = thick * (1 - style.thin_crown * np.exp(-0.5 * (((x_mm - [0, 95, -95]) / [36, 40, 44]) ** 2).sum(-1)))
    if style.part:
        line = np.exp(-0.5 * ((x_mm[:, 0] - 30.0 * groom.part) / 4.0) ** 2) * smoothstep(z, -120.0, -80.0) * upper
        thick = thick - np.minimum(style.part, 0.8 * thick) * line
        away = np.exp(-0.5 * ((x_mm[:, 0] + 20.0 * groom.part) / 30.0) ** 2)
        thick = thick + 0.2 * style.top * upper * away * smoothstep(z, -110.0, -40.0)
    # one side is never quite the other
    thick = size * thick * (1.0 + 0.07 * plane_noise(x_mm, params.seed + 11, 8, 85.0))
    above = hairline_height(x_mm, groom, style.recede)
    above = above + 1.7 * plane_noise(x_mm, params.seed + 5, 8, 13.0)
    if style.fringe is not None:
        # the fringe comes from farther up: nothing rises at the hairline
        above = above + 34.0 * smoothstep(z, -75.0, -40.0)
    # in front the layer rises from the forehead; elsewhere it ends in a cut
    front = smoothstep(z, -75.0, -30.0)
    grown = smoothstep(above / (style.edge + (0.4 + 0.8 * front) * np.maximum(thick, 0.0)), 0.0, 1.0)
    layer = (thick - NONE_MM) * grown + NONE_MM
    return np.maximum(layer, _fringe_mm(x_mm, params)) if style.fringe is not None else layer


def _fringe_mm(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Thickness of the locks over the forehead."""
    cut = STYLES[params.hair_style].fringe
    x, y = x_mm[:, 0], x_mm[:, 1]
    theta = np.degrees(np.arctan2(np.abs(x), x_mm[:, 2] + 80.0))
    drift = plane_noise(x_mm * [1.0, 0.35, 0.35], params.seed + 21, 8, 45.0)
    across = x / cut.locks + 0.35 * drift + 0.012 * (y - 40.0) * np.sign(params.groom.part or 1.0)
    notch = cut.notch * np.abs(np.cos(np.pi * across)) ** 1.5 * (1.0 + 0.4 * drift)
    tip = cut.tip_mm + cut.arch * (theta / 45.0) ** 2 + cut.slope * x * params.groom.part + notch
    above = y - np.maximum(tip, 21.0)
    thick = params.hair_length**0.5 * (2.2 + (cut.thick - 2.2) * smoothstep(above, 0.0, 34.0))
    grown = smoothstep(above, -1.0, 5.0) * (1 - smoothstep(theta, 44.0, 58.0)) * smoothstep(-y, -112.0, -92.0)
    return (thick - NONE_MM) * grown + NONE_MM


def _ellipse(a: np.ndarray, b: np.ndarray, ra: np.ndarray, rb: np.ndarray) -> np.ndarray:
    """About the distance from an ellipse with radii ``ra``, ``rb``, to first order."""
    k0 = np.sqrt((a / ra) ** 2 + (b / rb) ** 2) + 1e-9
    k1 = np.sqrt((a / ra**2) ** 2 + (b / rb**2) ** 2) + 1e-9
    return k0 * (k0 - 1.0) / k1


def _curtain_mm(x_mm: np.ndarray, cut: Curtain, params: HeadParams) -> np.ndarray:
    """Field of hanging hair: a lofted body of hair, cut open for the face and the throat."""
    from scipy.interpolate import PchipInterpolator

    groom = params.groom
    x, y, z = np.ascontiguousarray(x_mm.T)
    end = -20.0 + (cut.end_mm + 20.0) * params.hair_length
    if groom.wave > 0.05:
        down, turn = smoothstep(-y, -40.0, 80.0), np.arctan2(x, z + 88.0)
        size = (0.4 + 0.6 * groom.wave) * STYLES[params.hair_style].sway_mm
        sway = size * down * np.sin(2 * np.pi * y / 64.0 + 2.4 * np.sin(3 * turn + params.seed % 13))
        x, z = x + sway * np.cos(turn), z - sway * np.sin(turn)
    heights = np.array([end - 1.0, -105.0 if end < -120.0 else 0.5 * (end - 60.0), -60.0, -10.0, 45.0, 75.0])
    ear, jaw, tip = cut.half_mm
    ear_b, jaw_b, tip_b = cut.back_mm
    # smooth in height: a kink would show as a line around the head
    inside = np.clip(y, heights[0], heights[-1])
    half = PchipInterpolator(heights, [tip, 0.5 * (jaw + tip), jaw, ear, 0.88 * ear, 50.0])(inside)
    back = PchipInterpolator(heights, [tip_b, 0.5 * (jaw_b + tip_b), jaw_b, ear_b, 0.89 * ear_b, 56.0])(inside)
    body = _ellipse(x, z + 88.0, half, back)
    body = body - 1.6 * plane_noise(x_mm, params.seed + 31, 8, 80.0)
    fall = cut.front_mm + groom.front_fall_mm * smoothstep(-y, 20.0, 120.0) + 60.0 * smoothstep(y, 15.0, 75.0)
    inner = np.interp(y, [-200.0, -110.0, -60.0, 0.0, 25.0, 75.0], [44.0, 50.0, 57.0, 62.0, 62.0, 40.0])
    opening = smooth_max(np.abs(x_mm[:, 0]) - inner, -74.0 - z, 8.0)
    jag = 9.0 * np.abs(np.cos(14.0 * np.arctan2(x, z + 88.0) + params.seed % 5)) + 2.5 * plane_noise(
        x_mm, params.seed + 33, 8, 30.0
    )
    body = smooth_max(smooth_max(body, z - fall, 14.0), -opening, 10.0)
    # above, the layer on the scalp takes over
    return smooth_max(smooth_max(body, end + jag - y, 12.0), y - 60.0, 24.0)


def _ball_mm(x_mm: np.ndarray, style: HairStyle, size: float) -> np.ndarray:
    """Field of the ellipsoid that a round style is cut to."""
    cx, cy, cz, rx, ry, rz = style.ball
    radius = np.array([rx, ry, rz]) * (0.6 + 0.4 * size)
    offset = x_mm - [cx, cy, cz]
    k0 = np.linalg.norm(offset / radius, axis=1) + 1e-9
    return k0 * (k0 - 1.0) / (np.linalg.norm(offset / radius**2, axis=1) + 1e-12)


def knots_mm(x_mm: np.ndarray, style: HairStyle, size: float) -> np.ndarray:
    """Field of a bun or a tail: balls and the cones between them; +inf without. (N, 3) mm -> (N,) mm."""
    out = np.full(len(x_mm), np.inf)
    for (ax, ay, az, ar), (bx, by, bz, br) in zip(style.knots[:-1], style.knots[1:], strict=True):
        a, b = np.array([ax, ay, az]), np.array([bx, by, bz])
        axis = b - a
        t = np.clip((x_mm - a) @ axis / (axis @ axis), 0.0, 1.0)
        d = np.linalg.norm(x_mm - a - t[:, None] * axis, axis=1) - (ar + t * (br - ar)) * np.clip(size, 0.85, 1.1)
        out = smooth_min(out, d, 8.0) if np.isfinite(out).any() else d
    return out


def _relief_mm(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    style, groom = STYLES[params.hair_style], params.groom
    out = np.zeros(len(x_mm))
    if style.relief:
        u, w, fade = strand_coordinates(x_mm, style.flow, groom.part)
        out += groom.clump * style.relief * fade * clumps(u, w, style.locks, params.seed, groom.wave)
    if style.curl:
        ripple = np.clip(plane_noise(x_mm, params.seed, 18, style.curl_mm), -2.2, 2.2)
        # rounded curls with creases between them
        out += groom.clump * style.curl * (0.9 - 1.5 * np.exp(-2.5 * np.abs(ripple)))
    return out


def hair_field_mm(
    x_mm: np.ndarray, params: HeadParams, d_mm: np.ndarray | None = None, thickness: np.ndarray | None = None
) -> np.ndarray:
    """The hair's field ``h`` (mm, negative inside) at template points (N, 3) in mm; +inf where there is none.

    ``d_mm``: the scalp's distance there and ``thickness``: `thickness_mm`, if they are at hand.
    """
    style = STYLES[params.hair_style]
    if style.top == 0.0:
        return np.full(len(x_mm), np.inf)
    size = params.hair_length
    d = interpolate_scalp(x_mm) if d_mm is None else d_mm.astype(np.float64)
    reach = 1.35 * size * max(style.top + style.quiff, style.side, style.back) + RELIEF_REACH_MM
    # away from the scalp only the sign and a lower bound matter; nothing grows below the neck
    h = np.where(x_mm[:, 1] > LOWEST_LAYER_MM, d - reach + 4.0, d - NONE_MM)
    near = np.flatnonzero((np.abs(d) < reach) & (x_mm[:, 1] > LOWEST_LAYER_MM))
    layer = thickness_mm(x_mm[near], params) if thickness is None else thickness[near]
    h[near] = d[near] - layer
    if style.ball is not None:
        h[near] = smooth_max(h[near], _ball_mm(x_mm[near], style, size), 12.0)
    weight = np.zeros(len(x_mm))
    weight[near] = smoothstep(layer, -1.0, 3.0)
    if style.knots:
        h = smooth_min(h, knots_mm(x_mm, style, size), 10.0)
        weight[h < RELIEF_REACH_MM] = np.maximum(weight, x_mm[:, 2] < -165.0)[h < RELIEF_REACH_MM]
    if style.curtain is not None:
        h_curtain = _curtain_mm(x_mm, style.curtain, params)
        weight = np.maximum(weight, smoothstep(-h_curtain, -8.0, -2.0))
        h = smooth_min(h, h_curtain, 9.0)
    own = np.flatnonzero((np.abs(h) < RELIEF_REACH_MM) & (weight > 0))
    h[own] -= weight[own] * _relief_mm(x_mm[own], params)
    return h


def hair_cover(x_mm: np.ndarray, params: HeadParams, streaks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far hair hides what lies below, (N,) in [0, 1], and the hair's field there (mm).

    ``streaks``: unit noise along the strands, (N,): a hairline is not an edge, strands reach beyond it singly.
    """
    style = STYLES[params.hair_style]
    if style.top == 0.0:
        return np.zeros(len(x_mm)), np.full(len(x_mm), np.inf)
    d = interpolate_scalp(x_mm)
    thick = thickness_mm(x_mm, params)
    h = hair_field_mm(x_mm, params, d, thick)
    rooted = smoothstep(thick + 0.55 * streaks, -2.4, -0.4) * (x_mm[:, 1] > LOWEST_LAYER_MM)
    near = smoothstep(-h, -3.2 - 0.3 * streaks.clip(-1, 1), -1.1)
    thin = 1.0 - (1.0 - style.density) * smoothstep(0.5 - 0.5 * streaks, -0.5, 1.0)
    if style.thin_crown:
        bare = np.exp(-0.5 * (((x_mm - [0, 95, -95]) / [34, 40, 42]) ** 2).sum(-1))
        thin = thin * (1 - 0.75 * style.thin_crown * bare)
    hanging = np.zeros(len(x_mm))
    for part in (
        _curtain_mm(x_mm, style.curtain, params) if style.curtain is not None else None,
        knots_mm(x_mm, style, params.hair_length) if style.knots else None,
    ):
        if part is not None:
            hanging = np.maximum(hanging, smoothstep(-part, -4.5, -3.0) * smoothstep(-h, -2.4, -1.5))
    return np.maximum(rooted * near * thin, hanging), h
