"""Vertex data as small integers, as KHR_mesh_quantization allows them.

Notation: c an integer code. An unsigned 16-bit code stands for c / 65535, a signed one of b bits for
max(c / (2^(b-1) - 1), -1) (glTF 2.0, section 3.6.2.2). Codes are rounded to the nearest.
"""

from dataclasses import dataclass

import numpy as np

STEPS = 65535


@dataclass(frozen=True)
class QuantisedPositions:
    """Positions as codes in a cube: x = translation + scale c / 65535.

    Parameters
    ----------
    codes : (N, 3) uint16
    scale : the cube's side; one for the three axes, so that directions keep their angles under the node's transform
    translation : (3,) the cube's lowest corner
    """

    codes: np.ndarray
    scale: float
    translation: np.ndarray


def quantise_positions(points: np.ndarray) -> QuantisedPositions:
    """Positions (N, 3), finite, to within half a step (scale / 131070) of each axis."""
    points = np.asarray(points, np.float64)
    low = points.min(0)
    scale = float((points.max(0) - low).max())
    # One point has no extent; any scale puts it where it is.
    scale = scale if scale > 0 else 1.0
    return QuantisedPositions(np.rint((points - low) * (STEPS / scale)).astype(np.uint16), scale, low)


def quantise_uv(uv: np.ndarray) -> np.ndarray:
    """uint16 codes of coordinates in [0, 1] (clipped); a step is a 32nd of a texel at 2048."""
    return np.rint(np.clip(np.asarray(uv, np.float64), 0.0, 1.0) * STEPS).astype(np.uint16)


def quantise_signed(values: np.ndarray, dtype: type) -> np.ndarray:
    """Codes of values in [-1, 1] in np.int8 (unit vectors to 0.4 degrees) or np.int16 (to 0.002 degrees)."""
    largest = np.iinfo(dtype).max
    return np.rint(np.clip(np.asarray(values, np.float64), -1.0, 1.0) * largest).astype(dtype)
