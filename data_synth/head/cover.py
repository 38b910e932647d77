"""What covers the head, united with it: hair and cloth on the template's grid.

Notation: ``f`` the field in metres, negative inside. Cloth thickens the body where it lies; hair is joined to it by a
smooth minimum, so that the result is one closed surface as a scan would see it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from data_synth.head.grid import HeadGrid, template_grid
from data_synth.head.hair import STYLES, hair_field_mm, interpolate_scalp
from data_synth.head.material import cloth_cover
from data_synth.head.params import HeadParams

CLOTH_MM = 2.2
HAIR_BLEND_MM = 1.0
HAIR_BOX_MM = ((-125.0, 125.0), (-222.0, 170.0), (-215.0, 42.0))


def is_bare(params: HeadParams) -> bool:
    """Whether nothing covers the head: its surface is the bald template's."""
    return STYLES[params.hair_style].top == 0.0 and params.pigment.collar > 1.5


@lru_cache(maxsize=1)
def _scalp_in_box() -> np.ndarray:
    """The scalp's distance (mm, float32) at the template grid's nodes in the hair's box."""
    grid = template_grid()
    axes = [a * 1e3 for a in (grid.x, grid.y, grid.z)]
    own = [a[slice(*np.searchsorted(a, b))] for a, b in zip(axes, HAIR_BOX_MM, strict=True)]
    nodes = np.stack(np.meshgrid(*own, indexing="ij"), -1)
    return interpolate_scalp(nodes.reshape(-1, 3)).astype(np.float32).reshape(nodes.shape[:3])


def composed_field(params: HeadParams) -> tuple[HeadGrid, np.ndarray]:
    """The template's grid and, on it, the field (m) of head, hair and cloth together."""
    grid = template_grid()
    field = grid.field.copy()
    axes = [a * 1e3 for a in (grid.x, grid.y, grid.z)]
    if params.pigment.collar <= 1.5:
        low = int(np.searchsorted(axes[1], -120.0))
        near = np.abs(field[:, :low]) < 8e-3
        i, j, k = np.nonzero(near)
        x = np.stack([axes[0][i], axes[1][j], axes[2][k]], 1)
        floor = axes[1][0] + 6.0
        field[i, j, k] -= (1e-3 * CLOTH_MM * cloth_cover(x, params) * (x[:, 1] > floor)).astype(np.float32)
    style = STYLES[params.hair_style]
    if style.top > 0:
        box = tuple(slice(*np.searchsorted(a, b)) for a, b in zip(axes, HAIR_BOX_MM, strict=True))
        part = field[box]
        # inside the head nothing changes
        scalp = _scalp_in_box()
        candidate = (part > -4e-3) & (scalp < (30.0 if not style.volumes else 75.0) * params.hair_length + 10.0)
        if style.curl:
            candidate = (part > -4e-3) & (scalp < 60.0)
        i, j, k = np.nonzero(candidate)
        x = np.stack([axes[0][box[0]][i], axes[1][box[1]][j], axes[2][box[2]][k]], 1)
        hair = 1e-3 * hair_field_mm(x, params, scalp[i, j, k])
        base = part[i, j, k].astype(np.float64)
        blend = 1e-3 * HAIR_BLEND_MM
        gap = np.clip(blend - np.abs(hair - base), 0.0, None)
        part[i, j, k] = np.minimum(hair, base) - gap * gap / (4 * blend)
    return grid, field
