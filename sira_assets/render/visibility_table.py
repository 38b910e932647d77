"""Shadows of a light that moves: rays are cast once per surface, along directions that all points share.

Notation: w_k one of K directions, a_k the solid angle it stands for, V_pk = 1 where a ray from point p along w_k meets
nothing. A lobe's share is a ratio of sums over the directions above the point's horizon,

    S_pi = sum_k V_pk a_k (n_p . w_k)+ G_i(w_k) / sum_k a_k (n_p . w_k)+ G_i(w_k)

two small matrix products, differentiable in the lobes. Where nothing is hidden both sums are the same and S = 1.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.numerics.sg import sg_integral
from sira_assets.numerics.vector import squared_distance
from sira_assets.render.visibility import SurfaceVisibility, ray_offset
from sira_assets.scene.sg_light import SGLight

# S where a lobe gives a point less than this of what it would give head-on (times a_k): 1, for want of light to share.
_NO_LIGHT = 1e-12
LEAST_OF_A_LOBE = 8
# Rows summed at once: their table, a few megabytes as numbers, is then neither mapped anew nor out of the cache.
_ROWS_AT_ONCE = 1024


@dataclass(frozen=True)
class SharedDirections:
    """K unit directions and the solid angle (steradian) each stands for.

    Parameters
    ----------
    sharpest : lobes sharper than this are widened to it: between the directions they would be missed
    """

    directions: Float[Tensor, "k 3"]
    solid_angle: Float[Tensor, " k"]
    sharpest: float


def even_directions(count: int, *, device: str | torch.device = "cpu") -> SharedDirections:
    """Directions spread evenly over the sphere (Fibonacci's lattice).

    A gaussian whose width 1 / sqrt(lambda) is half the directions' distance sqrt(4 pi / K) is still summed to 1 %
    (2 exp(-2 pi^2 / 4), by Poisson's sum), hence sharpest = K / pi.
    """
    index = torch.arange(count, dtype=torch.float64) + 0.5
    height = 1.0 - 2.0 * index / count
    directions = _around_z(height, index * math.pi * (3.0 - 5.0**0.5)).float().to(device)
    return SharedDirections(directions, torch.full((count,), 4.0 * math.pi / count, device=device), count / math.pi)


def aimed_directions(
    axis: Float[Tensor, "m 3"], sharpness: Float[Tensor, " m"], amplitude: Float[Tensor, "m 3"], count: int
) -> SharedDirections:
    """`count` directions for a light: a quarter over the sphere, the others from its lobes, each as its flux deserves.

    What a direction stands for is 1 / sum_j n_j p_j(w), with n_j drawn by density p_j: the balance heuristic (Veach and
    Guibas 1995, DOI 10.1145/218380.218498), under which lobes that change a little are still summed well.

    Parameters
    ----------
    count : at least 16 more than 8 for each lobe
    """
    with torch.no_grad():
        even = count // 4
        flux = sg_integral(sharpness, amplitude).mean(-1).double()
        ends = (flux.cumsum(0) / flux.sum().clamp_min(1e-30) * (count - even - LEAST_OF_A_LOBE * len(flux))).round()
        ends = ends.long().tolist()
        counts = [LEAST_OF_A_LOBE + b - a for a, b in zip([0, *ends[:-1]], ends, strict=True)]
        even += count - even - sum(counts)  # all of them where the light is nothing
        lobes = list(zip(axis.double(), sharpness.double().clamp_min(1e-6), counts, strict=True))
        parts = [even_directions(even, device=axis.device).directions.double()]
        for xi, lam, n in lobes:
            index = torch.arange(n, dtype=torch.float64, device=axis.device) + 0.5
            height = 1.0 + torch.log1p(torch.expm1(-2.0 * lam) * index / n) / lam
            parts.append(_around_z(height.clamp(-1.0, 1.0), index * math.pi * (3.0 - 5.0**0.5)) @ _frame(xi))
        directions = torch.cat(parts)
        density = torch.full((count,), even / (4.0 * math.pi), dtype=torch.float64, device=axis.device)
        for xi, lam, n in lobes:
            lobe = torch.exp(-0.5 * lam * squared_distance(directions, xi))
            density += n * lobe * lam / (2.0 * math.pi * -torch.expm1(-2.0 * lam))
    return SharedDirections(directions.float(), (1.0 / density).float(), math.inf)


def _around_z(height: Tensor, azimuth: Tensor) -> Tensor:
    flat = torch.sqrt((1.0 - height * height).clamp_min(0.0))
    return torch.stack([flat * torch.cos(azimuth), flat * torch.sin(azimuth), height], -1)


def _frame(axis: Tensor) -> Tensor:
    """(3, 3) rows: two tangents and the axis."""
    other = torch.zeros_like(axis)
    other[int(axis.abs().argmin())] = 1.0
    side = torch.nn.functional.normalize(torch.linalg.cross(other, axis), dim=0)
    return torch.stack([side, torch.linalg.cross(axis, side), axis])


@dataclass(frozen=True)
class VisibilityTable:
    """What N points see of K shared directions.

    Parameters
    ----------
    shared : the directions
    normals : (N, 3)
    packed : (N, K / 8) one bit a direction, the highest first
    """

    shared: SharedDirections
    normals: Float[Tensor, "n 3"]
    packed: UInt8[Tensor, "n b"]

    def share(self, rows: Tensor, axis: Float[Tensor, "m 3"], sharpness: Float[Tensor, " m"]) -> Float[Tensor, "r m"]:
        """S of some of the points; lobes in the points' frame, gradients to them."""
        return torch.cat([self._share(some, axis, sharpness) for some in rows.split(_ROWS_AT_ONCE)])

    def _share(self, rows: Tensor, axis: Tensor, sharpness: Tensor) -> Tensor:
        w = self.shared.directions
        limit = 1.0 / self.shared.sharpest
        widened = sharpness / (1.0 + sharpness * limit)
        lobes = torch.exp(-0.5 * widened * squared_distance(w.unsqueeze(-2), axis))  # (K, M)
        received = (self.normals[rows] @ w.mT).clamp_min_(0.0).mul_(self.shared.solid_angle)
        reached = received * self._seen(rows)
        return (reached @ lobes + _NO_LIGHT) / (received @ lobes + _NO_LIGHT)

    def _seen(self, rows: Tensor) -> Tensor:
        """(R, K) 0 or 1. By a table of the bytes' bits: three times as fast as masks and shifts."""
        bits = ((torch.arange(256)[:, None] >> torch.arange(7, -1, -1)) & 1).float().to(self.packed.device)
        seen = bits.index_select(0, self.packed[rows].int().flatten())
        return seen.view(len(rows), -1)[:, : len(self.shared.directions)]


def visibility_table(
    raycaster: Raycaster,
    points: np.ndarray,
    normals: Float[Tensor, "n 3"],
    shared: SharedDirections,
    *,
    offset: float | None = None,
) -> VisibilityTable:
    """Cast one ray from each point along every shared direction above its horizon.

    Rays of one direction are cast together: from points in the order of a picture they are coherent, several times as
    fast as rays in all directions.

    Parameters
    ----------
    points : (N, 3) in the raycaster's frame, near its surface
    normals : (N, 3) unit, same frame
    offset : how far along the normal a ray starts; `ray_offset` of the raycaster's mesh if None
    """
    points, outward = np.asarray(points, np.float64), normals.detach().cpu().numpy().astype(np.float64)
    origins = points + (ray_offset(raycaster.mesh) if offset is None else offset) * outward
    directions = shared.directions.cpu().numpy().astype(np.float64)
    packed = np.zeros((len(points), -(-len(directions) // 8)), np.uint8)
    for byte in range(packed.shape[1]):
        for bit, w in enumerate(directions[8 * byte : 8 * byte + 8]):
            above = np.flatnonzero(outward @ w > 0.0)
            seen = above[~raycaster.occluded(origins[above], w)]
            packed[seen, byte] |= np.uint8(128 >> bit)
    return VisibilityTable(shared, normals, torch.from_numpy(packed).to(normals.device))


def shared_visibility(
    raycaster: Raycaster,
    points: np.ndarray,
    normals: np.ndarray,
    axis: np.ndarray,
    sharpness: np.ndarray,
    amplitude: np.ndarray,
    *,
    directions: int = 256,
    offset: float | None = None,
) -> np.ndarray:
    """What `lobe_visibility` gives, (N, M) float32, by directions that are aimed at the light and shared by all points.

    The rays do not multiply with the lobes, and each lobe is seen as finely as its flux deserves; the error is a smooth
    function of the point instead of grain.

    Parameters
    ----------
    amplitude : (M, 3) of the lobes, which decides how many directions each gets
    """
    lobes = tuple(torch.as_tensor(np.array(a), dtype=torch.float32) for a in (axis, sharpness, amplitude))
    if not len(lobes[1]):
        return np.ones((len(points), 0), np.float32)
    outward = torch.as_tensor(np.array(normals), dtype=torch.float32)
    shared = aimed_directions(*lobes, max(directions, 16 + 16 * len(lobes[1])))
    with torch.no_grad():
        table = visibility_table(raycaster, points, outward, shared, offset=offset)
        return table.share(torch.arange(len(outward)), *lobes[:2]).numpy()


def surface_visibility(
    mesh_canonical: TriangleMesh, light: SGLight, canonical_from_world: np.ndarray, *, directions: int = 256
) -> SurfaceVisibility:
    """What the vertices of a head's surface see of the light in its world."""
    lobes = canonical_light(light, canonical_from_world)
    share = shared_visibility(
        Raycaster(mesh_canonical),
        mesh_canonical.vertices,
        mesh_canonical.normals,
        lobes.axis,
        lobes.sharpness,
        lobes.amplitude,
        directions=directions,
    )
    return SurfaceVisibility(mesh_canonical, share)


def canonical_light(light: SGLight, canonical_from_world: np.ndarray) -> SGLight:
    """The light with its axes in the canonical frame, of a (4, 4) similarity."""
    linear = np.asarray(canonical_from_world, np.float64)[:3, :3]
    return light.rotated(linear / np.cbrt(np.linalg.det(linear)))
