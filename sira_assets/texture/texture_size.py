"""How many texels a side the photo can fill, and the fitted field with it.

Notation: a pixel at depth z covers z / f of the surface it meets head-on; an atlas of utilisation q over area A has
texels of sqrt(A / q) / S.
"""

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.camera import Camera

# What packed atlases of heads use of the square (tools/measure_unwrap.py: 0.57 to 0.67).
USUAL_UTILISATION = 0.6
LEAST, MOST = 256, 4096
# Along the shortest wave that the albedo holds, where a pixel has one texel; a reading between texels blurs a wave of
# fewer than four. At two texels a pixel, exported file against field and against photo: a portrait of 1200 x 1600
# pixels 46.8 and 27.1 dB at 1024 texels a side (5 a wave), 48.0 and 27.1 at 2048; one of 512 x 512 36.1 and 28.4 at
# 512 (2.5 a wave), 39.6 and 28.9 at 1024.
TEXELS_PER_WAVE = 2.0


def photo_texture_size(
    mesh_world: TriangleMesh, camera: Camera, *, texels_per_pixel: float = 1.0, shortest_wave: float = 0.0
) -> int:
    """The power of two, 256 to 4096, at which a texel is no larger than the photo's pixel on the surface it sees, nor
    smaller than the field has use for.

    Parameters
    ----------
    mesh_world : the mesh that is textured, in the camera's world and unit
    texels_per_pixel : along one axis, above 0
    shortest_wave : of what the albedo can hold, in the world's unit; 0 for no bound

    Notes
    -----
    The median depth of faces that look to the camera decides, weighted by their area in the picture. Where the camera
    sees none, the least size is given.
    """
    centre = mesh_world.vertices[mesh_world.faces].mean(1)
    cross = face_cross_products(mesh_world.vertices, mesh_world.faces)
    to_camera = camera.camera_from_world
    x = centre @ to_camera[:3, :3].T + to_camera[:3, 3]
    facing = -((cross @ to_camera[:3, :3].T) * x).sum(1)
    depth = x[:, 2]
    seen = (facing > 0) & (depth > 0)
    if not seen.any():
        return LEAST
    k = camera.intrinsics
    pixel = x[seen] @ k.T
    pixel = pixel[:, :2] / pixel[:, 2:]
    inside = ((pixel >= 0) & (pixel < (camera.width, camera.height))).all(1)
    if not inside.any():
        return LEAST
    depth, weight = depth[seen][inside], (facing[seen] / depth[seen] ** 3)[inside]
    order = np.argsort(depth)
    reached = np.cumsum(weight[order])
    middle = depth[order[np.searchsorted(reached, 0.5 * reached[-1])]]
    footprint = max(middle / np.sqrt(k[0, 0] * k[1, 1]), shortest_wave / TEXELS_PER_WAVE) / texels_per_pixel
    area = 0.5 * np.linalg.norm(cross, axis=1).sum()
    wanted = np.sqrt(area / USUAL_UTILISATION) / footprint
    # A hundredth above a power of two is not worth four times the texels.
    return int(np.clip(2 ** np.ceil(np.log2(max(wanted, 1.0)) - 0.015), LEAST, MOST))
