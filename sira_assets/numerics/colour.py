"""Linear Rec. 709 light and its sRGB encoding.

Notation: x linear, relative to display white; v = OETF(x) the encoded value in [0, 1]. The two-piece curve is that of
IEC 61966-2-1: v = 12.92 x up to x = 0.0031308, then 1.055 x^(1/2.4) - 0.055; the pieces meet to 3e-8 in v.
"""

import numpy as np

# IEC 61966-2-1:1999, equations (5) to (8).
LINEAR_TOE = 0.0031308
ENCODED_TOE = 0.04045

# Rec. ITU-R BT.709-6, section 3.2: the weights of luminance for these primaries and the white point D65.
LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)


def _floating(x: np.ndarray) -> np.ndarray:
    x = np.asarray(x)
    return x if x.dtype in (np.float32, np.float64) else x.astype(np.float64)


def srgb_from_linear(x: np.ndarray) -> np.ndarray:
    """Encode linear values for a display.

    Parameters
    ----------
    x : array of any shape; clipped to [0, 1], since the encoding ends there. NaN stays NaN.

    Returns
    -------
    Array of x's shape in [0, 1]; float32 and float64 are kept, all else becomes float64.
    """
    x = np.clip(_floating(x), 0.0, 1.0)
    # The power sees no value below the toe: its slope is infinite at 0.
    return np.where(x <= LINEAR_TOE, 12.92 * x, 1.055 * np.maximum(x, LINEAR_TOE) ** (1.0 / 2.4) - 0.055)


def linear_from_srgb(v: np.ndarray) -> np.ndarray:
    """Decode sRGB values: the inverse of `srgb_from_linear` on [0, 1].

    Parameters
    ----------
    v : array of any shape, nominally in [0, 1]. Values outside follow the curve's own pieces; NaN stays NaN.
        Integers are taken as they are: divide 8-bit values by 255 first.

    Returns
    -------
    Array of v's shape; float32 and float64 are kept, all else becomes float64.
    """
    v = _floating(v)
    return np.where(v <= ENCODED_TOE, v / 12.92, ((np.maximum(v, ENCODED_TOE) + 0.055) / 1.055) ** 2.4)


def luminance(rgb: np.ndarray) -> np.ndarray:
    """Relative luminance (...) of linear Rec. 709 values (..., 3)."""
    rgb = _floating(rgb)
    return rgb @ np.array(LUMINANCE_WEIGHTS, rgb.dtype)
