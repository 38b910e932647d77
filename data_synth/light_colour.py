"""Colours of white light: incandescent by the Planckian locus, daylight by the CIE's, and what a camera makes of them.

Notation: T correlated colour temperature in kelvin; u, v CIE 1960; x, y CIE 1931; RGB linear Rec. 709, luminance 1.
A mired is 1e6 / T: equal steps of it look about alike.
"""

import numpy as np

from data_synth.render_source import LUMINANCE

# ITU-R BT.709-6: primaries red, green, blue and white, as x, y.
_PRIMARIES = np.array([[0.640, 0.330], [0.300, 0.600], [0.150, 0.060]])
_WHITE = np.array([0.3127, 0.3290])
PLANCKIAN_RANGE_K = (1700.0, 15000.0)
DAYLIGHT_RANGE_K = (4000.0, 25000.0)


def _xyz(xy: np.ndarray) -> np.ndarray:
    """XYZ of luminance 1."""
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([x / y, np.ones_like(y), (1.0 - x - y) / y], -1)


def _rgb_from_xyz() -> np.ndarray:
    primaries = _xyz(_PRIMARIES).T
    return np.linalg.inv(primaries * np.linalg.solve(primaries, _xyz(_WHITE)))


_RGB_FROM_XYZ = _rgb_from_xyz()


def _rgb(xy: np.ndarray) -> np.ndarray:
    """Linear RGB of luminance 1; what is out of gamut loses its negative part."""
    rgb = np.maximum(_xyz(xy) @ _RGB_FROM_XYZ.T, 0.0)
    return rgb / (rgb @ LUMINANCE)[..., None]


def planckian(temperature_k: float | np.ndarray) -> np.ndarray:
    """Colour (..., 3) of a black body, T in `PLANCKIAN_RANGE_K` (beyond, its ends): flames, lamps, most LEDs.

    Krystek 1985, DOI 10.1002/col.5080100109: rational fit in u, v, off by less than 1e-4 from 1000 to 15000 K. Blue is
    out of gamut, and so 0, below 1900 K.
    """
    t = np.clip(np.asarray(temperature_k, np.float64), *PLANCKIAN_RANGE_K)
    u = (0.860117757 + 1.54118254e-4 * t + 1.28641212e-7 * t**2) / (1 + 8.42420235e-4 * t + 7.08145163e-7 * t**2)
    v = (0.317398726 + 4.22806245e-5 * t + 4.20481691e-8 * t**2) / (1 - 2.89741816e-5 * t + 1.61456053e-7 * t**2)
    return _rgb(np.stack([3 * u, 2 * v], -1) / (2 * u - 8 * v + 4)[..., None])


def daylight(temperature_k: float | np.ndarray) -> np.ndarray:
    """Colour (..., 3) of a phase of daylight, T in `DAYLIGHT_RANGE_K` (beyond, its ends).

    The CIE's D series (CIE 015:2018); skies and sunlit scenes lie along it.
    """
    t = np.clip(np.asarray(temperature_k, np.float64), *DAYLIGHT_RANGE_K)
    warm = ((-4.6070e9 / t + 2.9678e6) / t + 0.09911e3) / t + 0.244063
    cool = ((-2.0064e9 / t + 1.9018e6) / t + 0.24748e3) / t + 0.237040
    x = np.where(t <= 7000.0, warm, cool)
    return _rgb(np.stack([x, -3.000 * x * x + 2.870 * x - 0.275], -1))


def balanced(colour: np.ndarray, white: np.ndarray, adaptation: float) -> np.ndarray:
    """Colours (..., 3) as a camera records them whose gains make `white` (3,) neutral, where `adaptation` is 1.

    Cameras' gains act on linear channels (von Kries), and automatic ones stop short of neutral: the gains are taken to
    the power `adaptation`, in [0, 1]. Luminances are kept relative to one another.
    """
    gains = np.maximum(white, 1e-2) ** -adaptation
    return colour * (gains / (np.maximum(white, 1e-2) ** (1 - adaptation) @ LUMINANCE))
