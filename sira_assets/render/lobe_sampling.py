"""Directions drawn exactly as a lobe's light arrives at a surface: density ~ G(w) max(n . w, 0).

Notation: G(w) = exp(lambda (w . xi - 1)); theta and theta_0 the elevations of w and of xi above the surface's horizon;
phi the azimuth of w about n, from xi's. As w . xi = sin theta sin theta_0 + cos theta cos theta_0 cos phi,

    p(theta) ~ sin theta cos theta e^{lambda (cos(theta - theta_0) - 1)} e^{-kappa} I_0(kappa)
    p(phi | theta) ~ e^{kappa cos phi}, kappa = lambda cos theta cos theta_0     (a von Mises distribution)

Both are tabulated by their quantiles at q = Phi(z), Phi the normal distribution function: in z they are nearly straight
lines, tails included. So rays need no weights, and a lobe beneath the horizon is sampled as well as one above it.
"""

import functools
from dataclasses import dataclass

import numpy as np

# Quantiles are kept at these z; beyond them lies 1e-6 of the light.
Z_NODES = np.linspace(-4.8, 4.8, 49)
GOLDEN = 0.5 * (1.0 + 5.0**0.5)
# Directions tabulated for each elevation of the axis: 32 patterns of 64 rays.
TABLED = 2048


@dataclass(frozen=True)
class LobeRays:
    """Ray directions of one lobe, relative to normal and axis, for some elevations of the axis and some patterns.

    Parameters
    ----------
    elevation_0 : (R,) theta_0, ascending from -pi/2 to pi/2, closest where the directions change fastest
    width : of the lobe, radians
    elevation : (R, P, K) float32, theta less `_centre(theta_0, width)`
    azimuth : (R, P, K) float32, phi
    """

    elevation_0: np.ndarray
    width: float
    elevation: np.ndarray
    azimuth: np.ndarray

    def directions(self, normals: np.ndarray, axis: np.ndarray, pattern: np.ndarray) -> np.ndarray:
        """(N, K, 3) float32 unit directions at N normals, each by its own pattern, all in the hemisphere of the normal.

        Parameters
        ----------
        normals : (N, 3) unit
        axis : (3,) unit
        pattern : (N,) int, below P
        """
        normals = np.asarray(normals, np.float64)
        cosine = normals @ axis
        tangent = axis - cosine[:, None] * normals
        length = np.linalg.norm(tangent, axis=1)
        theta_0 = np.arctan2(cosine, length)
        # Where the axis stands on the normal any tangent will do.
        other = np.where(np.abs(normals[:, :1]) > 0.7, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
        other = np.cross(normals, other)
        tangent = np.where((length > 1e-9)[:, None], tangent, other)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        row = np.interp(theta_0, self.elevation_0, np.arange(len(self.elevation_0)))
        low = np.minimum(row.astype(np.int64), len(self.elevation_0) - 2)
        share = (row - low)[:, None].astype(np.float32)
        theta, phi = (
            (1 - share) * table[low, pattern] + share * table[low + 1, pattern]
            for table in (self.elevation, self.azimuth)
        )
        # Interpolation must not send a ray beneath the horizon.
        theta = np.maximum(theta + _centre(theta_0, self.width)[:, None].astype(np.float32), np.float32(1e-6))
        flat, up = np.cos(theta), np.sin(theta)
        n, t, b = (a.astype(np.float32)[:, None] for a in (normals, tangent, np.cross(normals, tangent)))
        return up[..., None] * n + (flat * np.cos(phi))[..., None] * t + (flat * np.sin(phi))[..., None] * b


def lobe_rays(sharpness: float, rays: int, *, seed: int = 0) -> LobeRays:
    """Tabulate the directions of one lobe.

    Parameters
    ----------
    sharpness : lambda, 0 to 1e8
    rays : K, at least 1; every pattern is the same even set, shifted on the torus at random, and there are
        as many as leave the tables small

    Returns
    -------
    LobeRays
    """
    width = 1.0 / np.sqrt(1.0 + sharpness)
    theta_0 = _axis_elevations(width)
    quantiles = np.stack([_elevation_quantiles(float(t), sharpness) for t in theta_0])  # (R, Z)
    z_elevation, z_azimuth = _patterns(rays, max(1, TABLED // rays), seed)
    column = (z_elevation - Z_NODES[0]) / (Z_NODES[1] - Z_NODES[0])
    low = np.minimum(column.astype(np.int64), len(Z_NODES) - 2)
    share = column - low
    theta = (1 - share) * quantiles[:, low] + share * quantiles[:, low + 1]  # (R, P, K)
    kappa = sharpness * np.cos(theta) * np.cos(theta_0)[:, None, None]
    azimuth = _von_mises_quantile(kappa, z_azimuth)
    theta = theta - _centre(theta_0, width)[:, None, None]
    return LobeRays(theta_0, width, theta.astype(np.float32), azimuth.astype(np.float32))


def _centre(theta_0: np.ndarray, width: float) -> np.ndarray:
    """About where the light comes from: theta_0 above the horizon, 0 beneath it, without a kink between."""
    return 0.5 * (theta_0 + np.sqrt(theta_0 * theta_0 + width * width))


def _axis_elevations(width: float, count: int = 160) -> np.ndarray:
    """Elevations of the axis, dense within the lobe's width of the horizon and of the normal."""
    near = np.geomspace(1e-2 * width, np.pi / 2, 400)
    fine = np.unique(np.concatenate([[0.0], near, -near, np.pi / 2 - near, [np.pi / 2, -np.pi / 2]]))
    fine = fine[np.abs(fine) <= np.pi / 2]
    middle = 0.5 * (fine[1:] + fine[:-1])
    density = 0.3 + 1.0 / (np.abs(middle) + width) + 1.0 / (np.pi / 2 - middle + width)
    nodes = np.concatenate([[0.0], np.cumsum(density * np.diff(fine))])
    return np.interp(np.linspace(0.0, nodes[-1], count), nodes, fine)


def _elevation_quantiles(theta_0: float, sharpness: float) -> np.ndarray:
    """theta at q = Phi(Z_NODES), by the trapezoid rule in steps that grow by 4 per cent away from the centre."""
    from scipy.special import i0e, ndtr

    centre = max(theta_0, 0.0)
    # The lobe's own width, and the width of what remains of it above the horizon when its axis is beneath.
    finest = 1e-3 / (1.0 + np.sqrt(sharpness) + sharpness * max(-np.sin(theta_0), 0.0))
    steps = np.concatenate([[0.0], np.geomspace(finest, np.pi / 2, max(64, int(np.log(2.0 / finest) / 0.04)))])
    theta = np.unique(np.clip(np.concatenate([centre - steps, centre + steps]), 0.0, np.pi / 2))
    half = 0.5 * (theta - theta_0)
    exponent = -2.0 * sharpness * np.sin(half) ** 2
    kappa = sharpness * np.cos(theta) * np.cos(theta_0)
    density = np.sin(theta) * np.cos(theta) * i0e(kappa) * np.exp(exponent - exponent.max())
    area = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(theta))])
    return np.interp(ndtr(Z_NODES), area / area[-1], theta)


