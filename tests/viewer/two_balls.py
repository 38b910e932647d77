"""An avatar of two balls, of which the small one shades the large one."""

import dataclasses
import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "asset"))

from sample_avatar import WORLD_FROM_CANONICAL, avatar_of, smooth_maps, sphere

from sira_assets.asset.avatar import Avatar
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.texture.atlas import Atlas

WIDTH, HEIGHT = 144, 112


def two_balls() -> Avatar:
    """The sample head with a nose of 4 cm before it; both wear the same maps. Its camera has a shifted, oblong lens."""
    sample = avatar_of(smooth_maps(256))
    mesh, atlas = sphere(36, 64)
    small = 0.35 * mesh.vertices + np.array([0.02, 0.03, 0.125])
    both = TriangleMesh(
        np.vstack([mesh.vertices, small]),
        np.vstack([mesh.faces, mesh.faces + len(mesh.vertices)]),
        np.vstack([mesh.normals, mesh.normals]),
    )
    # From the side that the sharper lobe leaves in shadow, a little above, in the sample's turned world.
    eye = np.array([-0.3, 0.1, 0.6])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    pose[:3, 3] = eye
    pose = WORLD_FROM_CANONICAL @ pose
    pose[:3, :3] /= 1.3
    lens = np.array([[290.0, 0, 66.0], [0, 280.0, 60.0], [0, 0, 1]])
    return dataclasses.replace(
        sample,
        mesh=both.transformed(WORLD_FROM_CANONICAL),
        atlas=Atlas(
            np.vstack([atlas.uv, atlas.uv]), np.vstack([atlas.faces_uv, atlas.faces_uv + len(atlas.uv)]), atlas.report
        ),
        camera=Camera(lens, pose, WIDTH, HEIGHT),
    )
