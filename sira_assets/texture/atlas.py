"""A texture atlas over a mesh: where each corner of each face lies in the picture.

Notation: T atlas vertices, F faces; uv in [0, 1]^2, origin bottom-left. Several atlas vertices may stand for one mesh
vertex (a seam); the mesh itself is never cut.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.texture.overlap import overlapping_pairs

# A chart narrower than this holds hardly a texel that bilinear reading does not mix with its padding.
_SLIVER_TEXELS = 4.0


@dataclass(frozen=True)
class AtlasReport:
    """How the atlas came about, and how good it is.

    Parameters
    ----------
    method : "uvatlas", "xatlas", "boxes", or several joined by " + "
    charts : connected pieces in the picture
    utilisation : share of the unit square that triangles cover
    seconds : time spent, tries that failed included
    stretch : area-weighted median of each face's texel density, worst over best axis (1: shape kept)
    attempts : one line for each method that was tried before and did not do, with the reason
    stretch_95 : the same at the 95th percentile
    sliver_share : share of the charts that are on average narrower than four texels
    overlapping : faces whose interior meets another's (copies of a face and faces of no area not counted)
    padding_texels : distance kept between charts; less than asked where they are too many for the picture
    predicted_s : what it was expected to cost, seconds on an idle machine of two cores
    """

    method: str
    charts: int
    utilisation: float
    seconds: float
    stretch: float
    attempts: tuple[str, ...] = ()
    stretch_95: float = 1.0
    sliver_share: float = 0.0
    overlapping: int = 0
    padding_texels: float = 0.0
    predicted_s: float = 0.0


@dataclass(frozen=True)
class Atlas:
    """Texture coordinates beside a mesh's own faces.

    Parameters
    ----------
    uv : (T, 2) float64 in [0, 1], origin bottom-left
    faces_uv : (F, 3) int64 indexing `uv`, corner by corner the mesh's `faces`
    report : AtlasReport
    """

    uv: np.ndarray
    faces_uv: np.ndarray
    report: AtlasReport

    def __post_init__(self):
        uv = np.ascontiguousarray(self.uv, np.float64).reshape(-1, 2)
        faces = np.ascontiguousarray(self.faces_uv, np.int64).reshape(-1, 3)
        if not np.isfinite(uv).all() or uv.min(initial=0.0) < 0.0 or uv.max(initial=0.0) > 1.0:
            raise InputError(
                expected="finite texture coordinates in [0, 1]",
                received=f"{int((~np.isfinite(uv)).any(1).sum())} not finite, range {uv.min():.4g} to {uv.max():.4g}",
                remedy="unwrap again",
            )
        if faces.size and (faces.min() < 0 or faces.max() >= len(uv)):
            raise InputError(
                expected=f"atlas indices below {len(uv)}", received=f"{faces.max()}", remedy="unwrap again"
            )
        object.__setattr__(self, "uv", uv)
        object.__setattr__(self, "faces_uv", faces)


def vertex_of_uv(mesh: TriangleMesh, atlas: Atlas) -> np.ndarray:
    """(T,) int64: the mesh vertex behind each atlas vertex.

    Raises
    ------
    InputError : the atlas is of another mesh, or one atlas vertex stands for two mesh vertices.
    """
    if len(mesh.faces) != len(atlas.faces_uv):
        raise InputError(
            expected=f"an atlas of {len(mesh.faces)} faces",
            received=f"one of {len(atlas.faces_uv)}",
            remedy="unwrap this mesh",
        )
    out = np.full(len(atlas.uv), -1)
    out[atlas.faces_uv] = mesh.faces
    if (out[atlas.faces_uv] != mesh.faces).any():
        raise InputError(
            expected="one mesh vertex for each atlas vertex", received="two for one", remedy="unwrap this mesh"
        )
    return out


def signed_uv_areas(uv: np.ndarray, faces_uv: np.ndarray) -> np.ndarray:
    """(F,) areas in the unit square, positive where a face keeps its orientation."""
    a, b, c = (uv[faces_uv[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    return 0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def chart_labels(faces_uv: np.ndarray, count: int) -> np.ndarray:
    """(count,) chart number of each atlas vertex, 0 up."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    a, b = faces_uv[:, [0, 1]].reshape(-1), faces_uv[:, [1, 2]].reshape(-1)
    return connected_components(coo_matrix((np.ones(len(a), bool), (a, b)), shape=(count, count)), directed=False)[1]


