"""Faces that pass through other faces: legal in every file format, wrong for printing, physics and cast shadows."""

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh


def self_intersecting_faces(mesh: TriangleMesh) -> np.ndarray:
    """(F,) bool: faces that cut another one with which they share no corner (MeshLab's exact triangle tests).

    Parameters
    ----------
    mesh : any unit
    """
    import pymeshlab

    if not len(mesh.faces):
        return np.zeros(0, bool)
    # In a unit box: the test works in single precision and has absolute thresholds.
    centre = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
    size = max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-30)
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh((mesh.vertices - centre) / size, mesh.faces))
    meshes.compute_selection_by_self_intersections_per_face()
    return np.array(meshes.current_mesh().face_selection_array(), bool)
