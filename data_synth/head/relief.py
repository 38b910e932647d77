"""Relief: smooth displacement along the surface normal, given that the landmarks stay.

Notation: ``s_i`` sites on the template with normals ``n_i`` (smoothed), ``l`` the landmarks. A vector-valued Gaussian
process with kernel ``K(r) I`` is conditioned on no displacement at the landmarks; along the normals its covariance is
``C_ij = (K_ij - K_il (K_ll + e)^-1 K_lj) n_i . n_j`` (Rasmussen and Williams 2006, equation 2.24). A region's window
``w`` (squares sum to 1 over the regions) and amplitude cut its share out; that is split into an even and an odd part
about x = 0, and the principal components of each are the region's coefficients (Gaussian process morphable models:
Luethi et al. 2018, DOI 10.1109/TPAMI.2017.2739743). Between sites bells interpolate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.head.bells import Bells, bell
from data_synth.head.population import load_population
from data_synth.head.relief_params import REGIONS, RELIEF_SIZE
from data_synth.head.surface import bald_surface, spread_points
from data_synth.one_thread import one_thread


@dataclass(frozen=True)
class ReliefConfig:
    """Lengths in millimetres.

    Attributes
    ----------
    face_spacing, rest_spacing : distance between sites on the face and elsewhere; bells are as wide
    long_scale, short_scale, short_share : the kernel's two lengths, and the short one's part of the variance
    noise : standard deviation of the relief at the landmarks as a part of that far from them
    odd_ratio : standard deviation of the odd part over the even part's: faces are nearly symmetric. With 0.35 random
        heads are more asymmetric than the model heads and less than the scan (``tools/measure_generator.py``).
    """

    face_spacing: float = 9.0
    rest_spacing: float = 18.0
    long_scale: float = 24.0
    short_scale: float = 10.0
    short_share: float = 0.35
    noise: float = 0.15
    odd_ratio: float = 0.35


@dataclass(frozen=True)
class ReliefBasis:
    """Sites (S, 3), bell widths (S,), normals (S, 3) and bell heights per coefficient (S, RELIEF_SIZE); mm."""

    sites_mm: np.ndarray
    width_mm: np.ndarray
    normal: np.ndarray
    heights_mm: np.ndarray


def _half_sites(config: ReliefConfig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sites of the left half (those within a third of the spacing of the midline on it), widths and normals."""
    surface = bald_surface()
    v, f = surface.vertices_m * 1e3, surface.faces
    corner = v[f]
    n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal = np.stack([np.bincount(f.ravel(), np.repeat(n[:, k], 3), len(v)) for k in range(3)], 1)
    candidates = np.flatnonzero((v[:, 0] >= 0) & (v[:, 1] > -185.0))[::3]
    x = v[candidates]
    on_face = 1.0 / (1.0 + np.exp((np.linalg.norm(x - (0.0, -25.0, 20.0), axis=1) - 88.0) / 8.0))
    density = 1.0 / config.rest_spacing + on_face * (1.0 / config.face_spacing - 1.0 / config.rest_spacing)
    # farthest points until all others are nearer than the spacing
    order = spread_points(x, density, 900)
    gap = np.array([np.min(np.linalg.norm(x[order[:k]] - x[order[k]], axis=1)) for k in range(1, len(order))])
    enough = 1 + int(np.argmax(gap * density[order[1:]] < 1.0))
    pick = candidates[order[:enough]]
    sites, width = v[pick].copy(), 1.0 / density[order[:enough]]
    sites[sites[:, 0] < width / 3, 0] = 0.0
    smooth = np.empty_like(sites)
    for i, (s, w) in enumerate(zip(sites, width, strict=True)):
        weight = bell(((v - s) ** 2).sum(1) / (0.6 * w) ** 2)
        mean = weight @ normal
        if s[0] == 0.0:
            mean[0] = 0.0
        smooth[i] = mean / np.linalg.norm(mean)
    return sites, width, smooth


