"""What covers the head, united with it: hair of the face, garment, hair and headwear on the template's grid.

Notation: ``f`` the field in metres, negative inside. Brows, beard and garment thicken the body where they lie; hair and
headwear are joined to it by a smooth minimum, so that the result is one closed surface as a scan would see it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from data_synth.head.beard import face_hair_relief_mm
from data_synth.head.cloth import HIGHEST_MM, cloth_layer
from data_synth.head.grid import HeadGrid, refine_axis_values, template_grid
from data_synth.head.hair import hair_field_mm, knots_mm
from data_synth.head.hair_styles import STYLES
from data_synth.head.headwear import VISOR_FRONT_MM, headwear_field_mm, under_headwear
from data_synth.head.noise import smooth_min
from data_synth.head.params import HeadParams
from data_synth.head.scalp import interpolate_scalp, without_crumbs

BLEND_MM = 1.0
EAR_PRESSED_MM = 6.0
HAIR_REACH_M = 0.135
BOX_MM = ((-140.0, 140.0), (-230.0, 180.0), (-230.0, 42.0))
FACE_BOX_MM = ((-74.0, 74.0), (-150.0, 36.0), (-80.0, 60.0))
THICKEST_CLOTH_MM = 26.0
COARSE, BAND_MM = 4, 6.0  # a lattice of some 10 mm errs by less than 6 mm on what hair and hats are made of


@lru_cache(maxsize=2)
def _scalp_in_box(tall: bool) -> np.ndarray:
    """The scalp's distance (mm, float32) at the grid's nodes in the cover's box."""
    axes = _axes_mm(_grid(tall))
    own = [a[s] for a, s in zip(axes, _box(axes, _box_mm(tall)), strict=True)]
    nodes = np.stack(np.meshgrid(*own, indexing="ij"), -1)
    return interpolate_scalp(nodes.reshape(-1, 3)).astype(np.float32).reshape(nodes.shape[:3])


@lru_cache(maxsize=2)
def _grid(visor: bool) -> HeadGrid:
    """The template's grid; for a cap it reaches farther forward."""
    if not visor:
        grid = template_grid()
        # wide hair reaches where the bust alone is coarse enough
        middle = 0.5 * (grid.x[1:] + grid.x[:-1])
        wide = (np.diff(grid.x) > 3e-3) & (np.abs(middle) < HAIR_REACH_M)
        x = np.sort(np.r_[grid.x, middle[wide]])
        field = refine_axis_values(without_crumbs(grid.field), (grid.x, grid.y, grid.z), (x, grid.y, grid.z))
        return HeadGrid(x, grid.y, grid.z, field)
    grid = _grid(False)
    more = np.arange(grid.z[-1] + 2.4e-3, VISOR_FRONT_MM * 1e-3 + 6e-3, 2.4e-3)
    beyond = grid.field[:, :, -1:] + (more - grid.z[-1]).astype(np.float32)
    return HeadGrid(grid.x, grid.y, np.r_[grid.z, more], np.concatenate([grid.field, beyond], axis=2))


def _axes_mm(grid: HeadGrid) -> list[np.ndarray]:
    return [a * 1e3 for a in (grid.x, grid.y, grid.z)]


def _box_mm(visor: bool) -> tuple[tuple[float, float], ...]:
    return (*BOX_MM[:2], (BOX_MM[2][0], VISOR_FRONT_MM + 8.0)) if visor else BOX_MM


def _box(axes: list[np.ndarray], box_mm: tuple[tuple[float, float], ...]) -> tuple[slice, ...]:
    return tuple(slice(*np.searchsorted(a, b)) for a, b in zip(axes, box_mm, strict=True))


def _thicken(grid: HeadGrid, field: np.ndarray, box_mm, reach_mm: float, relief) -> None:
    """Subtract ``relief`` (mm, a function of points in mm) from the field within ``reach_mm`` of the surface."""
    axes = _axes_mm(grid)
    box = _box(axes, box_mm)
    part = field[box]
    i, j, k = np.nonzero((part > -4e-3) & (part < 1e-3 * reach_mm))
    x = np.stack([a[s][n] for a, s, n in zip(axes, box, (i, j, k), strict=True)], 1)
    # the field is a distance only where its slope is 1; in hollows it is flatter
    slope = np.zeros(len(x))
    for axis, (a, s, n) in enumerate(zip(axes, box, (i, j, k), strict=True)):
        at = [i, j, k]
        at[axis] = np.minimum(n + 1, part.shape[axis] - 1)
        up = part[tuple(at)]
        high = a[s][at[axis]]
        at[axis] = np.maximum(n - 1, 0)
        slope += (1e3 * (up - part[tuple(at)]) / (high - a[s][at[axis]])) ** 2
    part[i, j, k] -= (1e-3 * relief(x) * np.clip(np.sqrt(slope), 0.2, 1.1)).astype(np.float32)


