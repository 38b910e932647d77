"""The inside of an open scan: where it may be looked at from, and what no picture may show.

Notation: a face shows its back where its outward normal points away from the viewer.
"""

from dataclasses import fields, replace

import numpy as np

from data_synth.cameras import rotation_xyz
from data_synth.render import Rendering
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.camera import Camera

YAWS_DEG = (150.0, 120.0, 105.0, 90.0, 75.0, 60.0, 45.0)
MOST_BACK = 0.03  # of the head's silhouette; an open neck seen from below shows as much
GRID, REACH_M = 96, 0.4  # parallel rays that probe a direction: so many a side, over a square this wide


def shows_back(caster: Raycaster, mesh: TriangleMesh, origins: np.ndarray, directions: np.ndarray) -> tuple:
    """(N,) bool twice: which rays hit the mesh, and which hit the back of a face first."""
    hits = caster.cast(origins, directions)
    outward = face_cross_products(mesh.vertices, mesh.faces)[hits.face]
    return hits.hit, hits.hit & ((outward * directions).sum(1) > 0.0)


def widest_yaw(mesh: TriangleMesh) -> float:
    """Degrees: the widest yaw, to both sides, from which next to nothing of the scan's inside is seen.

    Parameters
    ----------
    mesh : in the canonical frame
    """
    caster = Raycaster(mesh)
    step = (np.arange(GRID) + 0.5) / GRID * REACH_M - 0.5 * REACH_M
    plane = np.stack([*(a.ravel() for a in np.meshgrid(step, step)), np.full(GRID * GRID, 1.0)], axis=1)
    for yaw in YAWS_DEG:
        share = []
        for side in (-yaw, yaw):
            turn = rotation_xyz(0.0, side, 0.0)
            direction = np.broadcast_to(turn @ np.array([0.0, 0.0, -1.0]), plane.shape)
            hit, back = shows_back(caster, mesh, plane @ turn.T, direction)
            share.append(back.sum() / max(hit.sum(), 1))
        if max(share) <= MOST_BACK:
            return yaw
    return YAWS_DEG[-1]


def without_back(rendering: Rendering, camera: Camera, caster: Raycaster, mesh: TriangleMesh) -> Rendering:
    """The rendering with nothing, in every map and in the mask, where a pixel's centre sees the back of a face; an
    occluder before one stays."""
    _, back = shows_back(caster, mesh, *camera.rays_world())
    back = back.reshape(rendering.mask.shape) & rendering.mask
    if not back.any():
        return rendering
    maps = {field.name: getattr(rendering, field.name).copy() for field in fields(Rendering)}
    for pixels in maps.values():
        pixels[back] = 0
    return replace(rendering, **maps)
