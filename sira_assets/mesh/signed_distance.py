"""Signed distance to a closed mesh: how far by the nearest triangle, which side by the winding number.

Notation: d in the mesh's unit, negative inside; w the generalised winding number, 1 inside a closed surface, 0 outside.
"""

import numpy as np

from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh

CHUNK = 65_536  # points at a time; bounds the memory, changes no value


def inside(mesh: TriangleMesh, points: np.ndarray) -> np.ndarray:
    """(N,) bool: whether w > 1/2 at points (N, 3).

    Where closed pieces overlap (an eyeball and the lids around it) w is 2 and the point counts as inside, which the
    parity of ray crossings has wrong.

    References
    ----------
    Barill et al. 2018, DOI 10.1145/3197517.3201337: the fast approximation; its error, some hundredths, matters only
    where a surface is open.
    """
    import igl

    points = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    if not len(points):
        return np.zeros(0, bool)
    return igl.fast_winding_number(mesh.vertices, mesh.faces, points) > 0.5


def signed_distance(mesh: TriangleMesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of points to a closed mesh.

    Parameters
    ----------
    mesh : closed and outward; where it is open the sign is that of the nearest sensible closing
    points : (N, 3)

    Returns
    -------
    distance : (N,) float64, negative inside; exact but for single precision, 1e-7 of the mesh's size
    face : (N,) int64, the nearest face
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    caster = Raycaster(mesh)
    distance, face = np.empty(len(points)), np.empty(len(points), np.int64)
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        nearest = caster.closest(points[part])
        distance[part], face[part] = nearest.distance, nearest.face
    return np.where(inside(mesh, points), -distance, distance), face
