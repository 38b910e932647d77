"""What a bake is measured by: a material that is known everywhere, and how a baked map of it reads.

Notation: x canonical metres; red a smooth wave, green a checker of cubes, blue linear in x. A viewer reads maps
bilinearly; the checker is read by the texel that holds the point, so that reading adds no blur of its own.
"""

from dataclasses import dataclass

import numpy as np
import torch

from sira_assets.fields.head_field import HeadField
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.texture.atlas import Atlas
from sira_assets.texture.reading import bilinear
from sira_assets.texture.seams import seam_edges

WAVE_M, CUBE_M = 0.1, 0.01
_WAVE = torch.nn.functional.normalize(torch.tensor([1.0, 2.0, -1.5]), dim=0)
# Cubes start off the planes of symmetry.
_SHIFT_M = 0.0013


@dataclass(frozen=True)
class KnownMaterial:
    """Another head's surface under the known material."""

    base: HeadField

    def sdf(self, x_canonical: torch.Tensor) -> torch.Tensor:
        """The head's own."""
        return self.base.sdf(x_canonical)

    def material(self, x_canonical: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The wave, the checker and the linear function; F0 of skin."""
        wave = 0.5 + 0.5 * torch.sin(2.0 * torch.pi / WAVE_M * (x_canonical @ _WAVE))
        cubes = torch.floor((x_canonical + _SHIFT_M) / CUBE_M).sum(-1)
        colours = torch.stack([wave, torch.remainder(cubes, 2.0), 0.5 + x_canonical[:, 1]], -1)
        return colours, torch.full_like(wave, 0.028)


def known_colours(points: np.ndarray) -> np.ndarray:
    """(N, 3) the known material at points (N, 3)."""
    x = torch.as_tensor(points, dtype=torch.float64)
    wave = 0.5 + 0.5 * torch.sin(2.0 * torch.pi / WAVE_M * (x @ _WAVE.double()))
    cubes = torch.floor((x + _SHIFT_M) / CUBE_M).sum(-1)
    return torch.stack([wave, torch.remainder(cubes, 2.0), 0.5 + x[:, 1]], -1).numpy()


def holding(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(N, C) the texel that holds each point."""
    size = len(texture)
    row, column = ((1.0 - uv[:, 1]) * size).astype(int), (uv[:, 0] * size).astype(int)
    return texture[np.clip(row, 0, size - 1), np.clip(column, 0, size - 1)]


def seam_points(mesh: TriangleMesh, atlas: Atlas, per_edge: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """uv (N, 2) of the same points on both sides of every seam."""
    t = ((np.arange(per_edge) + 0.5) / per_edge)[None, :, None]
    sides = [(a[:, :1] + t * (a[:, 1:] - a[:, :1])).reshape(-1, 2) for a in seam_edges(mesh, atlas)]
    return sides[0], sides[1]


@dataclass(frozen=True)
class SurfacePoints:
    """Points of a mesh.

    Parameters
    ----------
    face : (N,) that holds each
    x : (N, 3)
    uv : (N, 2)
    """

    face: np.ndarray
    x: np.ndarray
    uv: np.ndarray

    def some(self, chosen: np.ndarray, x: np.ndarray) -> "SurfacePoints":
        """Those chosen, on another surface."""
        return SurfacePoints(self.face[chosen], x[chosen], self.uv[chosen])


def surface_points(mesh: TriangleMesh, atlas: Atlas, count: int, seed: int = 0) -> SurfacePoints:
    """Random points, even in area."""
    rng = np.random.default_rng(seed)
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), count)[..., None]
    return SurfacePoints(face, (corners[face] * weights).sum(1), (atlas.uv[atlas.faces_uv[face]] * weights).sum(1))


def longest_side(mesh: TriangleMesh, atlas: Atlas, size: int) -> np.ndarray:
    """(F,) metres that a texel's side covers on each face, where it is stretched most."""
    x, uv = mesh.vertices[mesh.faces], atlas.uv[atlas.faces_uv]
    dx, duv = (np.stack([c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]], -1) for c in (x, uv))
    return np.linalg.svd(dx @ np.linalg.pinv(duv), compute_uv=False)[:, 0] / size


def bake_figures(texture: np.ndarray, mesh: TriangleMesh, atlas: Atlas, points: SurfacePoints) -> dict:
    """Figures of one baked map (S, S, 3) of the known material, held to what it is to show at `points`.

    Notes
    -----
    A texel is as large as its chart is stretched there: "texels" are of the mean size over the atlas, "own texels" of
    the longest side that the texel itself has on the surface.
    """
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    texel = float(np.sqrt(area / atlas.report.utilisation) / len(texture))
    exact, uv = points.x, points.uv
    true = known_colours(exact)
    one, other = seam_points(mesh, atlas)
    seam = np.abs(bilinear(texture, one) - bilinear(texture, other))[:, 0]
    wave = np.abs(bilinear(texture, uv)[:, 0] - true[:, 0])
    wrong = np.abs(holding(texture, uv)[:, 1] - true[:, 1]) > 0.5
    to_plane = np.abs(np.mod((exact[wrong] + _SHIFT_M) / CUBE_M + 0.5, 1.0) - 0.5).min(1) * CUBE_M
    side = longest_side(mesh, atlas, len(texture))[points.face]
    own = to_plane / side[wrong]
    return {
        "texel, mm": 1e3 * texel,
        "seam points": len(seam),
        "seam difference of the wave, codes of 255: 99 %": 255 * float(np.percentile(seam, 99)),
        "seam difference of the wave, codes of 255: greatest": 255 * float(seam.max()),
        "seam points within 1 code, %": 100 * float((seam <= 1 / 255).mean()),
        "wave off, in texels of its steepest slope: 99 %": float(np.percentile(wave, 99) / (np.pi / WAVE_M * texel)),
        "wave off, in texels of its steepest slope: greatest": float(wave.max() / (np.pi / WAVE_M * texel)),
        "wave off, in own texels of its steepest slope: greatest": float((wave / side).max() / (np.pi / WAVE_M)),
        "checker wrong, % of points": 100 * float(wrong.mean()),
        "checker wrong furthest from an edge, texels": float(to_plane.max(initial=0.0)) / texel,
        "checker wrong furthest from an edge, own texels": float(own.max(initial=0.0)),
        "checker wrong beyond one texel, points": int((to_plane > texel).sum()),
        "checker wrong beyond one own texel, points": int((own > 1.0).sum()),
    }
