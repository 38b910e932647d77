"""What an exported asset shows to a camera: its maps, ray cast through the pixel centres.

Notation: per pixel the first hit x (world), shading normal n (unit, towards the camera), diffuse albedo a = base (1 -
metallic), and ks = F0 / 0.04 with F0 the mean over RGB, as scenes store it on disk.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.asset.encoding import F0_OF_IOR_1_5
from sira_assets.mesh.raycast import Raycaster
from sira_assets.relight.glb_model import GlbModel
from sira_assets.relight.surface import mesh_of, surface_at
from sira_assets.scene.camera import Camera


@dataclass(frozen=True)
class AssetView:
    """Maps of an asset at a camera's pixels; zeros where no triangle is hit.

    Parameters
    ----------
    hit : (H, W) bool
    normal_world : (H, W, 3) interpolated vertex normals, turned towards the camera
    mapped_normal_world : (H, W, 3) the same through the normal map, or None without map or tangents
    diffuse : (H, W, 3) linear diffuse albedo
    specular_ks : (H, W)
    """

    hit: np.ndarray
    normal_world: np.ndarray
    mapped_normal_world: np.ndarray | None
    diffuse: np.ndarray
    specular_ks: np.ndarray


def view_asset(model: GlbModel, camera: Camera) -> AssetView:
    """Ray cast a GLB's own textures at a camera given in the GLB's own world."""
    mesh = mesh_of(model)
    origins, directions = camera.rays_world()
    hits = Raycaster(mesh).cast(origins, directions)
    hit = np.asarray(hits.hit, bool)
    surface = surface_at(model, mesh, hits.face[hit], hits.barycentric[hit])
    has_map = model.tangents is not None and any(m.normal_texture is not None for m in model.materials)
    sign = np.where((surface.normal * directions[hit]).sum(1) > 0.0, -1.0, 1.0)[:, None]
    shape = (camera.height, camera.width)

    def picture(values: np.ndarray) -> np.ndarray:
        out = np.zeros((shape[0] * shape[1], *values.shape[1:]))
        out[hit] = values
        return out.reshape(*shape, *values.shape[1:])

    return AssetView(
        hit.reshape(shape),
        picture(sign * surface.normal),
        picture(sign * surface.mapped_normal) if has_map else None,
        picture(surface.diffuse),
        picture(surface.f0.mean(1) / F0_OF_IOR_1_5),
    )