def _dress(grid: HeadGrid, field: np.ndarray, params: HeadParams) -> None:
    """Join the garment: a layer over the body, whose distance is known well beyond the template's own field."""
    axes = _axes_mm(grid)
    floor = axes[1][0] + 6.0
    box = _box(axes, ((axes[0][0], axes[0][-1] + 1.0), (floor, HIGHEST_MM), (axes[2][0], 62.0)))
    part = field[box]
    i, j, k = np.nonzero((part > -4e-3) & (part < 1e-3 * THICKEST_CLOTH_MM))
    x = np.stack([a[s][n] for a, s, n in zip(axes, box, (i, j, k), strict=True)], 1)
    layer = cloth_layer(x, params)
    thick = layer.cover * (layer.thickness + 3.0) - 3.0
    body = 1e3 * part[i, j, k].astype(np.float64)
    part[i, j, k] = 1e-3 * smooth_min(interpolate_scalp(x) - thick, body, BLEND_MM)


def composed_field(params: HeadParams) -> tuple[HeadGrid, np.ndarray]:
    """The template's grid and, on it, the field (m) of head, hair, garment and headwear together."""
    visor = params.dress.headwear == "cap"
    grid = _grid(visor)
    field = grid.field.copy()
    axes = _axes_mm(grid)
    beard = params.groom.beard != "none"
    reach = 2.0 * params.groom.beard_mm + 6.0 if beard else 5.0
    _thicken(grid, field, FACE_BOX_MM, reach, lambda x: face_hair_relief_mm(x, params))
    if params.dress.garment != "none":
        _dress(grid, field, params)
    style = STYLES[params.hair_style]
    if style.top == 0.0 and params.dress.headwear == "none":
        return grid, field
    box = _box(axes, _box_mm(visor))
    part = field[box]
    own = tuple(a[b] for a, b in zip(axes, box, strict=True))
    # first every fourth node each way, then every node near the surface that this shows
    coarse_axes = tuple(np.r_[a[:-1:COARSE], a[-1]] for a in own)
    nodes = np.stack(np.meshgrid(*coarse_axes, indexing="ij"), -1)
    rough = _hair_and_headwear_mm(nodes.reshape(-1, 3), params, interpolate_scalp(nodes.reshape(-1, 3)))
    rough = np.clip(rough, -60.0, 60.0).astype(np.float32).reshape(nodes.shape[:3])
    cover = refine_axis_values(rough, coarse_axes, own)
    # inside the head nothing changes
    i, j, k = np.nonzero((np.abs(cover) < BAND_MM) & (part > -5e-3))
    x = np.stack([a[n] for a, n in zip(own, (i, j, k), strict=True)], 1)
    cover[i, j, k] = _hair_and_headwear_mm(x, params, _scalp_in_box(visor)[i, j, k].astype(np.float64))
    if style.curtain is not None:
        # hair that hangs over the ears presses them to the head
        ear = _box(axes, ((-140.0, 140.0), (-75.0, 25.0), (-125.0, -48.0)))
        ears = field[ear]
        scalp = _scalp_in_box(visor)[
            tuple(slice(e.start - b.start, e.stop - b.start) for e, b in zip(ear, box, strict=True))
        ]
        np.maximum(ears, 1e-3 * (scalp - EAR_PRESSED_MM), out=ears)
    outside = part > -5e-3
    part[outside] = 1e-3 * smooth_min(cover[outside], 1e3 * part[outside], BLEND_MM)
    return grid, field


def _hair_and_headwear_mm(x_mm: np.ndarray, params: HeadParams, d_mm: np.ndarray) -> np.ndarray:
    hair = hair_field_mm(x_mm, params, d_mm)
    if params.dress.headwear == "none":
        return hair
    g = headwear_field_mm(x_mm, params, d_mm)
    pressed = np.minimum(under_headwear(hair, g, x_mm, params), g)
    # a tail or a bun goes through the headwear
    style = STYLES[params.hair_style]
    return smooth_min(pressed, knots_mm(x_mm, style, params.hair_length), 4.0) if style.knots else pressed
