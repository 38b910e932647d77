"""Spherical harmonics (SH) of an environment map.

Notation: real SH Y_lm(x, y, z), orthonormal over the sphere, z their polar axis, no Condon-Shortley phase, in the order
(l, m) with m = -l..l: Y_00 = 0.282095, Y_1,-1 = 0.488603 y, Y_10 = 0.488603 z, Y_11 = 0.488603 x, ... A map's
coefficients are c_lm = int L Y_lm dw, so that L is about sum c_lm Y_lm; x, y, z are the world's axes.
"""

import math

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.envmap import EnvironmentMap

# Far more than a light probe holds; the recurrence below was checked to here.
MAX_BANDS = 64


def _check_bands(bands: int) -> None:
    if not 1 <= bands <= MAX_BANDS:
        raise InputError(expected=f"1 to {MAX_BANDS} bands", received=f"{bands}", remedy="use 3")


def _legendre(z: np.ndarray, bands: int) -> dict[tuple[int, int], np.ndarray]:
    """sqrt(2 - [m = 0]) N_lm P_lm(z) / (1 - z^2)^{m/2} for 0 <= m <= l < bands, all normalised.

    The recurrence in l of fully normalised associated Legendre functions (Holmes and Featherstone 2002,
    doi:10.1007/s00190-002-0216-2, eq. 11 and 13), without the sine, which the azimuthal polynomials carry.
    """
    out = {(0, 0): np.full_like(z, 1.0 / math.sqrt(4.0 * math.pi))}
    for m in range(bands):
        if m > 0:
            gain = math.sqrt((2 * m + 1) / (2 * m)) * (math.sqrt(2.0) if m == 1 else 1.0)
            out[m, m] = gain * out[m - 1, m - 1]
        for n in range(m + 1, bands):
            a = math.sqrt((4.0 * n * n - 1.0) / (n * n - m * m))
            out[n, m] = a * z * out[n - 1, m]
            if n > m + 1:
                b = math.sqrt((2 * n + 1) * ((n - 1) ** 2 - m * m) / ((2 * n - 3) * (n * n - m * m)))
                out[n, m] -= b * out[n - 2, m]
    return out


def sh_basis(directions: np.ndarray, bands: int = 3) -> np.ndarray:
    """Y_lm (..., bands^2) float64 in unit directions (..., 3), as polynomials in x, y, z: no angle, no pole.

    Raises
    ------
    InputError : bands outside 1 to 64.
    """
    _check_bands(bands)
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    legendre = _legendre(z, bands)
    out = np.empty((*x.shape, bands * bands))
    cosine, sine = np.ones_like(x), np.zeros_like(x)  # Re and Im of (x + i y)^m = sin^m(theta) e^{i m phi}
    for m in range(bands):
        if m > 0:
            cosine, sine = x * cosine - y * sine, x * sine + y * cosine
        for n in range(m, bands):
            out[..., n * n + n + m] = legendre[n, m] * cosine
            if m > 0:
                out[..., n * n + n - m] = legendre[n, m] * sine
    return out


def _world_from_map(bands: int) -> np.ndarray:
    """(bands^2, bands^2): coefficients about +Y, in the map's own angles, to the convention above.

    The product of the two bases is a polynomial of degree 2 bands - 2, which this grid integrates exactly.
    """
    nodes, weights = np.polynomial.legendre.leggauss(bands)
    phi = 2.0 * np.pi * np.arange(2 * bands) / (2 * bands)
    sine = np.sqrt(1.0 - nodes**2)[:, None]
    y = np.broadcast_to(nodes[:, None], (bands, 2 * bands))
    world = np.stack([sine * np.sin(phi), y, -sine * np.cos(phi)], -1)
    own = np.stack([sine * np.cos(phi), sine * np.sin(phi), y], -1)
    weighted = sh_basis(world, bands) * (weights * np.pi / bands)[:, None, None]
    return weighted.reshape(-1, bands**2).T @ sh_basis(own, bands).reshape(-1, bands**2)


def envmap_sh(envmap: EnvironmentMap, bands: int = 3) -> np.ndarray:
    """SH coefficients (bands^2, 3) float64 of the radiance, l below `bands`.

    Each pixel's integral of Y_lm is exact, for the map is separable about +Y; the result is then turned to the
    convention's polar axis. A map constant within its pixels is integrated to rounding at any size.

    Raises
    ------
    InputError : bands outside 1 to 64.
    """
    _check_bands(bands)
    radiance = envmap.radiance
    height, width = radiance.shape[:2]
    order = np.arange(bands)
    edges = 2.0 * np.pi * np.arange(width + 1)[:, None] / width
    # int cos(m phi) and int sin(m phi) over each column.
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.where(order > 0, np.diff(np.sin(order * edges), axis=0) / order, 2.0 * np.pi / width)
        sine = np.where(order > 0, np.diff(-np.cos(order * edges), axis=0) / order, 0.0)
    # int Nbar_lm P_lm(cos theta) sin(theta) dtheta over each row, by nodes enough for l + 1 waves in one row of pi.
    nodes, weights = np.polynomial.legendre.leggauss(24 + bands // height)
    theta = np.pi / height * (np.arange(height)[:, None] + 0.5 * (nodes + 1.0))
    legendre = _legendre(np.cos(theta), bands)
    row_weight = weights * (0.5 * np.pi / height)
    own = np.empty((bands * bands, 3))
    for m in range(bands):
        even = np.einsum("hwc,w->hc", radiance, cosine[:, m])
        odd = np.einsum("hwc,w->hc", radiance, sine[:, m])
        polar = np.sin(theta) ** (m + 1) * row_weight
        for n in range(m, bands):
            rows = (legendre[n, m] * polar).sum(-1)
            own[n * n + n + m] = rows @ even
            if m > 0:
                own[n * n + n - m] = rows @ odd
    return _world_from_map(bands) @ own
