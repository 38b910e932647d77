"""Identity: a smooth warp of space that carries the template's landmarks onto a person's, and named shape on top.

Notation: ``x`` template point (m), ``l`` landmark, ``u(x)`` displacement, ``x_head = x + u(x)``. The landmark part is
the posterior mean of a Gaussian process with kernel ``K(r) = a exp(-r^2/2A^2) + b exp(-r^2/2B^2)`` given the landmarks'
displacements with noise ``n`` (the regulariser): it follows the landmarks to a fraction of a millimetre and dies out
away from the face. Named parameters are Gaussian-windowed displacements in millimetres per sigma.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np

from data_synth.head.params import HeadParams
from data_synth.head.shape_params import NamedShape


@dataclass(frozen=True)
class Population:
    """Landmark statistics: mean and std (68, 3), principal std (30,) and directions (30, 68, 3); metres."""

    mean_m: np.ndarray
    std_m: np.ndarray
    principal_std_m: np.ndarray
    directions: np.ndarray


@dataclass(frozen=True)
class WarpConfig:
    """Widths (m) and shares of the two kernels, and the noise as a share of the prior's standard deviation."""

    wide_m: float = 0.075
    narrow_m: float = 0.024
    narrow_share: float = 0.35
    noise: float = 0.10


@dataclass(frozen=True)
class Warp:
    """A head's warp; see `warp_points`. ``weights``: (68, 3) kernel weights at ``sites``: (68, 3)."""

    sites: np.ndarray
    weights: np.ndarray
    config: WarpConfig
    shape: NamedShape


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


def identity_landmarks(identity: np.ndarray) -> np.ndarray:
    """Landmarks (68, 3) in metres of identity coefficients (30,) in sigma units."""
    p = load_population()
    return p.mean_m + np.einsum("k,kij->ij", identity * p.principal_std_m, p.directions)


def _kernel(config: WarpConfig, x: np.ndarray, sites: np.ndarray) -> np.ndarray:
    middle = sites.mean(0)
    x, sites = x - middle, sites - middle
    r2 = (x**2).sum(1)[:, None] + (sites**2).sum(1)[None] - 2.0 * (x @ sites.T)
    wide = np.exp(-0.5 * r2 / config.wide_m**2)
    narrow = np.exp(-0.5 * r2 / config.narrow_m**2)
    return (1 - config.narrow_share) * wide + config.narrow_share * narrow


def make_warp(params: HeadParams, template_landmarks_m: np.ndarray, config: WarpConfig | None = None) -> Warp:
    """The warp of one head. ``template_landmarks_m``: (68, 3), where the mean's landmarks lie on the template."""
    config = WarpConfig() if config is None else config
    move = identity_landmarks(params.identity) - load_population().mean_m
    gram = _kernel(config, template_landmarks_m, template_landmarks_m)
    weights = np.linalg.solve(gram + config.noise**2 * np.eye(len(gram)), move)
    return Warp(template_landmarks_m, weights, config, params.shape)


def _bump(x: np.ndarray, centre: tuple[float, float, float], width: tuple[float, float, float]) -> np.ndarray:
    return np.exp(-0.5 * (((x - centre) / width) ** 2).sum(-1))


def _step(x: np.ndarray, start: float, width: float) -> np.ndarray:
    """Smooth step from 0 below ``start - width`` to 1 above ``start + width``."""
    t = np.clip((x - (start - width)) / (2 * width), 0.0, 1.0)
    return t * t * t * (t * (6 * t - 15) + 10)


