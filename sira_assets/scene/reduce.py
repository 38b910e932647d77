"""A smaller portrait: what a fit reads where the photo has more pixels than its time allows.

Notation: k whole pixels a side become one; what is left over at the right and below is cut.
"""

from dataclasses import replace

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.portrait import Portrait

# Below this the nine landmarks are pixels apart and no face can be told.
LEAST_SIDE = 16


def reduced(portrait: Portrait, longest_side: int) -> Portrait:
    """The portrait with at most `longest_side` pixels a side, by averages of whole blocks of pixels.

    A reduced pixel is head where most of its block is, and clipped where any of its pixels is: its mean is then
    too low.

    Parameters
    ----------
    longest_side : pixels, at least 16; a portrait within it is given back as it is

    Raises
    ------
    InputError : a side that is too short, or nothing left of the mask.
    """
    if longest_side < LEAST_SIDE:
        raise InputError(
            expected=f"a photo of at least {LEAST_SIDE} pixels a side",
            received=str(longest_side),
            remedy="allow more pixels",
        )
    height, width = portrait.mask.shape
    k = -(-max(height, width) // longest_side)
    if k <= 1:
        return portrait
    rows, columns = height // k, width // k
    if not rows or not columns:
        raise InputError(
            expected="a photo whose sides are less unlike",
            received=f"{width} x {height} pixels",
            remedy="crop it about the head",
        )

    def blocks(array: np.ndarray) -> np.ndarray:
        kept = array[: rows * k, : columns * k]
        return kept.reshape(rows, k, columns, k, *array.shape[2:])

    camera = replace(portrait.camera, width=columns * k, height=rows * k).resized(columns, rows)
    said = f"the photo of {width} x {height} pixels was read at {columns} x {rows}"
    return replace(
        portrait,
        warnings=(*portrait.warnings, said),
        image_linear=blocks(portrait.image_linear).mean((1, 3), dtype=np.float64).astype(np.float32),
        mask=blocks(portrait.mask).mean((1, 3)) > 0.5,
        camera=camera,
        landmarks_px={name: np.asarray(pixel) / k for name, pixel in portrait.landmarks_px.items()},
        saturated=blocks(portrait.saturated).any((1, 3)),
    )