def border_edges(faces_uv: np.ndarray) -> np.ndarray:
    """(B,) edges that one face alone has, numbered 3 face + corner, the corner being the edge's first."""
    edges = np.sort(faces_uv[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
    _, first, times = np.unique((edges[:, 0] << 32) | edges[:, 1], return_index=True, return_counts=True)
    return first[times == 1]


def stretch(mesh: TriangleMesh, uv: np.ndarray, faces_uv: np.ndarray) -> np.ndarray:
    """(F,) ratio >= 1 of the largest to the smallest stretching of the map from each face to the picture.

    It is the ratio of the singular values of the 2x2 Jacobian (Sander et al. 2001, DOI 10.1145/383259.383307); inf for
    a face of no area in the picture.
    """
    high, determinant = _singular(mesh.vertices, mesh.faces, uv, faces_uv)
    return np.where(determinant > 0, high / np.maximum(determinant, 1e-300), np.inf)


def furthest_apart(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, faces_uv: np.ndarray) -> np.ndarray:
    """(F,) how far on the surface one unit of the picture reaches at most, on each face.

    The inverse of the Jacobian's smallest singular value; inf for a face of no area in the picture.
    """
    high, determinant = _singular(vertices, faces, uv, faces_uv)
    return np.where(determinant > 0, np.sqrt(high) / np.maximum(determinant, 1e-300), np.inf)


def _singular(
    vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, faces_uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of the Jacobian from each face to the picture: the square of the larger singular value; both multiplied."""
    corners = vertices[faces]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.maximum(np.linalg.norm(e1, axis=1), 1e-30)
    x2 = (e2 * e1).sum(1) / length
    y2 = np.linalg.norm(np.cross(e1, e2), axis=1) / length
    d1, d2 = uv[faces_uv[:, 1]] - uv[faces_uv[:, 0]], uv[faces_uv[:, 2]] - uv[faces_uv[:, 0]]
    du = d1 / length[:, None]
    dv = (d2 - du * x2[:, None]) / np.maximum(y2, 1e-30)[:, None]
    a, b, c = (du**2).sum(1), (du * dv).sum(1), (dv**2).sum(1)
    root = np.sqrt(np.maximum((a - c) ** 2 + 4 * b**2, 0.0))
    # The small singular value from the determinant: a + c - root cancels for thin faces.
    high = 0.5 * (a + c + root)
    determinant = np.abs(du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0])
    return high, determinant


def measure_atlas(
    mesh: TriangleMesh,
    uv: np.ndarray,
    faces_uv: np.ndarray,
    *,
    method: str,
    attempts: tuple[str, ...],
    padding_texels: float,
    texture_size: int,
    seconds: float,
    predicted_s: float,
) -> AtlasReport:
    """The report of an atlas; pieces of a mesh that is not welded count as charts of their own."""
    names, chart = np.unique(chart_labels(faces_uv, len(uv))[faces_uv[:, 0]], return_inverse=True)
    covered = np.abs(signed_uv_areas(uv, faces_uv))
    ratio = stretch(mesh, uv, faces_uv)
    weight = np.linalg.norm(face_cross_products(mesh.vertices, mesh.faces), axis=1)
    order = np.argsort(ratio)
    reached = np.cumsum(weight[order])
    median, high = (float(ratio[order[np.searchsorted(reached, q * reached[-1])]]) for q in (0.5, 0.95))
    # Twice the area over the border: the width of a long strip, half that of a square.
    width = (
        texture_size * 2.0 * np.bincount(chart, covered) / np.maximum(_borders(uv, faces_uv, chart, len(names)), 1e-300)
    )
    # Rounding of single precision, in which files keep coordinates, is no overlap.
    pairs = overlapping_pairs(uv, faces_uv, tolerance=1e-7)
    return AtlasReport(
        method=method,
        charts=len(names),
        utilisation=float(covered.sum()),
        seconds=seconds,
        stretch=median,
        attempts=attempts,
        stretch_95=high,
        sliver_share=float((width < _SLIVER_TEXELS).mean()),
        overlapping=len(np.unique(pairs)),
        padding_texels=padding_texels,
        predicted_s=predicted_s,
    )


def _borders(uv: np.ndarray, faces_uv: np.ndarray, chart: np.ndarray, count: int) -> np.ndarray:
    """(count,) length of each chart's border."""
    border = border_edges(faces_uv)
    face, corner = border // 3, border % 3
    length = np.linalg.norm(uv[faces_uv[face, corner]] - uv[faces_uv[face, (corner + 1) % 3]], axis=1)
    return np.bincount(chart[face], length, count)