@functools.cache
def _azimuth_table() -> tuple[np.ndarray, np.ndarray]:
    """log(1 + kappa) (Q,) and the von Mises quantiles times sqrt(1 + kappa) (Q, Z)."""
    from scipy.special import ndtr

    levels = np.linspace(0.0, np.log(1e9), 200)
    rows = []
    for kappa in np.expm1(levels):
        steps = np.geomspace(1e-4 / np.sqrt(1.0 + kappa), np.pi, 600)
        phi = np.concatenate([-steps[::-1], [0.0], steps])
        density = np.exp(-2.0 * kappa * np.sin(0.5 * phi) ** 2)
        area = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(phi))])
        rows.append(np.interp(ndtr(Z_NODES), area / area[-1], phi) * np.sqrt(1.0 + kappa))
    return levels, np.stack(rows)


def _von_mises_quantile(kappa: np.ndarray, z: np.ndarray) -> np.ndarray:
    """phi at q = Phi(z), by bilinear interpolation in log(1 + kappa) and z."""
    levels, table = _azimuth_table()
    row = np.log1p(kappa) / (levels[1] - levels[0])
    low = np.minimum(row.astype(np.int64), len(levels) - 2)
    a = row - low
    column = (z - Z_NODES[0]) / (Z_NODES[1] - Z_NODES[0])
    left = np.broadcast_to(np.minimum(column.astype(np.int64), len(Z_NODES) - 2), low.shape)
    b = column - left
    upper = (1 - b) * table[low, left] + b * table[low, left + 1]
    lower = (1 - b) * table[low + 1, left] + b * table[low + 1, left + 1]
    return ((1 - a) * upper + a * lower) / np.sqrt(1.0 + kappa)


def _patterns(rays: int, patterns: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """z of both coordinates, (P, K) each."""
    from scipy.special import ndtri

    shift = np.random.default_rng(seed).random((patterns, 1, 2))
    # Fibonacci's lattice: of the sets tried here (the plastic number's, Sobol's scrambled) the least error at an edge.
    index = np.arange(rays)
    points = np.stack([(index + 0.5) / rays, index / GOLDEN], -1)
    z = np.clip(ndtri((points + shift) % 1.0), Z_NODES[0], Z_NODES[-1])
    return z[..., 0], z[..., 1]
