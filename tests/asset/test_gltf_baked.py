"""A bake, exported and read as a viewer reads it, gives the field back: UVs, tangents and codes agree end to end."""

import numpy as np
import pytest
from glb_reader import Glb, read_glb
from sample_avatar import sphere
from scipy.ndimage import map_coordinates

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.encoding import decode_srgb
from sira_assets.asset.gltf import glb_bytes
from sira_assets.fields.analytic import SphereHead
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.sg_light import SGLight
from sira_assets.texture.bake import BakeConfig, bake

LIGHT = SGLight([[0, 0, 1]], [3.0], [[1.0, 1.0, 1.0]])
# A world turned against the canonical frame: a tangent frame left in the wrong one would show.
TURN = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
SIZE = 256


@pytest.fixture(scope="module")
def glb() -> Glb:
    mesh, atlas = sphere(24, 32)
    # Vertex normals that are well off, so that the normal map has some 15 degrees to put right.
    tilted = mesh.normals + np.array([0.2, 0.1, -0.2])
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    coarse = TriangleMesh(mesh.vertices, mesh.faces, tilted)
    field = SphereHead(radius_m=0.1, centre_m=(0.0, 0.0, 0.0))
    textures = bake(field, coarse, atlas, LIGHT, TURN, BakeConfig(size=SIZE))
    return read_glb(glb_bytes(Avatar(coarse.transformed(TURN), atlas, textures, LIGHT, 0.5, np.linalg.inv(TURN))))


def surface(glb: Glb) -> dict[str, np.ndarray]:
    """Attributes at random points of the triangles away from the poles, interpolated as a rasteriser does."""
    rng = np.random.default_rng(0)
    uv = glb.attribute("TEXCOORD_0")[glb.faces]
    faces = glb.faces[(np.abs(uv[..., 1] - 0.5) < 0.4).all(1)]
    faces = faces[rng.integers(0, len(faces), 4000)]
    weight = rng.dirichlet(np.ones(3), len(faces))
    names = ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_0")
    return {k: (glb.attribute(k).astype(np.float64)[faces] * weight[..., None]).sum(1) for k in names}


def sample(texels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear look-up with glTF's origin, the top left."""
    at = [uv[:, 1] * SIZE - 0.5, uv[:, 0] * SIZE - 0.5]
    return np.stack([map_coordinates(texels[..., k], at, order=1, mode="nearest") for k in range(3)], -1)


def unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def test_the_normal_map_restores_the_true_normals(glb):
    point = surface(glb)
    n, t = unit(point["NORMAL"]), unit(point["TANGENT"][:, :3])
    b = np.cross(n, t) * np.sign(point["TANGENT"][:, 3:])
    texel = sample(glb.texels(glb.material["normalTexture"]) / 127.5 - 1.0, point["TEXCOORD_0"])
    decoded = unit(texel[:, :1] * t + texel[:, 1:2] * b + texel[:, 2:] * n)
    true = unit(point["POSITION"])
    error = np.degrees(np.arccos(np.clip((decoded * true).sum(1), -1, 1)))
    unmapped = np.degrees(np.arccos(np.clip((n * true).sum(1), -1, 1)))
    assert unmapped.mean() > 10
    # 0.4 degrees of eight bits, and what a texel's width (1.4 degrees of longitude) leaves to bilinear filtering.
    assert error.mean() < 0.3
    assert np.quantile(error, 0.99) < 1.0


def test_the_base_colour_is_the_albedo_at_the_surface(glb):
    point = surface(glb)
    texels = decode_srgb(glb.texels(glb.material["pbrMetallicRoughness"]["baseColorTexture"]))
    x_canonical = 0.1 * unit(point["POSITION"]) @ TURN[:3, :3]
    # 0.0045: half an sRGB step at its steepest; 0.0005: the sphere over a texel, against linear filtering.
    assert sample(texels, point["TEXCOORD_0"]) == pytest.approx(0.5 + x_canonical, abs=0.005)
