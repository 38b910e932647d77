"""What the closed forms of spherical gaussian light are measured against: quadrature in float64, slow and exact.

Notation: lambda sharpness, c = n . xi, s = sqrt(1 - c^2), E(lambda, c) = int exp(lambda (w . xi - 1)) max(n . w, 0) dw.
As (Laplacian + 2) max(n . w, 0) is a ring delta on n . w = 0, E solves the Legendre equation ((1 - c^2) E')' + 2 E =
2 pi e^{-lambda} I_0(lambda s), whence E(0) = 2 pi e^{-lambda} I_1(lambda) / lambda and
E'' = 2 pi e^{-lambda} I_2(lambda s) / s^2 (I_k modified Bessel functions): `docs/light.md`.
"""

import numpy as np

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
# E'' falls like exp(-lambda c^2 / 2): past this many widths it is below exp(-50).
_WIDTHS = 10.0


def irradiance_exact(cosine: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """E(lambda, c) by quadrature in one dimension; broadcasts; error below 1e-12 of E(1) for lambda 0 to 1e8."""
    from scipy.special import ive

    c, lam = np.broadcast_arrays(np.asarray(cosine, np.float64), np.asarray(sharpness, np.float64))
    lam = np.maximum(lam, 1e-300)
    end = np.minimum(np.abs(c), _WIDTHS / np.sqrt(lam))[..., None]
    t = 0.5 * end * (_NODES + 1.0)
    s = np.sqrt((1.0 - t) * (1.0 + t))
    z = lam[..., None] * s
    series = lam[..., None] ** 2 / 8.0 * (1.0 + z * z / 12.0) * np.exp(-z)  # near z = 0, to z^6
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(z < 1e-3, series, ive(2, z) / (s * s))
    curvature = 2.0 * np.pi * curvature * np.exp(-lam[..., None] * t * t / (1.0 + s))
    bend = (0.5 * end * _WEIGHTS * (np.abs(c)[..., None] - t) * curvature).sum(-1)
    edge = 2.0 * np.pi * np.where(lam < 1e-8, 0.5 * np.exp(-lam), ive(1, lam) / lam)
    return edge + odd_part(lam) * c + bend


def hemisphere_exact(cosine: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """H(lambda, c) = int over n . w > 0 of exp(lambda (w . xi - 1)) dw, as precise as `irradiance_exact`.

    Turning n by an angle adds a lune of light along the ring n . w = 0: H' = 2 pi e^{-lambda} I_1(lambda s) / s, and
    H(0) is half of the sphere's integral.
    """
    from scipy.special import ive

    c, lam = np.broadcast_arrays(np.asarray(cosine, np.float64), np.asarray(sharpness, np.float64))
    lam = np.maximum(lam, 1e-300)
    end = np.minimum(np.abs(c), _WIDTHS / np.sqrt(lam))[..., None]
    t = 0.5 * end * (_NODES + 1.0)
    s = np.sqrt((1.0 - t) * (1.0 + t))
    z = lam[..., None] * s
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(z < 1e-6, 0.5 * lam[..., None] * np.exp(-z), ive(1, z) / s)
    slope = 2.0 * np.pi * slope * np.exp(-lam[..., None] * t * t / (1.0 + s))
    half = np.where(lam < 1e-12, 2.0 * np.pi, -np.pi * np.expm1(-2.0 * lam) / lam)
    return half + np.sign(c) * (0.5 * end * _WEIGHTS * slope).sum(-1)


def odd_part(sharpness: np.ndarray) -> np.ndarray:
    """O = (E(c) - E(-c)) / 2 at c = 1: pi int_{-1}^{1} u exp(lambda (u - 1)) du."""
    x = 2.0 * np.asarray(sharpness, np.float64)[..., None]
    t = 0.5 * (_NODES + 1.0)
    small = (0.5 * _WEIGHTS * (1.0 - 2.0 * t) * np.exp(-x * t)).sum(-1)
    x = np.maximum(x[..., 0], 1e-3)
    return 2.0 * np.pi * np.where(x < 20.0, small, (1.0 + np.exp(-x) + 2.0 * np.expm1(-x) / x) / x)


def ggx_specular(
    n_dot_v: float,
    roughness: float,
    f0: float,
    axis: np.ndarray,
    sharpness: float,
    *,
    samples: int = 512,
) -> float:
    """Radiance that a GGX surface with normal +Z reflects of one unit-amplitude lobe; v lies in the x-z plane.

    D GGX with alpha = r^2, Smith's separable G, Schlick's Fresnel: the data set's `gt/brdf.json`. The integral is taken
    over the half vector, in coordinates where D is uniform, on `samples`^2 midpoints; 1e-4 of the value where the light
    lobe is wider than a cell of that grid (sharpness <= 1000 at r >= 0.2).
    """
    alpha2 = roughness**4
    u = (np.arange(samples) + 0.5) / samples
    cos_h = np.sqrt((1.0 - u) / (1.0 + (alpha2 - 1.0) * u))[:, None]
    sin_h = np.sqrt(1.0 - cos_h**2)
    phi = 2.0 * np.pi * u[None]
    h = np.stack(np.broadcast_arrays(sin_h * np.cos(phi), sin_h * np.sin(phi), cos_h), -1)
    v = np.array([np.sqrt(1.0 - n_dot_v**2), 0.0, n_dot_v])
    vh = h @ v
    light = 2.0 * vh[..., None] * h - v
    nl = light[..., 2]
    visible = (vh > 0) & (nl > 0)

    def smith(c):
        return 2.0 * c / (c + np.sqrt(alpha2 + (1.0 - alpha2) * c * c))

    nl = np.where(visible, nl, 1.0)
    fresnel = f0 + (1.0 - f0) * (1.0 - np.where(visible, vh, 1.0)) ** 5
    weight = fresnel * smith(nl) * smith(n_dot_v) * vh / (n_dot_v * cos_h)
    radiance = np.exp(-0.5 * sharpness * ((light - axis) ** 2).sum(-1))
    return float(np.where(visible, weight * radiance, 0.0).mean())