def _kernel(config: ReliefConfig, a: np.ndarray, b: np.ndarray, scale: float) -> np.ndarray:
    r2 = ((a[:, None] - b[None]) ** 2).sum(-1) / scale**2
    long = np.exp(-0.5 * r2 / config.long_scale**2)
    return (1 - config.short_share) * long + config.short_share * np.exp(-0.5 * r2 / config.short_scale**2)


def windows(sites_mm: np.ndarray) -> np.ndarray:
    """Each region's window at the sites (S, regions): squares sum to 1."""
    folded = np.c_[np.abs(sites_mm[:, 0]), sites_mm[:, 1:]]
    part = np.stack([np.exp(-0.5 * (((folded - r.centre_mm) / r.width_mm) ** 2).sum(1)) for r in REGIONS], 1)
    return np.sqrt(part / (part.sum(1, keepdims=True) + 1e-12))


@lru_cache(maxsize=1)
@one_thread
def relief_basis(config: ReliefConfig = ReliefConfig()) -> ReliefBasis:
    """The basis that ships: computed once per process from the template (a second)."""
    half, width, normal = _half_sites(config)
    flip = np.array([-1.0, 1.0, 1.0])
    landmarks = load_population().mean_m * 1e3

    def conditioned(other: np.ndarray, scale: float) -> np.ndarray:
        inner = _kernel(config, landmarks, landmarks, scale) + config.noise**2 * np.eye(len(landmarks))
        cross = np.linalg.solve(inner, _kernel(config, landmarks, half * other, scale))
        return _kernel(config, half, half * other, scale) - _kernel(config, half, landmarks, scale) @ cross

    same = {r.scale: conditioned(np.ones(3), r.scale) * (normal @ normal.T) for r in REGIONS}
    mirrored = {r.scale: conditioned(flip, r.scale) * (normal @ (normal * flip).T) for r in REGIONS}
    # even and odd parts have variance (1 +- correlation) / 2; scaled so that their sum keeps the process's
    even_scale = np.sqrt(2.0 / (1.0 + config.odd_ratio**2))
    off = half[:, 0] > 0.0
    sites = np.concatenate([half, half[off] * flip])
    shares = windows(half)
    values = np.zeros((len(sites), RELIEF_SIZE))
    column = 0
    for region, window in zip(REGIONS, shares.T, strict=True):
        scale = region.amplitude_mm * window
        for sign, count in ((1.0, region.even), (-1.0, region.odd)):
            size = even_scale if sign > 0 else even_scale * config.odd_ratio
            covariance = 0.5 * (same[region.scale] + sign * mirrored[region.scale]) * np.outer(scale, scale) * size**2
            variance, mode = np.linalg.eigh(covariance)
            mode = mode[:, ::-1][:, :count] * np.sqrt(np.maximum(variance[::-1][:count], 0.0))
            # an eigenvector's sign is arbitrary: the largest displacement is outward
            mode = mode * np.sign(mode[np.abs(mode).argmax(0), np.arange(count)])
            values[:, column : column + count] = np.concatenate([mode, sign * mode[off]])
            column += count
    widths = np.concatenate([width, width[off]])
    normals = np.concatenate([normal, normal[off] * flip])
    r2 = ((sites[:, None] - sites[None]) ** 2).sum(-1) / widths[None] ** 2
    gram = bell(r2) * (normals @ normals.T)
    # a little ridge: sites of opposite normals, as on both sides of an ear, are nearly dependent
    heights = np.linalg.solve(gram.T @ gram + 1e-3 * np.eye(len(sites)), gram.T @ values)
    return ReliefBasis(sites, widths, normals, heights)


def relief_bells(relief: np.ndarray) -> Bells:
    """The displacement of relief coefficients (RELIEF_SIZE,) as bells."""
    basis = relief_basis()
    width = np.repeat(basis.width_mm[:, None], 3, 1)
    return Bells(basis.sites_mm, width, basis.normal * (basis.heights_mm @ relief)[:, None])
