"""Cast shadows: the share of each lobe's light that reaches a surface point, by ray casting.

Notation: S_i(p) = int G_i(w) max(n . w, 0) V(p, w) dw / int G_i(w) max(n . w, 0) dw, with V = 1 where nothing stands
between p and the distant light, else 0. So `irradiance(..., visibility=S)` is exact under shadows. Ambient occlusion is
S of a constant light (lambda = 0).
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.render.lobe_sampling import lobe_rays

# Rays held at once: their coordinates stay in a core's cache.
RAYS_AT_ONCE = 1 << 17
# Rays start this share of the mesh's median edge off the surface: at 2 mm edges and 5 mm radius, twice the distance
# between chord and arc, where a ray from the arc could meet the chord.
OFFSET_OF_EDGE = 0.1


def ray_offset(mesh: TriangleMesh) -> float:
    """How far off the surface shadow rays start, in the mesh's unit."""
    edges = mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, 1)]
    size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    # 1e-6 of the size: ten times what single precision resolves.
    return max(OFFSET_OF_EDGE * float(np.median(np.linalg.norm(edges, axis=-1))), 1e-6 * size)


def lobe_visibility(
    raycaster: Raycaster,
    points: np.ndarray,
    normals: np.ndarray,
    axis: np.ndarray,
    sharpness: np.ndarray,
    *,
    rays: int = 64,
    seed: int = 0,
    offset: float | None = None,
) -> np.ndarray:
    """The share of each lobe's cosine-weighted light that reaches each point.

    Directions are drawn in proportion to G_i(w) max(n . w, 0) itself, from an even set that is shifted from
    point to point; the share is the mean over them. Where a shadow's edge crosses the lobe the
    error is about 0.4 rays^-0.75 (RMS 0.017 at 64 rays); where all or nothing is hidden there is none.

    Parameters
    ----------
    raycaster : the surface that casts shadows
    points : (N, 3) on that surface, in its frame
    normals : (N, 3) unit, outward
    axis : (M, 3) unit, in the same frame, towards the light
    sharpness : (M,) 0 to 1e8
    rays : rays per point and lobe
    seed : of the shifts
    offset : how far along the normal a ray starts; `ray_offset` of the raycaster's mesh if None

    Returns
    -------
    (N, M) float32 in [0, 1]
    """
    points, normals = (np.asarray(a, np.float64).reshape(-1, 3) for a in (points, normals))
    axis, sharpness = np.asarray(axis, np.float64).reshape(-1, 3), np.asarray(sharpness, np.float64).reshape(-1)
    out = np.ones((len(points), len(sharpness)), np.float32)
    origins = points + (ray_offset(raycaster.mesh) if offset is None else offset) * normals
    at_once = max(1, RAYS_AT_ONCE // rays)
    for i in range(len(sharpness)):
        table = lobe_rays(float(sharpness[i]), rays, seed=seed + i)
        # Neighbours get different shifts: what is left of the error is fine grain, not bands.
        pattern = np.random.default_rng((seed, i)).integers(table.azimuth.shape[1], size=len(points))
        for start in range(0, len(points), at_once):
            rows = slice(start, start + at_once)
            directions = table.directions(normals[rows], axis[i], pattern[rows])
            hidden = raycaster.occluded(np.repeat(origins[rows], rays, 0), directions.reshape(-1, 3))
            out[rows, i] = 1.0 - hidden.reshape(-1, rays).mean(1)
    return out


def ambient_occlusion(
    raycaster: Raycaster,
    points: np.ndarray,
    normals: np.ndarray,
    *,
    rays: int = 64,
    seed: int = 0,
    offset: float | None = None,
) -> np.ndarray:
    """The share (N,) of a constant light's irradiance that reaches each point; as `lobe_visibility`."""
    up = np.array([[0.0, 0.0, 1.0]])
    return lobe_visibility(raycaster, points, normals, up, np.zeros(1), rays=rays, seed=seed, offset=offset)[:, 0]


@dataclass(frozen=True)
class SurfaceVisibility:
    """The shares of a light's lobes at a mesh's vertices, for whatever is shaded on that surface.

    Parameters
    ----------
    mesh : its triangles; shares are linear over each
    share : (V, M) float32
    """

    mesh: TriangleMesh
    share: np.ndarray

    def at(self, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """(N, M) at points of given faces (N,) and weights (N, 3)."""
        return np.einsum("nkm,nk->nm", self.share[self.mesh.faces[face]], barycentric.astype(np.float32))

    def near(self, raycaster: Raycaster, points: np.ndarray) -> np.ndarray:
        """(N, M) at the points of the mesh nearest to (N, 3) points; the raycaster is of this mesh."""
        closest = raycaster.closest(points)
        a, b, c = (self.mesh.vertices[self.mesh.faces[closest.face, k]] for k in range(3))
        u, v, w = b - a, c - a, closest.points - a
        uu, uv, vv, wu, wv = ((p * q).sum(1) for p, q in ((u, u), (u, v), (v, v), (w, u), (w, v)))
        area = np.maximum(uu * vv - uv * uv, 1e-300)
        second, third = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
        weights = np.clip(np.stack([1.0 - second - third, second, third], 1), 0.0, 1.0)
        return self.at(closest.face, weights / weights.sum(1, keepdims=True))
