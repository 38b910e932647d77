"""A textured head in miniature: a welded sphere with a seam, smooth maps, two lobes of light, a world of its own."""

import dataclasses

import numpy as np

from sira_assets.asset.avatar import Avatar
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.sg_light import SGLight
from sira_assets.texture.atlas import Atlas, AtlasReport
from sira_assets.texture.texture_set import TextureSet

RINGS, SECTORS, SIZE = 10, 16, 64
# A world that is turned, scaled and far from its origin, so that nothing in a writer may lean on the canonical frame.
WORLD_FROM_CANONICAL = np.array([[0.0, 0, 1.3, 2.0], [1.3, 0, 0, -1.0], [0, 1.3, 0, 0.5], [0, 0, 0, 1]])


def sphere(rings: int = RINGS, sectors: int = SECTORS) -> tuple[TriangleMesh, Atlas]:
    """A welded sphere of radius 0.1 m; u runs east round +Y, v from the south pole up; one seam, split poles."""
    theta = np.pi * np.arange(1, rings) / rings
    phi = 2 * np.pi * np.arange(sectors) / sectors
    t, p = np.meshgrid(theta, phi, indexing="ij")
    body = np.stack([np.sin(t) * np.sin(p), -np.cos(t), np.sin(t) * np.cos(p)], -1).reshape(-1, 3)
    normals = np.vstack([body, [[0, -1, 0], [0, 1, 0]]])
    south, north = len(body), len(body) + 1
    grid = np.stack(np.meshgrid(np.arange(1, rings) / rings, np.arange(sectors + 1) / sectors, indexing="ij"), -1)
    uv = grid[..., ::-1].reshape(-1, 2)
    pole_u = (np.arange(sectors) + 0.5) / sectors
    uv = np.vstack([uv, np.c_[pole_u, np.zeros(sectors)], np.c_[pole_u, np.ones(sectors)]])

    def at(i, j):
        return i * sectors + j % sectors

    def at_uv(i, j):
        return i * (sectors + 1) + j

    first_pole = (rings - 1) * (sectors + 1)
    faces, faces_uv = [], []
    for j in range(sectors):
        faces.append([south, at(0, j + 1), at(0, j)])
        faces_uv.append([first_pole + j, at_uv(0, j + 1), at_uv(0, j)])
        faces.append([north, at(rings - 2, j), at(rings - 2, j + 1)])
        faces_uv.append([first_pole + sectors + j, at_uv(rings - 2, j), at_uv(rings - 2, j + 1)])
        for i in range(rings - 2):
            quad, quad_uv = ([f(i, j), f(i, j + 1), f(i + 1, j + 1), f(i + 1, j)] for f in (at, at_uv))
            faces += [quad[:3], [quad[0], quad[2], quad[3]]]
            faces_uv += [quad_uv[:3], [quad_uv[0], quad_uv[2], quad_uv[3]]]
    mesh = TriangleMesh(0.1 * normals, np.array(faces), normals)
    return mesh, Atlas(uv, np.array(faces_uv), AtlasReport("boxes", 1, 1.0, 0.0, 1.0))


def smooth_maps(size: int = SIZE) -> TextureSet:
    """Maps that vary smoothly; F0 passes 0.04 and irradiance passes 1, as real ones do."""
    u, w = np.meshgrid((np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size)
    v = 1 - w
    normal = np.stack([0.3 * np.sin(6 * u), 0.3 * np.cos(5 * v), np.ones_like(u)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return TextureSet(
        diffuse=np.stack([0.2 + 0.6 * u, 0.1 + 0.5 * v, 0.3 + 0 * u], -1).astype(np.float32),
        specular_f0=(0.02 + 0.05 * u * v).astype(np.float32),
        normal_tangent=normal.astype(np.float32),
        irradiance=np.stack([4 * v, 2 * u, u * v], -1).astype(np.float32),
        coverage=np.ones((size, size), bool),
    )


def shaded_maps(size: int = SIZE) -> TextureSet:
    """The smooth maps with an occlusion map: dark below, open above."""
    v = 1 - np.repeat(((np.arange(size) + 0.5) / size)[:, None], size, 1)
    return dataclasses.replace(smooth_maps(size), occlusion=(0.25 + 0.75 * v).astype(np.float32))


def flat_maps(size: int = 8) -> TextureSet:
    """Maps of one value each."""
    return TextureSet(
        diffuse=np.full((size, size, 3), (0.5, 0.3, 0.2), np.float32),
        specular_f0=np.full((size, size), 0.028, np.float32),
        normal_tangent=np.broadcast_to(np.float32([0, 0, 1]), (size, size, 3)).copy(),
        irradiance=np.zeros((size, size, 3), np.float32),
        coverage=np.ones((size, size), bool),
    )


def avatar_of(textures: TextureSet) -> Avatar:
    mesh, atlas = sphere()
    light = SGLight([[0, 0, 1], [1, 1, 0]], [3.0, 40.0], [[1.0, 0.9, 0.8], [2.0, 2.0, 2.5]])
    return Avatar(
        mesh=mesh.transformed(WORLD_FROM_CANONICAL),
        atlas=atlas,
        textures=textures,
        light=light,
        roughness=0.45,
        canonical_from_world=np.linalg.inv(WORLD_FROM_CANONICAL),
        metres_per_unit=0.5,
        name="sphere head",
    )
