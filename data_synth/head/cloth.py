"""Garments: where they cover the bust, how thick they lie and what colour they have.

Notation: template frame, millimetres. A garment is a thickness over the skin, a function of position alone; the neck's
axis stands at z = -88, its radius is about 58 there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.head.noise import plane_noise, smoothstep
from data_synth.head.params import HeadParams

HIGHEST_MM = -100.0
NECK_Z = -88.0


@dataclass(frozen=True)
class ClothLayer:
    """At N points: coverage in [0, 1], thickness (mm) and the part of it that is a band of the second colour."""

    cover: np.ndarray
    thickness: np.ndarray
    band: np.ndarray


def _edge(x_mm: np.ndarray, front: float, side: float, back: float) -> np.ndarray:
    """Height over which a neckline passes, by the direction from the neck's axis."""
    turn = np.arctan2(np.abs(x_mm[:, 0]), x_mm[:, 2] - NECK_Z)
    return np.interp(turn, [0.0, 0.5, np.pi / 2, 2.5, np.pi], [front, front, side, back, back])


def _crew(x_mm: np.ndarray, neckline: float, seed: int) -> ClothLayer:
    low = -154.0 - 26.0 * neckline
    edge = _edge(x_mm, low - 22.0 - 10.0 * neckline, low, -141.0 - 10.0 * neckline)
    below = edge - x_mm[:, 1] + 0.8 * plane_noise(x_mm, seed + 81, 6, 60.0)
    rib = smoothstep(15.0 - below, -1.0, 1.0)
    return ClothLayer(smoothstep(below, 0.0, 1.6), 2.0 + 1.1 * rib, rib)


def _vneck(x_mm: np.ndarray, neckline: float, seed: int) -> ClothLayer:
    edge = _edge(x_mm, -158.0, -158.0 - 16.0 * neckline, -143.0 - 8.0 * neckline)
    front = smoothstep(x_mm[:, 2], -90.0, -70.0)
    low = -214.0 - 8.0 * neckline
    cut = np.where(x_mm[:, 1] < low, np.inf, np.abs(x_mm[:, 0]) - 58.0 * (x_mm[:, 1] - low) / (-150.0 - low))
    below = np.minimum(edge - x_mm[:, 1], np.where(front > 0, cut / np.sqrt(1 + 0.8**2) + 90.0 * (1 - front), np.inf))
    rib = smoothstep(9.0 - below, -1.0, 1.0)
    return ClothLayer(smoothstep(below + 0.4 * plane_noise(x_mm, seed + 81, 6, 60.0), 0.0, 1.6), 2.0 + 0.7 * rib, rib)


def _tank(x_mm: np.ndarray, neckline: float, seed: int) -> ClothLayer:
    x, y, z = np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]
    strap = np.minimum(x - (66.0 + 8.0 * neckline), 104.0 - 6.0 * neckline - x)
    chest = np.where(z > NECK_Z, -206.0 - 6.0 * neckline, -186.0) - y - 0.006 * np.clip(70.0 - x, 0.0, None) ** 2
    below = np.maximum(np.minimum(strap, -120.0 - y), np.minimum(chest, 112.0 + 0.8 * (-190.0 - y) - x))
    return ClothLayer(smoothstep(below, 0.0, 1.6), np.full(len(x), 2.0), smoothstep(6.0 - below, -1.0, 1.0))


def _shirt(x_mm: np.ndarray, neckline: float, seed: int) -> ClothLayer:
    x, y, z = np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]
    top = _edge(x_mm, -150.0 - 6.0 * neckline, -140.0, -128.0)
    # the leaf folds down from the band and ends in two points
    leaf_low = np.interp(x, [0.0, 12.0, 34.0, 42.0, 60.0, 90.0], [-164.0, -176.0, -206.0, -204.0, -186.0, -176.0])
    leaf_low = -164.0 + (leaf_low + 164.0) * smoothstep(z, -112.0, -72.0)
    # unbuttoned to a depth that the neckline says
    opening = np.clip(y + 172.0 + 44.0 * neckline, -20.0, None) * (0.12 + 0.30 * neckline)
    spread = x - (7.0 + (-146.0 - y) * (0.42 + 0.25 * neckline))
    leaf = np.minimum(np.minimum(top - y, y - leaf_low), np.where(z > -85.0, spread, 50.0))
    body = np.minimum(_edge(x_mm, -158.0, -160.0, -150.0) - y, np.where(z > -85.0, x - opening, 50.0))
    on_leaf = smoothstep(leaf, 0.0, 3.0)
    placket = smoothstep(10.0 - x, 0.0, 1.5) * (z > -85.0)
    button = np.exp(-0.5 * ((x / 2.6) ** 2 + (np.mod(y + 208.0, 46.0) / 2.6) ** 2) ** 2) * (z > -85.0)
    thick = 1.8 + 4.0 * on_leaf + 0.9 * placket * (1 - on_leaf) + 0.8 * button * (1 - on_leaf)
    return ClothLayer(smoothstep(np.maximum(leaf, body), 0.0, 2.4), thick, np.zeros(len(x)))


