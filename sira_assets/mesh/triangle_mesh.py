"""A triangle mesh: what every later stage hands on.

Notation: V vertices, F faces; faces index vertices, counter-clockwise seen from outside.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.canonical import transform_points


@dataclass(frozen=True)
class TriangleMesh:
    """Welded triangles; texture seams live in the atlas, never here.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int64, outward
    normals : (V, 3) float64 unit vertex normals, or None for the angle-weighted mean of the faces'
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None

    def __post_init__(self):
        vertices = np.ascontiguousarray(self.vertices, np.float64).reshape(-1, 3)
        faces = np.ascontiguousarray(self.faces, np.int64).reshape(-1, 3)
        if not np.isfinite(vertices).all():
            raise InputError(
                expected="finite vertices",
                received=f"{int((~np.isfinite(vertices)).any(1).sum())} vertices with NaN or inf",
                remedy="repair the mesh",
            )
        if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise InputError(
                expected=f"face indices below {len(vertices)}",
                received=f"indices {faces.min()} to {faces.max()}",
                remedy="repair the mesh",
            )
        normals = self.normals
        if normals is None:
            normals = vertex_normals(vertices, faces)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "normals", np.ascontiguousarray(normals, np.float64).reshape(-1, 3))

    def transformed(self, similarity: np.ndarray) -> "TriangleMesh":
        """The mesh under a (4, 4) similarity without reflection."""
        rotation = similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3]))
        return TriangleMesh(transform_points(similarity, self.vertices), self.faces, self.normals @ rotation.T)


def face_cross_products(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) cross products of two edges: twice the area times the outward normal."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) angle-weighted unit vertex normals (Thuermer and Wuethrich 1998, DOI 10.1080/10867651.1998.10487487).

    Vertices of no face, or of faces of no area, get (0, 0, 1).
    """
    import igl

    out = np.zeros_like(vertices)
    sound = faces[np.linalg.norm(face_cross_products(vertices, faces), axis=1) > 0.0] if len(faces) else faces
    if len(sound):
        out = igl.per_vertex_normals(vertices, sound, igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE)
    return np.where(np.isfinite(out).all(1, keepdims=True) & (out != 0.0).any(1, keepdims=True), out, [0.0, 0.0, 1.0])
