"""Reading a map as a viewer does: bilinearly between texel centres, the border's texels going on beyond it.

Notation: uv has its origin at the bottom left, maps have row 0 on top.
"""

import numpy as np


def footprint(uv: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Texels (N, 4), numbered row by row, and their weights (N, 4) in a reading at uv (N, 2) of a size x size map."""
    x, y = uv[:, 0] * size - 0.5, (1.0 - uv[:, 1]) * size - 0.5
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = x - i, y - j
    texels, weights = [], []
    for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
        row, column = np.clip(j + down, 0, size - 1), np.clip(i + across, 0, size - 1)
        texels.append(row * size + column)
        weights.append((fy if down else 1.0 - fy) * (fx if across else 1.0 - fx))
    return np.stack(texels, 1), np.stack(weights, 1)


def bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(N, C) values of a map (S, S, C) at uv (N, 2)."""
    texels, weights = footprint(uv, len(texture))
    return (texture.reshape(-1, texture.shape[-1])[texels] * weights[..., None]).sum(1)
