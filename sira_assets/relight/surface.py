"""What lies under points of an asset: position, normals and glTF's material, textures applied.

Notation: m metallic, w the weight of KHR_materials_specular, f_d its F0; F(c) = F0 + (F90 - F0) (1 - c)^5, c = v . h.
A metallic-roughness surface is a mix by m of a dielectric, w F_d over a diffuse base, and a metal. Both have one
specular lobe, so together F0 = (1 - m) w f_d + m base and F90 = (1 - m) w + m (glTF 2.0, appendix B.3;
KHR_materials_specular). The dielectric's own F, which glTF takes from the light that reaches the base, is kept apart.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.relight.glb_model import GlbModel, Material, unit


@dataclass(frozen=True)
class Surface:
    """N points of an asset, float64.

    Parameters
    ----------
    points : (N, 3) world
    normal : (N, 3) interpolated vertex normals, unit, outward as the file has them
    mapped_normal : (N, 3) the same through the normal map; equal where there is none
    diffuse : (N, 3) linear diffuse albedo, base (1 - m)
    f0 : (N, 3) and f90 : (N,) of the specular lobe
    layer_f0, layer_f90 : (N,) of the dielectric alone, F0 being the largest of its channels
    roughness : (N,), GGX alpha is its square
    """

    points: np.ndarray
    normal: np.ndarray
    mapped_normal: np.ndarray
    diffuse: np.ndarray
    f0: np.ndarray
    f90: np.ndarray
    layer_f0: np.ndarray
    layer_f90: np.ndarray
    roughness: np.ndarray

    def __len__(self) -> int:
        return len(self.points)


def mesh_of(model: GlbModel) -> TriangleMesh:
    """The asset's triangles alone, world coordinates."""
    return TriangleMesh(model.vertices, model.faces, model.normals)


def surface_at(model: GlbModel, mesh: TriangleMesh, face: np.ndarray, barycentric: np.ndarray) -> Surface:
    """The surface at points given by their face (N,) and barycentric weights (N, 3).

    Parameters
    ----------
    mesh : `mesh_of(model)`, whose vertex normals are the file's, or angle-weighted where it has none
    """
    corners = model.faces[face]

    def mix(values: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nkc->nc", barycentric, values[corners])

    uv, colours, normal = mix(model.uv), mix(model.colours), unit(mix(mesh.normals))
    count = len(face)
    out = Surface(
        mix(model.vertices),
        normal,
        normal.copy(),
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        *(np.zeros(count) for _ in range(4)),
    )
    for index in np.unique(model.material[face]):
        here = np.flatnonzero(model.material[face] == index)
        material = model.materials[index]
        base = np.minimum(_base_colour(material, uv[here]) * colours[here], 1.0)
        metal, out.roughness[here] = _metallic_roughness(material, uv[here])
        f_d, weight = _dielectric(material, uv[here])
        out.diffuse[here] = base * (1.0 - metal)[:, None]
        out.layer_f90[here] = weight
        out.layer_f0[here] = weight * f_d.max(1)
        out.f90[here] = (1.0 - metal) * weight + metal
        out.f0[here] = ((1.0 - metal) * weight)[:, None] * f_d + metal[:, None] * base
        if material.normal_texture is not None and model.tangents is not None:
            tangent = np.einsum("nk,nkc->nc", barycentric[here], model.tangents[corners[here]])
            out.mapped_normal[here] = _mapped_normal(material, uv[here], normal[here], tangent)
    return out


def _base_colour(material: Material, uv: np.ndarray) -> np.ndarray:
    texture = material.base_texture
    return material.base_factor * (1.0 if texture is None else texture.at(uv)[:, :3]) * np.ones((len(uv), 3))


def _metallic_roughness(material: Material, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Metallic in the blue channel, roughness in the green one."""
    texture = material.metallic_roughness_texture
    texels = np.ones((len(uv), 4)) if texture is None else texture.at(uv)
    return material.metallic * texels[:, 2], material.roughness * texels[:, 1]


def _dielectric(material: Material, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """KHR_materials_specular: F0 (N, 3), at most 1, and its weight (N,), which is in the texture's alpha."""
    colour, weight = material.specular_colour_texture, material.specular_texture
    f0 = material.f0_dielectric * material.specular_colour_factor * (1.0 if colour is None else colour.at(uv)[:, :3])
    strength = material.specular_factor * (1.0 if weight is None else weight.at(uv)[:, 3])
    return np.minimum(f0, 1.0) * np.ones((len(uv), 3)), strength * np.ones(len(uv))


def _mapped_normal(material: Material, uv: np.ndarray, normal: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """glTF 2.0, section 3.9.3: bitangent = cross(normal, tangent.xyz) tangent.w, interpolated, not orthogonalised."""
    local = material.normal_texture.at(uv)[:, :3] * 2.0 - 1.0
    local[:, :2] *= material.normal_scale
    t, handed = tangent[:, :3], np.sign(tangent[:, 3:])
    return unit(local[:, :1] * t + local[:, 1:2] * np.cross(normal, t) * handed + local[:, 2:] * normal)