def named_displacement_mm(x_mm: np.ndarray, s: NamedShape) -> np.ndarray:
    """Displacement (N, 3) in millimetres of the named parameters at template points (N, 3) in millimetres."""
    u = np.zeros_like(x_mm)
    x, y, z = x_mm.T
    side = np.tanh(x / 8.0)
    folded = np.stack([np.abs(x), y, z], -1)

    def add(amount: float, window: np.ndarray, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0) -> None:
        if amount != 0.0:
            u[:, 0] += amount * dx * window * side
            u[:, 1] += amount * dy * window
            u[:, 2] += amount * dz * window

    # the cranium: scales about its middle, fading out above the brows
    above = _step(y, 40.0, 35.0) * _step(-z, -5.0, 40.0) + _step(-z, 75.0, 35.0) * _step(y, -25.0, 40.0)
    above = np.clip(above, 0.0, 1.0)
    u[:, 0] += 0.030 * s.cranium_width * above * x
    u[:, 2] += 0.035 * s.cranium_length * _step(-z, 60.0, 60.0) * _step(y, -40.0, 60.0) * (z + 60.0)
    add(s.occiput, _bump(x_mm, (0, 10, -165), (50, 45, 40)), dz=-3.0)
    u[:, 1] += 0.035 * s.forehead_height * _step(y, 55.0, 45.0) * (y - 10.0)
    add(s.forehead_slope, _bump(x_mm, (0, 75, 0), (60, 32, 45)), dz=-3.5)
    add(s.temple_hollow, _bump(folded, (64, 18, -25), (22, 22, 25)), dx=-1.8)
    add(s.brow_depth, _bump(x_mm, (0, 20, 18), (45, 12, 20)), dz=1.0)
    add(s.cheek_fullness, _bump(folded, (46, -52, -2), (20, 22, 24)), dx=2.0, dz=1.4)
    add(s.jaw_angle, _bump(folded, (58, -76, -38), (22, 24, 26)), dx=2.4, dy=-1.0)
    add(s.double_chin, _bump(x_mm, (0, -118, -15), (32, 16, 26)), dy=-3.0, dz=1.0)
    add(s.nose_wing_width, _bump(folded, (14, -40, 22), (6, 7, 9)), dx=0.7)
    add(s.eyelid, _bump(folded, (31, 6, 9), (10, 4.5, 8)), dy=0.4)
    # neck and shoulders
    neck = _step(-y, 115.0, 30.0)
    wide = 0.055 * s.neck_width * neck * (1 - _step(-y, 185.0, 40.0)) + 0.07 * s.shoulder_width * _step(-y, 195.0, 35.0)
    u[:, 0] += wide * x
    u[:, 2] += 0.05 * s.neck_depth * neck * (1 - _step(-y, 185.0, 40.0)) * (z + 75.0)
    u[:, 1] += 4.0 * s.shoulder_height * _step(-y, 165.0, 30.0) * _step(np.abs(x), 75.0, 45.0)
    # ears: scale about the root, and swing outward behind it
    ear = np.exp(-0.5 * (((folded - (84, -28, -82)) / (9, 26, 20)) ** 2).sum(-1))
    ear = np.clip(1.5 * ear, 0.0, 1.0)
    u[:, 1] += 0.055 * s.ear_size * ear * (y + 28.0)
    u[:, 2] += 0.055 * s.ear_size * ear * (z + 70.0)
    u[:, 0] += 1.6 * s.ear_protrusion * ear * side * _step(-z, 80.0, 18.0)
    # mild asymmetry: one side of the jaw and one brow lower than the other
    u[:, 0] += 0.8 * s.asymmetry_jaw * _bump(x_mm, (0, -95, 0), (60, 35, 40))
    u[:, 1] += 0.7 * s.asymmetry_brow * np.tanh(x / 25.0) * _bump(folded, (32, 15, 10), (26, 18, 25))
    u += _expression_mm(x_mm, folded, side, s)
    return u


def _expression_mm(x_mm: np.ndarray, folded: np.ndarray, side: np.ndarray, s: NamedShape) -> np.ndarray:
    u = np.zeros_like(x_mm)
    y, z = x_mm[:, 1], x_mm[:, 2]
    if s.smile:
        corner = s.smile * _bump(folded, (26, -70, 14), (9, 9, 14))
        cheek = s.smile * _bump(folded, (36, -42, 8), (15, 13, 18))
        u[:, 0] += side * (3.0 * corner + 0.8 * cheek)
        u[:, 1] += 2.5 * corner + 1.8 * cheek
        u[:, 2] += -1.8 * corner + 1.5 * cheek
    if s.mouth_open:
        # the jaw drops about the ears; the split is where the lips meet, and closes toward the corners
        between = _step(-(y + 70.0 - 0.02 * folded[:, 0]), -0.6, 2.6)
        width = np.exp(-((folded[:, 0] / 24.0) ** 4))
        front = _step(z, -10.0, 30.0)
        lips = between * width * _bump(x_mm, (0, -80, 18), (60, 20, 24))
        jaw = _step(-y, 84.0, 16.0) * (1 - _step(-y, 128.0, 26.0)) * front
        u[:, 1] += -3.2 * s.mouth_open * np.maximum(lips, jaw * np.exp(-((folded[:, 0] / 55.0) ** 4)))
    if s.brow_raise:
        u[:, 1] += 3.0 * s.brow_raise * _bump(folded, (28, 25, 10), (24, 11, 22))
    return u


def warp_points(warp: Warp, x_m: np.ndarray, chunk: int = 40_000) -> np.ndarray:
    """``x_head = x + u(x)``: (N, 3) metres -> (N, 3) metres, before normalisation to the canonical frame."""
    out = np.array(x_m, np.float64)
    for a in range(0, len(out), chunk):
        part = np.asarray(x_m[a : a + chunk], np.float64)
        moved = _kernel(warp.config, part, warp.sites) @ warp.weights
        out[a : a + chunk] += moved + 1e-3 * named_displacement_mm(part * 1e3, warp.shape)
    return out


def jacobian_determinant(warp: Warp, x_m: np.ndarray, step_m: float = 2e-4) -> np.ndarray:
    """det of d x_head / d x at points (N, 3), by central differences; positive where the warp keeps orientation."""
    columns = []
    for k in range(3):
        e = np.zeros(3)
        e[k] = step_m
        columns.append((warp_points(warp, x_m + e) - warp_points(warp, x_m - e)) / (2 * step_m))
    return np.linalg.det(np.stack(columns, -1))
