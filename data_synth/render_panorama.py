"""A panorama as a light of the renderer: directions drawn by its own brightness.

Notation: the map is constant within each of its H x W pixels, L_ij over [theta_i, theta_i+1] x [phi_j, phi_j+1], as
`sira_assets.scene.envmap` lays them out. The patterns are its three channels, the colours therefore unit vectors.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from data_synth.render_source import LUMINANCE
from sira_assets.errors import InputError
from sira_assets.scene.envmap import EnvironmentMap
from sira_assets.scene.envmap_resample import envmap_resized

# Irradiance is summed over blocks of pixels, so many rows of them: 3.75 degrees a block.
CELL_ROWS, FINE_ROWS = 48, 192


@dataclass(frozen=True)
class PanoramaSource:
    """A light for `direct_light`; `envmap` is in the frame of the normals.

    Raises
    ------
    InputError : the map is black, or negative somewhere.
    """

    envmap: EnvironmentMap
    proposals: int = 1

    def __post_init__(self):
        least, most = float(self.envmap.radiance.min()), float(self.envmap.radiance.max())
        if least < 0 or most <= 0:
            raise InputError(
                expected="a panorama with light in it and no negative radiance",
                received=f"radiance from {least:.3g} to {most:.3g}",
                remedy="choose another, or clip it at 0",
            )

    @property
    def colour(self) -> np.ndarray:
        """(3, 3) identity: a pattern is a channel."""
        return np.eye(3)

    @cached_property
    def _flux(self) -> np.ndarray:
        """(H, W, 3) radiance times solid angle."""
        return self.envmap.radiance * self.envmap.solid_angles()[..., None]

    @cached_property
    def _moments(self) -> np.ndarray:
        """(3, cells, 3): per channel and block of pixels, the integral of L w dw."""
        # A small map is cut finer, so that a pixel's own extent counts as the block's does.
        height, rows = self.envmap.radiance.shape[0], CELL_ROWS
        fine = envmap_resized(self.envmap, height * -(-FINE_ROWS // height))
        height, width = fine.radiance.shape[:2]
        cell = (np.arange(height) * rows // height)[:, None] * (2 * rows) + np.arange(width) * 2 * rows // width
        flux, w, cell = fine.radiance * fine.solid_angles()[..., None], fine.directions(), cell.ravel()
        return np.array(
            [
                [np.bincount(cell, (flux[..., c] * w[..., k]).ravel(), 2 * rows * rows) for k in range(3)]
                for c in range(3)
            ]
        ).transpose(0, 2, 1)

    @cached_property
    def _inverse(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Distribution of rows (H + 1,), of columns within rows laid end to end (H W,), and both densities' masses."""
        mass = self._flux @ LUMINANCE
        height = len(mass)
        rows = mass.sum(1) / mass.sum()
        edges = np.concatenate([[0.0], np.cumsum(rows)])
        columns = mass / np.maximum(mass.sum(1, keepdims=True), 1e-300)
        begin = np.cumsum(columns, axis=1) - columns + np.arange(height)[:, None]
        return edges / edges[-1], begin.ravel(), rows, columns.ravel()

    def irradiance(self, normals: np.ndarray) -> np.ndarray:
        """(P, 3). A block wholly above the horizon adds n . moment exactly; blocks that the horizon cuts err.

        Their errors are of second order in a block's size: below 1e-3 of the whole for a smooth sky, and for a sun of
        half a degree only where it sets.
        """
        out = np.zeros((len(normals), 3))
        for channel, moments in enumerate(self._moments):
            lit = moments[(moments != 0).any(1)]
            for start in range(0, len(normals), 4096):
                part = slice(start, start + 4096)
                out[part, channel] = np.maximum(normals[part] @ lit.T, 0.0).sum(1)
        return out

    def proposal_energy(self, irradiance: np.ndarray) -> np.ndarray:
        """(P, 1); less where most of the map's light is below the horizon, or grazes."""
        luminance = irradiance @ LUMINANCE
        return (luminance * np.minimum(2.0 * luminance / (self._flux @ LUMINANCE).sum(), 1.0))[:, None]

    def draw(self, proposal: int, u1: np.ndarray, u2: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """By luminance times solid angle: a row, a column, and a place within the pixel, even in solid angle."""
        edges, begin, rows, columns = self._inverse
        height, width = self.envmap.radiance.shape[:2]
        u1, u2 = u1.astype(np.float64), u2.astype(np.float64)
        row = np.clip(np.searchsorted(edges, u1, side="right") - 1, 0, height - 1)
        down = np.clip((u1 - edges[row]) / np.maximum(rows[row], 1e-300), 0.0, 1.0)
        place = np.clip(np.searchsorted(begin, row + u2, side="right") - 1, row * width, (row + 1) * width - 1)
        across = np.clip((row + u2 - begin[place]) / np.maximum(columns[place], 1e-300), 0.0, 1.0)
        top, bottom = np.cos(np.pi * row / height), np.cos(np.pi * (row + 1) / height)
        y = top + down * (bottom - top)
        phi = 2.0 * np.pi * (place - row * width + across) / width
        radius = np.sqrt(np.maximum(1.0 - y * y, 0.0))
        return tuple(a.astype(np.float32) for a in (radius * np.sin(phi), y, -radius * np.cos(phi)))

    def evaluate(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pixel's radiance (3, ...), and its luminance over that of the whole map (1, ...)."""
        height, width = self.envmap.radiance.shape[:2]
        row = np.minimum((np.arccos(np.clip(y, -1, 1)) * np.float32(height / np.pi)).astype(np.int64), height - 1)
        turn = np.arctan2(x, -z) * np.float32(0.5 / np.pi)
        column = np.minimum(((turn - np.floor(turn)) * width).astype(np.int64), width - 1)
        g = np.moveaxis(self.envmap.radiance[row, column], -1, 0)
        total = np.float32((self._flux @ LUMINANCE).sum())
        return g, np.einsum("k...,k->...", g, LUMINANCE.astype(np.float32))[None] / total
