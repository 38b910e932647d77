"""Eyes and lids as material: iris, sclera, lashes, the inner corner.

Notation: template frame, millimetres, folded to the left side (``|x|``). ``r`` is the way over the eyeball from the
middle of the iris, which the gaze turns; ``opening`` the signed height over the almond between the lids.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from data_synth.head.noise import plane_noise, smoothstep
from data_synth.head.params import HeadParams
from data_synth.head.template import eyeball_field, lid_opening, load_template

IRIS_MM, PUPIL_MM = 5.9, 1.9
GAZE_DEGREES = 20.0  # at a gaze of 1


@dataclass(frozen=True)
class EyeMasks:
    """At N points, [0, 1]: the eye between the lids, lashes and lid line, the moist inner corner and lid margin."""

    eye: np.ndarray
    lashes: np.ndarray
    moist: np.ndarray


def eye_masks(x_mm: np.ndarray, params: HeadParams) -> EyeMasks:
    """Coverage at template points (N, 3) in millimetres."""
    x, z = np.abs(x_mm[:, 0]), x_mm[:, 2]
    template = load_template()
    eye, lashes, moist = (np.zeros(len(x_mm)) for _ in range(3))
    own = np.flatnonzero((np.abs(x_mm[:, 1]) < 16.0) & (x > 12.0) & (x < 52.0) & (z > -6.0))
    if not len(own):
        return EyeMasks(eye, lashes, moist)
    with torch.no_grad():
        p = torch.tensor(x_mm[own], dtype=template.eyeball.dtype)
        ball = eyeball_field(template, p).numpy()
        opening, upper, lower = (a.numpy() for a in lid_opening(template, p))
    x, z = x[own], z[own]
    # the narrow gap between lid and eyeball counts as eye
    eye[own] = smoothstep(-np.abs(ball), -3.5, -2.5) * smoothstep(-opening, -0.3, 0.15) * smoothstep(z, -2.0, 0.0)
    corner = smoothstep(x, 15.5, 19.0) * smoothstep(48.0 - x, 0.0, 4.0)
    near_lid = corner * smoothstep(z, -4.0, 0.0) * (np.abs(ball) < 6.0)
    tuft = 0.75 + 0.25 * np.cos(4.5 * x + np.sin(1.3 * x + params.seed % 7))
    outer = 0.55 + 0.45 * smoothstep(x, 22.0, 40.0)
    upper_line = outer * np.exp(-0.5 * ((upper - 0.1) / 0.75) ** 2)
    lower_line = 0.40 * outer * tuft * np.exp(-0.5 * ((lower - 0.3) / 0.5) ** 2)
    lashes[own] = near_lid * np.maximum(upper_line, lower_line)
    margin = np.exp(-0.5 * ((lower + 0.25) / 0.5) ** 2) + 0.6 * np.exp(-0.5 * ((lower - 1.0) / 1.2) ** 2)
    inner = smoothstep(21.0 - x, 0.0, 3.0) * smoothstep(-np.abs(ball), -5.0, -3.0) * smoothstep(-opening, -1.0, 0.2)
    moist[own] = np.clip(np.maximum(near_lid * margin, inner), 0.0, 1.0)
    return EyeMasks(eye, lashes, moist)


def _iris_offset(x_mm: np.ndarray, params: HeadParams) -> tuple[np.ndarray, np.ndarray]:
    """Position relative to the iris' middle (mm along x, folded, and along y)."""
    eyeball = load_template().eyeball.numpy().astype(np.float64)
    radius = np.exp(eyeball[3:])
    folded = np.stack([np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]], -1)
    n = (folded - eyeball[:3]) / radius
    n /= np.linalg.norm(n, axis=1, keepdims=True) + 1e-9
    turn = np.radians(GAZE_DEGREES) * np.array([params.shape.gaze_left, params.shape.gaze_up])
    # the ellipsoid is flatter than an eyeball; what counts is how far the iris moves over it
    side = np.sign(x_mm[:, 0])
    return (n[:, 0] - side * np.sin(turn[0])) * radius[0], (n[:, 1] - np.sin(turn[1])) * radius[1]


def eye_ks(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Specular scale (N,): a wet sclera; the iris lies behind a cornea too smooth for the head's one roughness."""
    r = np.hypot(*_iris_offset(x_mm, params))
    return 0.60 + 0.65 * smoothstep(r, IRIS_MM - 0.5, IRIS_MM + 0.5)


def eye_colour(x_mm: np.ndarray, params: HeadParams) -> np.ndarray:
    """Diffuse albedo of eyeball and cornea (N, 3), linear Rec. 709."""
    a, b = _iris_offset(x_mm, params)
    r, angle = np.hypot(a, b), np.arctan2(b, a)
    centre = load_template().eyeball[:3].numpy()
    side = (np.abs(x_mm[:, 0]) - centre[0]) / 12.0
    # white, greyer and yellower with age; vessels run in from the corners
    old = np.clip(0.5 + 0.3 * params.shape.age, 0.0, 1.0)
    sclera = np.array([0.56, 0.52, 0.49]) * np.array([1.0, 1.0 - 0.03 * old, 1.0 - 0.10 * old])
    sclera = sclera * (1 - 0.22 * smoothstep(r, 7.0, 13.0))[:, None]
    vessel = np.abs(plane_noise(x_mm * [0.45, 1.3, 1.0], params.seed + 101, 14, 2.6))
    veins = smoothstep(0.28 - vessel, 0.0, 0.28) * smoothstep(np.abs(side), 0.45, 1.0) * 0.5
    sclera = sclera * (1 - np.clip(veins + 0.12 * np.abs(side) ** 2, 0, 0.7)[:, None] * [0.10, 0.45, 0.42])
    iris_colour = np.array(params.pigment.iris)
    fibres = 1.0 + 0.20 * np.sin(29 * angle + 2.5 * np.sin(4 * angle + params.seed % 11) + 0.6 * r)
    fibres = fibres + 0.12 * np.sin(53 * angle + 1.7 * r + params.seed % 5)
    collar = np.exp(-0.5 * ((r - 3.0) / 0.7) ** 2)
    iris = iris_colour * (fibres * (0.85 + 0.25 * smoothstep(-r, -5.4, -3.0)))[:, None]
    iris = iris * (1 + collar[:, None] * [0.35, 0.18, -0.05])
    iris = iris * (1 - 0.72 * smoothstep(r, 4.7, 5.7))[:, None]
    colour = sclera + (iris - sclera) * smoothstep(-r, -IRIS_MM - 0.35, -IRIS_MM + 0.35)[:, None]
    return colour + (0.004 - colour) * smoothstep(-r, -PUPIL_MM - 0.2, -PUPIL_MM + 0.2)[:, None]
