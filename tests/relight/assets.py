"""Assets of known answers, made in memory."""

import numpy as np
from shapes import sphere

from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.relight.glb_model import GlbModel, Material
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight


def material(
    *, base=(0.5, 0.5, 0.5), metallic=0.0, roughness=0.5, f0=0.04, weight=1.0, colour=(1.0, 1.0, 1.0)
) -> Material:
    return Material(
        base_factor=np.array(base, np.float64),
        base_texture=None,
        metallic=metallic,
        roughness=roughness,
        metallic_roughness_texture=None,
        f0_dielectric=f0,
        specular_factor=weight,
        specular_texture=None,
        specular_colour_factor=np.array(colour, np.float64),
        specular_colour_texture=None,
        normal_texture=None,
        normal_scale=1.0,
    )


def asset(mesh: TriangleMesh, made_of: Material, extras: dict | None = None) -> GlbModel:
    return GlbModel(
        vertices=mesh.vertices,
        normals=mesh.normals,
        uv=np.zeros((len(mesh.vertices), 2)),
        colours=np.ones((len(mesh.vertices), 3)),
        tangents=None,
        faces=mesh.faces,
        material=np.zeros(len(mesh.faces), np.int64),
        materials=(made_of,),
        extras=extras or {},
    )


def ball(made_of: Material | None = None, *, level: int = 5, extras: dict | None = None) -> GlbModel:
    """A ball of 0.1 m at the origin."""
    return asset(sphere(0.1, level), made_of or material(), extras)


def plate(half: float, z: float, cells: int = 1) -> TriangleMesh:
    """A square across z, facing +Z, of cells x cells quads."""
    x, y = np.meshgrid(np.linspace(-half, half, cells + 1), np.linspace(-half, half, cells + 1))
    corner = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].reshape(-1, 1)
    quads = corner + np.array([0, 1, cells + 2, cells + 1])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return TriangleMesh(np.stack([x, y, np.full_like(x, z)], -1).reshape(-1, 3), faces)


def camera(size: int = 48, *, focal: float = 4.0, distance: float = 1.0) -> Camera:
    """On +Z, looking at the origin; `focal` in picture sides."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = distance
    lens = np.array([[focal * size, 0, size / 2], [0, focal * size, size / 2], [0, 0, 1]])
    return Camera(lens, pose, size, size)


def constant(radiance: float = 1.0) -> SGLight:
    """The same from everywhere, to a hundred-thousandth."""
    return SGLight([[0, 0, 1]], [1e-6], [[radiance] * 3])


def lamp(axis, sharpness: float = 1e4) -> SGLight:
    """One sharp lamp whose flux through a plane that faces it is pi, so that white paper under it has radiance 1."""
    return SGLight([axis], [sharpness], [[0.5 * sharpness] * 3])