def _jumper(x_mm: np.ndarray, neckline: float, seed: int) -> ClothLayer:
    if neckline > 0.55:
        crew = _crew(x_mm, 0.5 * (neckline - 0.55), seed)
        return ClothLayer(crew.cover, crew.thickness + 1.6, crew.band)
    below = _edge(x_mm, -136.0, -127.0, -114.0) - x_mm[:, 1]
    roll = np.exp(-0.5 * ((below - 15.0) / 10.0) ** 2)
    turn = np.arctan2(x_mm[:, 0], x_mm[:, 2] - NECK_Z)
    rib = 0.45 * np.cos(46 * turn) * smoothstep(40.0 - below, 0.0, 8.0)
    thick = 3.2 + 3.4 * roll + rib + 0.5 * plane_noise(x_mm, seed + 83, 8, 40.0)
    return ClothLayer(smoothstep(below, 0.0, 2.2), thick, np.zeros(len(x_mm)))


def _hoodie(x_mm: np.ndarray, neckline: float, seed: int) -> ClothLayer:
    crew = _crew(x_mm, 0.45 * neckline, seed)
    x, y, z = np.abs(x_mm[:, 0]), x_mm[:, 1], x_mm[:, 2]
    depth = _edge(x_mm, -178.0, -152.0, -132.0) - y
    # the hood lies as a roll around the neck, thick behind
    rear = smoothstep(-z, 60.0, 150.0)
    roll = np.exp(-0.5 * ((depth - 18.0 - 14.0 * rear) / (11.0 + 12.0 * rear)) ** 2)
    fold = 1.0 + 0.22 * plane_noise(x_mm, seed + 85, 10, 34.0)
    split = 1.0 - np.exp(-0.5 * (x / 4.0) ** 2) * (z > -80.0)
    cover = np.maximum(crew.cover, smoothstep(depth, 0.0, 2.0))
    return ClothLayer(cover, 3.0 + (8.0 + 8.0 * rear) * roll * fold * split, np.zeros(len(x)))


def _scarf(x_mm: np.ndarray, neckline: float, seed: int) -> ClothLayer:
    crew = _crew(x_mm, 0.3, seed)
    below = _edge(x_mm, -128.0 - 14.0 * neckline, -122.0, -112.0) - x_mm[:, 1]
    turn = np.arctan2(x_mm[:, 0], x_mm[:, 2] - NECK_Z)
    end = 56.0 + 8.0 * np.sin(2 * turn + seed % 5)
    inside = smoothstep(below, 0.0, 3.0) * smoothstep(end - below, 0.0, 5.0)
    fold = 2.6 * np.abs(
        np.cos(below / 8.5 + 1.2 * np.sin(turn + seed % 7) + 0.5 * plane_noise(x_mm, seed + 87, 8, 50.0))
    )
    thick = crew.thickness * (1 - inside) + inside * (8.0 + fold + 4.0 * np.exp(-0.5 * ((below - 26.0) / 16.0) ** 2))
    return ClothLayer(np.maximum(crew.cover, inside), thick, inside)


_GARMENTS = {
    "tshirt": _crew,
    "vneck": _vneck,
    "tank": _tank,
    "shirt": _shirt,
    "jumper": _jumper,
    "hoodie": _hoodie,
    "scarf": _scarf,
}


def cloth_layer(x_mm: np.ndarray, params: HeadParams) -> ClothLayer:
    """The garment at template points (N, 3); nothing above `HIGHEST_MM`."""
    dress = params.dress
    zero = np.zeros(len(x_mm))
    out = ClothLayer(zero, zero.copy(), zero.copy())
    low = np.flatnonzero(x_mm[:, 1] < HIGHEST_MM)
    if dress.garment == "none" or not len(low):
        return out
    layer = _GARMENTS[dress.garment](x_mm[low], dress.neckline, params.seed)
    # wide, shallow folds that run from neck to shoulder
    fold = (
        0.9 * plane_noise(x_mm[low] * [0.5, 1.0, 1.0], params.seed + 89, 10, 55.0) * smoothstep(-x_mm[low, 1], 150, 190)
    )
    out.cover[low], out.thickness[low], out.band[low] = (
        layer.cover,
        np.clip(layer.thickness + fold, 0.8, 30),
        layer.band,
    )
    return out


def cloth_colour(x_mm: np.ndarray, params: HeadParams, layer: ClothLayer) -> np.ndarray:
    """Diffuse albedo of the fabric (N, 3): its pattern and a weave."""
    dress = params.dress
    x, y = x_mm[:, 0], x_mm[:, 1]
    amount = np.zeros(len(x))
    if dress.pattern == "stripes":
        amount = smoothstep(np.cos(2 * np.pi * y / 17.0), 0.0, 0.15)
    elif dress.pattern == "check":
        amount = 0.5 * smoothstep(np.cos(2 * np.pi * y / 15.0), 0.2, 0.4)
        amount = amount + 0.5 * smoothstep(np.cos(2 * np.pi * x / 15.0), 0.2, 0.4)
    elif dress.pattern == "dots":
        amount = smoothstep(np.cos(2 * np.pi * y / 13.0) + np.cos(2 * np.pi * x / 13.0), 1.1, 1.35)
    elif dress.pattern == "melange":
        amount = np.clip(0.18 + 0.16 * plane_noise(x_mm, params.seed + 91, 24, 2.6), 0.0, 0.6)
    if dress.garment == "scarf":
        amount = layer.band
    elif dress.pattern != "plain":
        amount = amount * (1 - layer.band)
    colour = np.array(dress.cloth) + (np.array(dress.second) - dress.cloth) * amount[:, None]
    weave = 1.0 + 0.05 * np.cos(2 * np.pi * x / 1.7) * np.cos(2 * np.pi * y / 1.7)
    weave = weave + 0.03 * plane_noise(x_mm, params.seed + 93, 10, 7.0)
    return colour * np.clip(weave, 0.6, 1.4)[:, None]
