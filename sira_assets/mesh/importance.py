"""Where triangles matter most on a head: eyes, lips, and what is seen as its outline.

Notation: x a vertex in the canonical frame, n its normal; w >= 1 its weight, by which decimation multiplies the error
that it makes there (a squared distance).
"""

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

# Lids and lips lie within this of the line between an eye's, or the mouth's, corners in most people.
REACH_M = 0.012
# A squared distance weighed 9 times: the same budget then leaves about a third of the distance there.
FEATURE_WEIGHT, OUTLINE_WEIGHT = 9.0, 3.0
# The head is looked at from the front, three quarters and the side; there the outline is where n is at right angles to
# the view, and within 12 degrees of that for views between.
YAWS_DEG = (-90.0, -45.0, 0.0, 45.0, 90.0)
OUTLINE_COSINE = 0.2


def head_importance(mesh: TriangleMesh) -> np.ndarray:
    """(V,) weights, 1 to about 11, of a head's vertices for `simplify_mesh`.

    Parameters
    ----------
    mesh : canonical metres; the canonical landmarks say where its eyes and lips are
    """
    at = {name: np.array(point) for name, point in CANONICAL_LANDMARKS_M.items()}
    lines = (
        ("right_eye_outer", "right_eye_inner"),
        ("left_eye_inner", "left_eye_outer"),
        ("mouth_right", "mouth_left"),
    )
    distance = np.min([_to_segment(mesh.vertices, at[a], at[b]) for a, b in lines], axis=0)
    feature = np.exp(-0.5 * (distance / REACH_M) ** 2)
    yaw = np.deg2rad(YAWS_DEG)
    views = np.stack([np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)], 1)
    cosine = np.abs(mesh.normals @ views.T).min(1)
    outline = np.clip(1.0 - cosine / OUTLINE_COSINE, 0.0, 1.0)
    return 1.0 + (FEATURE_WEIGHT - 1.0) * feature + (OUTLINE_WEIGHT - 1.0) * outline


def _to_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N,) distance of points to the segment ab."""
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)
