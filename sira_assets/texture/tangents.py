"""The tangent frame in which a normal map is written and read.

Notation: n the mesh's vertex normal, t the direction in which u grows, w = +1 or -1 with bitangent b = w n x t, the
direction in which v grows. Faces are averaged by corner angle and t is made orthogonal to n at each vertex, as in
MikkTSpace (Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited"), on the vertices
that the atlas has already split.
"""

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.texture.atlas import Atlas, signed_uv_areas, vertex_of_uv


def tangents(mesh: TriangleMesh, atlas: Atlas) -> np.ndarray:
    """(T, 4) float64: unit tangent orthogonal to the vertex normal, and handedness w of +1 or -1.

    The same array serves the bake and the file, so a viewer decodes what was encoded. Atlas vertices whose faces
    have no area in the picture get any tangent orthogonal to the normal.
    """
    normal = mesh.normals[vertex_of_uv(mesh, atlas)]
    corners, uv = mesh.vertices[mesh.faces], atlas.uv[atlas.faces_uv]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    sign = np.sign(signed_uv_areas(atlas.uv, atlas.faces_uv))
    along_u = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) * sign[:, None]  # dp/du times a positive factor
    total, hand = np.zeros_like(normal), np.zeros(len(normal))
    for k in range(3):
        index = atlas.faces_uv[:, k]
        n = normal[index]
        flat = along_u - n * (along_u * n).sum(1, keepdims=True)
        length = np.linalg.norm(flat, axis=1, keepdims=True)
        unit = np.where(length > 1e-30, flat / np.maximum(length, 1e-300), 0.0)
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(1))
        for axis in range(3):
            total[:, axis] += np.bincount(index, unit[:, axis] * angle, len(normal))
        hand += np.bincount(index, sign * angle, len(normal))
    total -= normal * (total * normal).sum(1, keepdims=True)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    out = np.where(length > 1e-9, total / np.maximum(length, 1e-300), any_orthogonal(normal))
    return np.column_stack([out, np.where(hand < 0, -1.0, 1.0)])


def any_orthogonal(normals: np.ndarray) -> np.ndarray:
    """(N, 3) unit vectors orthogonal to unit vectors (N, 3): the axis least along each, made orthogonal."""
    axis = np.eye(3)[np.abs(normals).argmin(1)]
    out = axis - normals * (axis * normals).sum(1, keepdims=True)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def to_tangent_space(vectors: np.ndarray, normal: np.ndarray, tangent: np.ndarray, hand: np.ndarray) -> np.ndarray:
    """Write unit vectors in the frame a viewer will have: x t + y b + z n, with t, n interpolated and normalised.

    The interpolated t and n are not quite orthogonal; the 3 x 3 system is solved, so that decoding is exact.

    Parameters
    ----------
    vectors, normal, tangent : (N, 3); hand : (N,)

    Returns
    -------
    (N, 3) unit.
    """
    n = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    t = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    b = hand[:, None] * np.cross(n, t)
    length = np.linalg.norm(b, axis=1, keepdims=True)
    # Tangents of one chart that meet head-on interpolate to nothing, or along n: there any frame will do.
    lost = (length < 1e-3)[:, 0]
    t[lost] = any_orthogonal(n[lost])
    b[lost] = hand[lost, None] * np.cross(n[lost], t[lost])
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    # b is orthogonal to both t and n, so only the pair (t, n) is coupled, by the cosine c between them.
    c = (t * n).sum(1)
    vt, vn, y = (vectors * t).sum(1), (vectors * n).sum(1), (vectors * b).sum(1)
    scale = 1.0 / np.maximum(1.0 - c**2, 1e-6)
    out = np.stack([(vt - c * vn) * scale, y, (vn - c * vt) * scale], 1)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


def from_tangent_space(encoded: np.ndarray, normal: np.ndarray, tangent: np.ndarray, hand: np.ndarray) -> np.ndarray:
    """What a viewer does with a normal map's texel: the inverse of `to_tangent_space`."""
    n = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    t = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    b = hand[:, None] * np.cross(n, t)
    b = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-12)
    out = encoded[:, :1] * t + encoded[:, 1:2] * b + encoded[:, 2:] * n
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)
