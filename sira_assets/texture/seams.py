"""Make a map read the same on both sides of every seam.

Notation: a seam point has uv on two charts, u and v; a viewer reads the map bilinearly, so that the difference of the
two readings is linear in at most eight texels x: r = sum_k w_k x_k, with w_k negative for those of v. The least change
of the texels that brings r to zero is -r w / |w|^2; points share texels, so all changes at one texel are averaged and
the step is taken again (Cimmino 1938; for textures see Liu, Ferguson, Jacobson and Gingold 2017, DOI
10.1145/3130800.3130897). A texel keeps within what the seam points that read it show on either side: along a seam that
an edge of the picture crosses, steps that feed each other would else draw the edge out by more than a texel. Only
points that differ by more than `TOLERANCE` move anything: folds, where a texel beyond the border has found another part
of the surface, and charts narrower than a texel.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.texture.atlas import Atlas
from sira_assets.texture.reading import footprint

# Half an 8-bit step of the map's range is left: as much again is lost to the rounding of either side.
TOLERANCE = 0.5 / 255.0
# What so many passes leave are points whose texels contradict one another.
PASSES = 500
# Seam points stand no further apart than this, in texels: bilinear readings between them cannot differ much more.
SPACING_TEXELS = 0.5


@dataclass(frozen=True)
class Seams:
    """Where one and the same surface point is read at two places of a map.

    Parameters
    ----------
    texels : (N, 8) int64, row-major texel numbers
    weights : (N, 8), the second four negative
    """

    texels: np.ndarray
    weights: np.ndarray


def seam_edges(mesh: TriangleMesh, atlas: Atlas) -> tuple[np.ndarray, np.ndarray]:
    """Ends of every seam edge in uv, (E, 2, 2) on one chart and on the other, in the same order along the edge."""
    corner = [0, 1, 1, 2, 2, 0]
    edges, edges_uv = (f[:, corner].reshape(-1, 2) for f in (mesh.faces, atlas.faces_uv))
    turned = edges[:, 0] > edges[:, 1]
    edges, edges_uv = (np.where(turned[:, None], e[:, ::-1], e) for e in (edges, edges_uv))
    key = (edges[:, 0].astype(np.int64) << 32) | edges[:, 1]
    order = np.argsort(key, kind="stable")
    one, other = order[:-1], order[1:]
    seam = (key[one] == key[other]) & (edges_uv[one] != edges_uv[other]).any(1)
    return atlas.uv[edges_uv[one[seam]]], atlas.uv[edges_uv[other[seam]]]


def find_seams(mesh: TriangleMesh, atlas: Atlas, size: int) -> Seams:
    """Points along all seams of maps of `size` texels a side."""
    one, other = seam_edges(mesh, atlas)
    length = np.maximum(*(np.linalg.norm(side[:, 1] - side[:, 0], axis=1) for side in (one, other))) * size
    count = np.maximum(2, np.ceil(length / SPACING_TEXELS)).astype(np.int64)
    edge = np.repeat(np.arange(len(one)), count)
    t = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / (np.repeat(count, count) - 1)
    sides = [side[edge, 0] + t[:, None] * (side[edge, 1] - side[edge, 0]) for side in (one, other)]
    (a, wa), (b, wb) = (footprint(uv, size) for uv in sides)
    return Seams(np.concatenate([a, b], 1), np.concatenate([wa, -wb], 1))


def even_seams(values: np.ndarray, seams: Seams) -> np.ndarray:
    """A map whose two readings agree at every seam point within `TOLERANCE` of its range, or as near as they come.

    Parameters
    ----------
    values : (S, S, C) or (S, S), finite, at least 0

    Returns
    -------
    (S, S, C) or (S, S) : the map itself where nothing had to change; no value leaves the range of those given.
    """
    if not len(seams.texels) or not values.size:
        return values
    flat = values.reshape(len(values) ** 2, -1)
    scale = max(1.0, float(flat.max()))
    # Only texels that some seam point reads take part.
    touched, place = np.unique(seams.texels, return_inverse=True)
    place = place.reshape(seams.texels.shape)
    before = flat[touched].astype(np.float64)
    x = before.copy()
    squares = (seams.weights**2).sum(1)
    low, high = _range_shown(before, place, seams.weights)
    low, high = low - TOLERANCE * scale, high + TOLERANCE * scale
    for _ in range(PASSES):
        difference = np.einsum("nk,nkc->nc", seams.weights, x[place])
        # A point of the very same texels on both sides differs nowhere and has no say.
        wrong = (np.abs(difference) > TOLERANCE * scale).any(1) & (squares > 1e-9)
        if not wrong.any():
            break
        step = -difference[wrong] / squares[wrong, None]
        weights, at = seams.weights[wrong], place[wrong]
        # Averaged by how much a point has to do with a texel: one with weight zero must not slow it.
        share = np.bincount(at.ravel(), np.abs(weights).ravel(), minlength=len(x))
        for channel in range(x.shape[1]):
            change = np.abs(weights) * weights * step[:, channel, None]
            moved = np.bincount(at.ravel(), change.ravel(), minlength=len(x))
            x[:, channel] += np.divide(moved, share, out=np.zeros_like(moved), where=share > 1e-12)
        np.clip(x, low, high, out=x)
    changed = (x != before).any(1)
    if not changed.any():
        return values
    out = flat.copy()
    out[touched[changed]] = x[changed].clip(flat.min(), flat.max())
    return out.reshape(values.shape)


def _range_shown(x: np.ndarray, place: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest value (M, C) among the texels of any seam point that reads texel m, itself included."""
    read = weights != 0.0
    shown = x[place]
    least = np.where(read[..., None], shown, np.inf).min(1)
    greatest = np.where(read[..., None], shown, -np.inf).max(1)
    low, high = x.copy(), x.copy()
    for k in range(place.shape[1]):
        some = read[:, k]
        np.minimum.at(low, place[some, k], least[some])
        np.maximum.at(high, place[some, k], greatest[some])
    return low, high
