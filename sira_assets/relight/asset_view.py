"""What an exported asset shows to a camera: its maps, ray cast through the pixel centres.

Notation: per pixel the first hit x (world), shading normal n (unit, towards the camera), diffuse albedo a = base (1 -
metallic), and ks = F0 / 0.04 with F0 the mean over RGB, as scenes store it on disk.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.relight.glb_model import GlbModel, Material
from sira_assets.scene.camera import Camera

F0_PER_KS = 0.04


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
    mesh = TriangleMesh(model.vertices, model.faces, model.normals)
    origins, directions = camera.rays_world()
    hits = Raycaster(mesh).cast(origins, directions)
    hit = np.asarray(hits.hit, bool)
    face, weights = hits.face[hit], hits.barycentric[hit]
    corners = model.faces[face]

    def mix(values: np.ndarray) -> np.ndarray:
        return (values[corners] * weights[..., None]).sum(1)

    uv, colours = mix(model.uv), mix(model.colours)
    normal = _unit(mix(mesh.normals))
    mapped = normal.copy()
    diffuse, ks = np.zeros((len(face), 3)), np.zeros(len(face))
    has_map = model.tangents is not None and any(m.normal_texture is not None for m in model.materials)
    for index in np.unique(model.material[face]):
        here = model.material[face] == index
        material = model.materials[index]
        base = _base_colour(material, uv[here]) * colours[here]
        diffuse[here] = base * (1.0 - material.metallic)
        f0 = _dielectric_f0(material, uv[here]) * (1.0 - material.metallic) + base.mean(1) * material.metallic
        ks[here] = f0 / F0_PER_KS
        if has_map and material.normal_texture is not None:
            mapped[here] = _mapped_normal(material, uv[here], normal[here], mix(model.tangents)[here])
    away = (normal * directions[hit]).sum(1) > 0.0
    shape = (camera.height, camera.width)

    def picture(values: np.ndarray) -> np.ndarray:
        out = np.zeros((shape[0] * shape[1], *values.shape[1:]))
        out[hit] = values
        return out.reshape(*shape, *values.shape[1:])

    sign = np.where(away, -1.0, 1.0)[:, None]
    return AssetView(
        hit.reshape(shape),
        picture(sign * normal),
        picture(sign * mapped) if has_map else None,
        picture(diffuse),
        picture(ks),
    )


def _base_colour(material: Material, uv: np.ndarray) -> np.ndarray:
    texture = material.base_texture
    return material.base_factor * (1.0 if texture is None else texture.at(uv)[:, :3]) * np.ones((len(uv), 3))


def _dielectric_f0(material: Material, uv: np.ndarray) -> np.ndarray:
    """KHR_materials_specular: min(f0 colour, 1) weight, averaged over RGB."""
    colour, weight = material.specular_colour_texture, material.specular_texture
    f0 = material.f0_dielectric * material.specular_colour_factor * (1.0 if colour is None else colour.at(uv)[:, :3])
    strength = material.specular_factor * (1.0 if weight is None else weight.at(uv)[:, 3])
    return (np.minimum(f0, 1.0) * np.ones((len(uv), 3))).mean(1) * strength


def _mapped_normal(material: Material, uv: np.ndarray, normal: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """glTF 2.0, section 3.9.3: bitangent = cross(normal, tangent.xyz) tangent.w, interpolated, not orthogonalised."""
    local = material.normal_texture.at(uv)[:, :3] * 2.0 - 1.0
    local[:, :2] *= material.normal_scale
    t, handed = tangent[:, :3], np.sign(tangent[:, 3:])
    return _unit(local[:, :1] * t + local[:, 1:2] * np.cross(normal, t) * handed + local[:, 2:] * normal)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300)
