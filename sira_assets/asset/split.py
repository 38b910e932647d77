"""Split a welded mesh at its texture seams, for files whose vertices carry position and UV under one index.

Notation: a corner is one of a face's three ends; it has a position index (mesh) and a UV index (atlas).
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SplitVertices:
    """One vertex for each distinct pair of position and UV.

    Parameters
    ----------
    position_index : (N,) int64 into the mesh's vertices
    uv_index : (N,) int64 into the atlas's UVs
    faces : (F, 3) int64 into the N vertices, in the mesh's face order and winding
    """

    position_index: np.ndarray
    uv_index: np.ndarray
    faces: np.ndarray


def split_at_seams(faces: np.ndarray, faces_uv: np.ndarray) -> SplitVertices:
    """Give every distinct (position, UV) pair its own vertex.

    Parameters
    ----------
    faces, faces_uv : (F, 3) int, position and UV indices of the same corners

    Returns
    -------
    SplitVertices : ordered by position, then UV, so that the result depends on nothing but the input.
    """
    faces, faces_uv = np.asarray(faces, np.int64), np.asarray(faces_uv, np.int64)
    stride = int(faces_uv.max(initial=0)) + 1
    pairs, inverse = np.unique(faces.reshape(-1) * stride + faces_uv.reshape(-1), return_inverse=True)
    return SplitVertices(pairs // stride, pairs % stride, inverse.reshape(-1, 3).astype(np.int64))
