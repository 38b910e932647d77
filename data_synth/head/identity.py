"""Identity: a smooth warp of space that carries the template onto a person.

Notation: ``x`` template point (m), ``e`` the expression's displacement, ``x' = x + e(x)``,
``x_head = x' + b(x') + K(x', L) W``. ``b`` is what named parameters and relief do near the surface, in bells and
scalings; the last term is the posterior mean of a Gaussian process given the landmarks ``L``, with kernel
``K(r) = a exp(-r^2/2A^2) + b exp(-r^2/2B^2)`` and noise ``n``: its weights ``W`` are such that, with ``b`` included,
the landmarks come where the landmark coefficients say.

Those coefficients are ``c = S z + G q``: ``z`` the identity, ``q`` the named parameters and traits, ``G`` what these do
to the landmarks, as far as the population's principal directions have it, and ``S = (I - G G')^(1/2)``. So ``c`` has
unit covariance: a random population has the landmark statistics of people, whatever the named parameters do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.head.bells import Bells, join, sum_bells
from data_synth.head.expression import expression_mm
from data_synth.head.named import AMOUNTS, NAMES, named_displacement_mm, scaled_displacement_mm, weighted_bells
from data_synth.head.params import HeadParams
from data_synth.head.population import IDENTITY_SIZE, coefficients, load_population
from data_synth.head.relief import relief_bells
from data_synth.head.shape_params import SIGMA_NAMES, NamedShape, sigma_values, trait_values
from data_synth.head.traits import effective_values, trait_coefficients, trait_loadings
from data_synth.one_thread import one_thread

# Largest part of the variance of any landmark direction that named parameters and traits may carry; the rest is left
# to the identity, which then still reaches every direction.
NAMED_SHARE = 0.6


@dataclass(frozen=True)
class WarpConfig:
    """Widths (m) and shares of the two kernels, and the noise as a share of the prior's standard deviation.

    The narrow kernel is as wide as landmarks are apart: of 0.010 to 0.028 the narrowest that stays smooth leaves the
    least surface error between the landmarks of the real heads (0.60 against 0.84 mm at 0.028).
    """

    wide_m: float = 0.075
    narrow_m: float = 0.014
    narrow_share: float = 0.15
    noise: float = 0.03


@dataclass(frozen=True)
class Warp:
    """A head's warp; see `warp_points`.

    Attributes
    ----------
    sites, weights : (68, 3) and (68, 3)
        Where the template's landmarks are (m), and their kernel weights.
    bells : Bells
        Named parameters and relief.
    values : (len(NAMES),)
        Effective named values.
    shape : NamedShape
        The expression.
    """

    sites: np.ndarray
    weights: np.ndarray
    config: WarpConfig
    bells: Bells
    values: np.ndarray
    shape: NamedShape


def identity_landmarks(coefficient: np.ndarray) -> np.ndarray:
    """Landmarks (68, 3) in metres of landmark coefficients (30,) in sigma units."""
    p = load_population()
    return p.mean_m + np.einsum("k,kij->ij", coefficient, p.modes_m)


def own_values(shape: NamedShape) -> np.ndarray:
    """Values (len(NAMES),) of a shape before its traits act."""
    return np.r_[sigma_values(shape), [getattr(shape, name) for name in AMOUNTS]]


@lru_cache(maxsize=1)
@one_thread
def landmark_maps() -> tuple[np.ndarray, np.ndarray]:
    """``S`` (30, 30) and ``G`` (30, parameters + traits), see above."""
    at = load_population().mean_m * 1e3
    raw = np.zeros((IDENTITY_SIZE, len(SIGMA_NAMES)))
    for k in range(len(SIGMA_NAMES)):
        raw[:, k] = coefficients(1e-3 * named_displacement_mm(at, np.eye(len(NAMES))[k]))
    m = trait_loadings()[: len(SIGMA_NAMES)]
    g = np.c_[raw * np.sqrt(1.0 - (m**2).sum(1)), raw @ m + trait_coefficients()]
    u, size, vt = np.linalg.svd(g, full_matrices=False)
    size = np.minimum(size, np.sqrt(NAMED_SHARE))
    return (u * np.sqrt(1.0 - size**2)) @ u.T, (u * size) @ vt


def landmark_coefficients(params: HeadParams) -> np.ndarray:
    """``c`` (30,): the coefficients of a head's landmarks, expression aside."""
    s, g = landmark_maps()
    return s @ params.identity + g @ np.r_[sigma_values(params.shape), trait_values(params.shape)]


