"""A texture atlas over a mesh: where each corner of each face lies in the picture.

Notation: T atlas vertices, F faces; uv in [0, 1]^2, origin bottom-left. Several atlas vertices may stand for one mesh
vertex (a seam); the mesh itself is never cut.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh


@dataclass(frozen=True)
class AtlasReport:
    """How the atlas came about.

    Parameters
    ----------
    method : "xatlas", "uvatlas" or "boxes"
    charts : connected pieces in the picture
    utilisation : share of the unit square that triangles cover
    seconds : time spent, tries that failed included
    stretch : area-weighted median of each face's texel density, worst over best axis (1: shape kept)
    attempts : one line for each method that was tried before and did not do, with the reason
    """

    method: str
    charts: int
    utilisation: float
    seconds: float
    stretch: float
    attempts: tuple[str, ...] = ()


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


def stretch(mesh: TriangleMesh, uv: np.ndarray, faces_uv: np.ndarray) -> np.ndarray:
    """(F,) ratio >= 1 of the largest to the smallest stretching of the map from each face to the picture.

    It is the ratio of the singular values of the 2x2 Jacobian (Sander et al. 2001, DOI 10.1145/383259.383307); inf for
    a face of no area in the picture.
    """
    corners = mesh.vertices[mesh.faces]
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
    return np.where(determinant > 0, high / np.maximum(determinant, 1e-300), np.inf)
