"""The fitted surface as the photo sees it, and as it does not.

Notation: as in fields/sa_sm.py; network units, canonical frame.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor, nn

from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.sa_sm import sdf_and_gradient
from sira_assets.fit.geometry import GeometryFit
from sira_assets.fit.pixels import PixelRays, mask_rays, pixels_per_metre
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.render.tracing import GRAZING
from sira_assets.scene.canonical import transform_points
from sira_assets.scene.portrait import Portrait

# From a triangle to the zero set: the first step leaves about the square of what a cell is off, the second nothing that
# single precision shows. A step is never longer than the largest cell.
NEWTON_STEPS = 2
FARTHEST_STEP = 0.004 / UNIT_M
# How far from what is seen hidden points are drawn more densely; the refinement's shortest wave is 3 mm.
BESIDE_M = 0.015
# A mask is cut through the head, rather than ended by its outline, where the fitted surface goes on for this far.
CUT_BEYOND_M = 0.006


@dataclass(frozen=True)
class SurfacePoints:
    """What the camera sees of the fitted surface, one row a pixel, in network units and the canonical frame."""

    x: Tensor
    normals: Tensor
    view: Tensor
    x_ref: Tensor
    gamma: Tensor
    rays: PixelRays

    def __len__(self) -> int:
        return len(self.x)

    def rows(self, index: Tensor) -> "SurfacePoints":
        """Some of the points."""
        tensors = (self.x, self.normals, self.view, self.x_ref, self.gamma)
        return SurfacePoints(*(t[index] for t in tensors), self.rays.select(index))


def visible_surface(
    portrait: Portrait,
    geometry: GeometryFit,
    surface: Raycaster,
    *,
    at_most: int | None = None,
    generator: torch.Generator | None = None,
    chunk: int = 16384,
) -> SurfacePoints:
    """Where the mask's pixels (a random `at_most` of them, in the picture's order) see the fitted surface.

    Triangles give each ray its hit to within a cell, and Newton steps along the ray bring it onto the zero set: what
    sphere tracing finds, at a tenth of its evaluations. Rays that miss are left out.

    Parameters
    ----------
    surface : the fitted surface as triangles, canonical metres
    """
    posed = replace(portrait, canonical_from_world=geometry.canonical_from_world)
    rays = mask_rays(posed, device=geometry.z_sdf.device)
    if at_most is not None and len(rays) > at_most:
        chosen = torch.randperm(len(rays), generator=generator, device=rays.origins.device)[:at_most]
        rays = rays.select(chosen.sort().values)
    hits = surface.cast(UNIT_M * rays.origins.double().cpu().numpy(), rays.directions.double().cpu().numpy())
    rays = rays.select(torch.as_tensor(np.flatnonzero(hits.hit), device=rays.origins.device))
    ts = torch.as_tensor(hits.t[hits.hit] / UNIT_M, dtype=rays.origins.dtype, device=rays.origins.device)
    parts: list[list[Tensor]] = [[], [], [], []]
    for origins, directions, t in zip(*(c.split(chunk) for c in (rays.origins, rays.directions, ts)), strict=True):
        best = _at(geometry, origins + t[:, None] * directions)
        for _ in range(NEWTON_STEPS):
            f, x, gradient = best[:3]
            slope = (gradient * directions).sum(-1, keepdim=True).clamp_max(-GRAZING)
            trial = _at(geometry, x - (f / slope).clamp(-FARTHEST_STEP, FARTHEST_STEP) * directions)
            # Where a triangle is not of the zero set (a cap, a hole that was closed) there is none to be found.
            nearer = trial[0].abs() < f.abs()
            best = [torch.where(nearer, new, old) for new, old in zip(trial, best, strict=True)]
        _, x, gradient, x_ref, gamma = best
        for column, value in zip(parts, (x, nn.functional.normalize(gradient, dim=-1), x_ref, gamma), strict=True):
            column.append(value)
    x, normals, x_ref, gamma = (torch.cat(column) for column in parts)
    return SurfacePoints(x, normals, -rays.directions, x_ref, gamma, rays)


def cut_region(portrait: Portrait, geometry: GeometryFit, surface: Raycaster) -> Bool[np.ndarray, "H W"]:
    """Pixels along a cut, where the mask ends, as at a collar, and the fitted head goes on: the mask's last ones, and
    those beyond.

    Such a last pixel shows in part what was cut off, and its colour would stay as a line on the surface.
    """
    from scipy import ndimage

    reach = max(2, round(0.5 * CUT_BEYOND_M * pixels_per_metre(portrait)))
    # With room around, for a mask may end near the picture's border; where it meets the border nothing is cut off.
    room = 3 * reach
    mask = np.pad(ndimage.binary_fill_holes(portrait.mask), room)
    rows, columns = np.nonzero(mask)
    box = tuple(slice(max(i.min() - room, 0), i.max() + room + 1) for i in (rows, columns))
    mask = mask[box]
    rows, columns = np.nonzero(~mask & (ndimage.distance_transform_edt(~mask) <= room))
    pixels = np.stack([columns + box[1].start, rows + box[0].start], 1) - room + 0.5
    origins, directions = portrait.camera.rays_world(pixels)
    directions = directions @ geometry.canonical_from_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    beyond = np.zeros_like(mask)
    beyond[rows, columns] = surface.cast(transform_points(geometry.canonical_from_world, origins), directions).hit
    # A strip of surface beside the mask is an outline that was not met exactly: only what is wide remains, with the
    # corners between cut and outline, which no disc reaches.
    wide = ndimage.distance_transform_edt(beyond) > reach
    if wide.any():
        wide = beyond & (ndimage.distance_transform_edt(~wide) <= reach)
        wide = ndimage.binary_dilation(wide, iterations=2 * reach, mask=beyond)
    whole = np.zeros([n + 2 * room for n in portrait.mask.shape], bool)
    whole[box] = wide
    inside = whole[room:-room, room:-room]
    return inside | portrait.mask & ndimage.binary_dilation(inside)


def _at(geometry: GeometryFit, x: Tensor) -> list[Tensor]:
    """f (N, 1), x, gradient, x_ref and gamma at x."""
    f, gradient, x_ref, gamma = sdf_and_gradient(geometry.shape, x, geometry.z_sdf, differentiable=False)
    return [v.detach() for v in (f[:, None], x, gradient, x_ref, gamma)]


@torch.no_grad()
def hidden_surface(
    portrait: Portrait,
    geometry: GeometryFit,
    surface: TriangleMesh,
    seen: SurfacePoints,
    cut: Bool[np.ndarray, "H W"],
    generator: torch.Generator,
    count: int = 4096,
) -> tuple[Tensor, Tensor]:
    """x_ref and gamma of surface points of which the photo says nothing: there the refinement is to be nothing.

    Middles of faces, drawn by area, that face away from the camera or are seen beside the mask, more than two pixels
    from it or in `cut`; a hole in the mask is bridged by what is around it. First `count` of them anywhere, then as
    many (or none) within BESIDE_M of what is seen, where the refinement's shortest waves would go on at random between
    points that are few.

    Parameters
    ----------
    surface : the fitted surface, canonical metres
    seen : what the refinement learns from
    cut : see `cut_region`
    """
    from scipy.spatial import cKDTree

    device = geometry.z_sdf.device
    normals = face_cross_products(surface.vertices, surface.faces)
    hidden = _hidden_faces(portrait, geometry, surface, normals, cut)
    middles = surface.vertices[surface.faces[hidden]].mean(1)
    gap, _ = cKDTree(seen.x.double().cpu().numpy() * UNIT_M).query(middles, distance_upper_bound=BESIDE_M)
    area = np.linalg.norm(normals[hidden], axis=1)
    anywhere, beside = (
        _drawn_by_area(torch.as_tensor(a, device=device), count, generator) for a in (area, area * (gap < BESIDE_M))
    )
    x = torch.as_tensor(middles[np.concatenate([anywhere, beside])] / UNIT_M, dtype=torch.float32, device=device)
    delta, gamma = geometry.shape.deform(x, geometry.z_sdf)
    return x + delta, gamma


def _hidden_faces(
    portrait: Portrait, geometry: GeometryFit, surface: TriangleMesh, normals: np.ndarray, cut: np.ndarray
) -> np.ndarray:
    """Which faces the photo does not show; all of them if it shows every one."""
    posed = replace(portrait, canonical_from_world=geometry.canonical_from_world)
    away, beside = _unseen(posed, surface.vertices[surface.faces].mean(1), normals, cut)
    hidden = np.flatnonzero(away | beside)
    return hidden if len(hidden) else np.arange(len(normals))


def _drawn_by_area(area: Tensor, count: int, generator: torch.Generator) -> np.ndarray:
    """`count` indices drawn with replacement as `area` says; none where there is none."""
    if not bool((area > 0).any()):
        return np.zeros(0, int)
    return torch.multinomial(area, count, replacement=True, generator=generator).cpu().numpy()


def _unseen(portrait: Portrait, x_m: np.ndarray, normals: np.ndarray, cut: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) bool each of canonical points: facing away from the camera; seen beside the mask, along a cut or beyond the
    picture."""
    from scipy import ndimage

    centre = transform_points(portrait.canonical_from_world, portrait.camera.world_from_camera[None, :3, 3])
    to_camera = centre - x_m
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(to_camera, axis=1)
    cosine = (normals * to_camera).sum(1) / np.maximum(lengths, 1e-12)
    mask = ndimage.binary_dilation(ndimage.binary_fill_holes(portrait.mask), iterations=2) & ~cut
    pixel, depth = portrait.camera.project(transform_points(portrait.world_from_canonical, x_m))
    column, row = np.floor(np.clip(pixel, -1, [portrait.camera.width, portrait.camera.height])).astype(int).T
    inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1]) & (depth > 0)
    in_mask = np.zeros(len(x_m), bool)
    in_mask[inside] = mask[row[inside], column[inside]]
    return cosine < -0.05, ~in_mask
