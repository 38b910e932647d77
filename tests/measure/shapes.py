"""Meshes with closed-form answers."""

import numpy as np
import trimesh

from sira_assets.mesh.triangle_mesh import TriangleMesh


def sphere(radius: float = 0.1, level: int = 4, centre=(0.0, 0.0, 0.0)) -> TriangleMesh:
    """An icosphere: vertices on the sphere, faces inside it by at most the sagitta."""
    made = trimesh.creation.icosphere(subdivisions=level, radius=radius)
    return TriangleMesh(np.asarray(made.vertices) + np.asarray(centre), np.asarray(made.faces))


def sagitta(radius: float, mesh: TriangleMesh) -> float:
    """How deep the flattest point of any face lies under the sphere."""
    return radius - np.linalg.norm(mesh.vertices[mesh.faces].mean(1), axis=1).min()


def bumpy(level: int = 5) -> TriangleMesh:
    """A head-sized shape that no turn, shift or growth maps onto itself."""
    mesh = sphere(0.1, level)
    x, y, z = (mesh.vertices / 0.1).T
    bump = 1 + 0.12 * np.exp(-20 * (x**2 + (y + 0.2) ** 2 + (z - 1) ** 2)) + 0.05 * np.sin(3 * x + 1) * np.cos(4 * y)
    return TriangleMesh(mesh.vertices * bump[:, None] * [0.8, 1.2, 1.0], mesh.faces)


def motion(rotation_vector, shift, scale: float = 1.0) -> np.ndarray:
    """(4, 4) similarity."""
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    out[:3, :3] = scale * Rotation.from_rotvec(rotation_vector).as_matrix()
    out[:3, 3] = shift
    return out
