"""How each map becomes 8-bit texels, and back: docs/formats.md in code.

Notation: c an 8-bit code in 0..255; a linear diffuse albedo; s specular albedo (F0) with s = 0.04 ks; n a unit normal
in the tangent frame (x along +u, y along +v, z outward). Codes are rounded to the nearest, never truncated: truncation
would darken every map by half a step.
"""

import numpy as np

from sira_assets.numerics.colour import linear_from_srgb, srgb_from_linear

# F0 of an index of refraction of 1.5, ((1.5 - 1) / (1.5 + 1))^2: what glTF, and ks = 1, stand for.
F0_OF_IOR_1_5 = 0.04

# specular.png holds ks up to this value: F0 = 0.08 c / 255, the `specular` of Burley's BRDF (2012) and of Blender.
KS_RANGE = 2.0


def quantised(x: np.ndarray) -> np.ndarray:
    """uint8 codes of values in [0, 1] (clipped), rounded to the nearest."""
    return np.rint(np.clip(np.asarray(x, np.float64), 0.0, 1.0) * 255.0).astype(np.uint8)


def encode_srgb(x: np.ndarray) -> np.ndarray:
    """sRGB codes (uint8) of linear values in [0, 1], any shape; values outside are clipped."""
    return quantised(srgb_from_linear(np.clip(np.asarray(x, np.float64), 0.0, 1.0)))


def decode_srgb(codes: np.ndarray) -> np.ndarray:
    """Linear float64 values of sRGB codes."""
    return linear_from_srgb(np.asarray(codes, np.float64) / 255.0)


def encode_ks(specular_f0: np.ndarray) -> np.ndarray:
    """Codes of specular.png: ks = s / 0.04 on a linear scale, 0..2; larger values are clipped.

    Parameters
    ----------
    specular_f0 : (...) F0 >= 0
    """
    return quantised(np.asarray(specular_f0, np.float64) / (F0_OF_IOR_1_5 * KS_RANGE))


def decode_ks(codes: np.ndarray) -> np.ndarray:
    """F0 (float64) of specular.png's codes."""
    return np.asarray(codes, np.float64) / 255.0 * (F0_OF_IOR_1_5 * KS_RANGE)


def encode_normal(normal_tangent: np.ndarray) -> np.ndarray:
    """Codes (..., 3) uint8 of tangent-space normals, (n + 1) / 2, +Y up (glTF 2.0 section 3.9.3).

    The file holds z >= 0 only; a normal that leans below the surface is laid flat and renormalised, one of no length
    becomes (0, 0, 1). After decoding and renormalising, directions are within 0.4 degrees.
    """
    n = np.array(normal_tangent, np.float64)
    n[..., 2] = np.maximum(n[..., 2], 0.0)
    length = np.linalg.norm(n, axis=-1, keepdims=True)
    n = np.where(length > 1e-6, n / np.maximum(length, 1e-6), np.array([0.0, 0.0, 1.0]))
    return quantised(0.5 * n + 0.5)


def decode_normal(codes: np.ndarray) -> np.ndarray:
    """Unit normals (..., 3) float64 of a normal map's codes."""
    n = np.asarray(codes, np.float64) / 127.5 - 1.0
    return n / np.linalg.norm(n, axis=-1, keepdims=True)