def _kernel(config: WarpConfig, x: np.ndarray, sites: np.ndarray) -> np.ndarray:
    middle = sites.mean(0)
    x, sites = x - middle, sites - middle
    r2 = (x**2).sum(1)[:, None] + (sites**2).sum(1)[None] - 2.0 * (x @ sites.T)
    wide = np.exp(-0.5 * r2 / config.wide_m**2)
    narrow = np.exp(-0.5 * r2 / config.narrow_m**2)
    return (1 - config.narrow_share) * wide + config.narrow_share * narrow


def _bells(params: HeadParams, values: np.ndarray) -> Bells:
    named = weighted_bells(values)
    # without relief its basis, and so the template's mesh, is not needed
    return join([named, relief_bells(params.relief)]) if params.relief.any() else named


def landmark_weights(landmarks_m: np.ndarray, move: np.ndarray, config: WarpConfig) -> np.ndarray:
    """``W``: kernel weights (68, C) of displacements (68, C) of the landmarks."""
    gram = _kernel(config, landmarks_m, landmarks_m)
    return np.linalg.solve(gram + config.noise**2 * np.eye(len(gram)), move)


def landmark_field(landmarks_m: np.ndarray, x_m: np.ndarray, move: np.ndarray) -> np.ndarray:
    """The posterior mean at points (N, 3) given displacements (68, C) of the landmarks: (N, C)."""
    config = WarpConfig()
    return _kernel(config, x_m, landmarks_m) @ landmark_weights(landmarks_m, move, config)


def make_warp(params: HeadParams, template_landmarks_m: np.ndarray, config: WarpConfig | None = None) -> Warp:
    """The warp of one head. ``template_landmarks_m``: (68, 3), where the mean's landmarks lie on the template."""
    config = WarpConfig() if config is None else config
    values = effective_values(own_values(params.shape), trait_values(params.shape))
    bells = _bells(params, values)
    at_mm = template_landmarks_m * 1e3
    already = 1e-3 * (scaled_displacement_mm(at_mm, values) + sum_bells(bells, at_mm))
    move = identity_landmarks(landmark_coefficients(params)) - load_population().mean_m
    weights = landmark_weights(template_landmarks_m, move - already, config)
    return Warp(template_landmarks_m, weights, config, bells, values, params.shape)


def warp_points(warp: Warp, x_m: np.ndarray, chunk: int = 40_000) -> np.ndarray:
    """(N, 3) template points in metres -> (N, 3) metres, before normalisation to the canonical frame."""
    out = np.array(x_m, np.float64)
    for a in range(0, len(out), chunk):
        part = np.asarray(x_m[a : a + chunk], np.float64)
        part = part + 1e-3 * expression_mm(part * 1e3, warp.shape)
        mm = part * 1e3
        near = scaled_displacement_mm(mm, warp.values) + sum_bells(warp.bells, mm)
        out[a : a + chunk] = part + 1e-3 * near + _kernel(warp.config, part, warp.sites) @ warp.weights
    return out


def jacobian_determinant(warp: Warp, x_m: np.ndarray, step_m: float = 2e-4) -> np.ndarray:
    """det of d x_head / d x at points (N, 3), by central differences; positive where the warp keeps orientation."""
    columns = []
    for k in range(3):
        e = np.zeros(3)
        e[k] = step_m
        columns.append((warp_points(warp, x_m + e) - warp_points(warp, x_m - e)) / (2 * step_m))
    return np.linalg.det(np.stack(columns, -1))
