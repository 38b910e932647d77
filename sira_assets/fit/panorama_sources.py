"""The bright sources of a panorama: sun, lamps, windows, each as one spherical gaussian of its flux and spread.

Notation: cells as in `panorama_cells`; a source is a connected patch of cells around a peak of radiance.
"""

import numpy as np

from sira_assets.fit.panorama_cells import Cells, gathered_lobe

# A patch reaches down to this share of its peak's radiance, which for a gaussian holds 90 % of its flux.
FALL = 0.1
# It ends this far from its peak: what is wider is sky, which evenly spread lobes serve as well.
REACH_DEGREES = 12.0
# Patches looked at, brightest first, and the share of the whole flux from which on one counts as a source.
PATCHES, SHARE = 24, 0.005


def _patch(cells: Cells, index: np.ndarray, allowed: np.ndarray, peak: int) -> np.ndarray:
    """Cells connected to `peak`, over corners and over the seam, among those allowed."""
    rows, columns = cells.grid
    found, edge = {peak}, [peak]
    while edge:
        row, column = cells.place[edge.pop()]
        for i in range(max(row - 1, 0), min(row + 2, rows)):
            for j in (column - 1, column, column + 1):
                k = index[i, j % columns]
                if k >= 0 and k not in found and allowed[k]:
                    found.add(k)
                    edge.append(k)
    return np.array(sorted(found))


def bright_sources(cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Axes (S, 3) unit and sharpnesses (S,) of the sources, S from 0 to `PATCHES`."""
    rows, columns = cells.grid
    index = np.full(cells.grid, -1)
    index[tuple(cells.place.T)] = np.arange(len(cells.flux))
    edges = -np.cos(np.pi * np.arange(rows + 1) / rows)
    flux = cells.flux.sum(-1)
    radiance = flux / (np.diff(edges) * 2.0 * np.pi / columns)[cells.place[:, 0]]
    left = np.ones(len(flux), bool)
    axes, sharpness = [], []
    for _ in range(PATCHES):
        if not left.any():
            break
        peak = int(np.argmax(np.where(left, radiance, -1.0)))
        near = cells.centre @ cells.centre[peak] > np.cos(np.radians(REACH_DEGREES))
        patch = _patch(cells, index, left & near & (radiance >= FALL * radiance[peak]), peak)
        left[patch] = False
        if flux[patch].sum() >= SHARE * flux.sum():
            axis, lam = gathered_lobe(flux[patch].sum(), cells.moment[patch].sum((0, 1)))
            axes.append(axis)
            sharpness.append(lam)
    return np.array(axes).reshape(-1, 3), np.array(sharpness)
