"""Irradiance of one spherical gaussian by quadrature, tabulated over the angle to the surface normal.

Notation: xi the lobe's axis, lambda its sharpness, c = n . xi the cosine of the angle between surface normal and axis;
E(c) = integral over directions w of exp(lambda (w . xi - 1)) max(0, n . w), the irradiance of a lobe of unit amplitude.
"""

from functools import lru_cache

import numpy as np

# Cosine tables are uniform in the angle, not the cosine, since E bends most where c is near -1 and +1.
TABLE_SIZE = 1024
QUADRATURE_NODES = 400


@lru_cache(maxsize=256)
def irradiance_table(sharpness: float) -> np.ndarray:
    """E at `TABLE_SIZE` angles from 0 (c = 1) to pi (c = -1), float64.

    The azimuth about the axis is integrated in closed form: with A = c cos(theta) and B = sqrt(1 - c^2) sin(theta),
    the integral of max(0, A + B cos(phi)) over phi is 2 (A phi0 + B sin(phi0)), phi0 = arccos(clip(-A / B, -1, 1)).
    The polar angle is integrated by Gauss-Legendre nodes in t = 1 - cos(theta) over [0, min(2, 40 / lambda)]:
    beyond that the lobe is below e^-40. Absolute error below 1e-5 of the head-on value for lambda in [1e-6, 1e6].

    Parameters
    ----------
    sharpness : lambda > 0
    """
    angle = np.linspace(0.0, np.pi, TABLE_SIZE)[:, None]
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE_NODES)
    reach = min(2.0, 40.0 / sharpness)
    # t = reach u^2 gathers nodes at the axis, where both the gaussian and sin(theta) = sqrt(t (2 - t)) change fastest.
    u = 0.5 * (nodes + 1.0)
    t = reach * u**2
    weight = weights * 0.5 * reach * 2.0 * u * np.exp(-sharpness * t)
    a = np.cos(angle) * (1.0 - t)
    b = np.abs(np.sin(angle)) * np.sqrt(t * (2.0 - t))
    phi0 = np.arccos(np.clip(-a / np.maximum(b, 1e-300), -1.0, 1.0))
    table = (2.0 * (a * phi0 + b * np.sin(phi0))) @ weight
    table.setflags(write=False)
    return table


def irradiance_per_lobe(normals: np.ndarray, axis: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """E of every lobe at every normal, by linear interpolation in the table.

    Parameters
    ----------
    normals : (N, 3) unit
    axis : (M, 3) unit
    sharpness : (M,) > 0

    Returns
    -------
    (N, M) float64, for unit amplitudes
    """
    # The half chord |n - xi| / 2 is the sine of half the angle: exact near 0, where arccos of a dot product is not.
    out = np.empty((len(normals), len(axis)))
    for k, (xi, lam) in enumerate(zip(axis, sharpness, strict=True)):
        chord, antichord = np.linalg.norm(normals - xi, axis=1), np.linalg.norm(normals + xi, axis=1)
        place = 2.0 * np.arctan2(chord, antichord) * ((TABLE_SIZE - 1) / np.pi)
        low = np.minimum(place.astype(np.int64), TABLE_SIZE - 2)
        table = irradiance_table(float(lam))
        out[:, k] = table[low] + (place - low) * (table[low + 1] - table[low])
    return out
