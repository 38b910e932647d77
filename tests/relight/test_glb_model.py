"""The stranger's reader: geometry, texels, node poses, materials and refusals."""

import json
import struct

import numpy as np
import pytest
from glb_maker import write_test_glb
from shapes import sphere

from sira_assets.errors import InputError
from sira_assets.numerics.colour import linear_from_srgb
from sira_assets.relight.asset_view import view_asset
from sira_assets.relight.glb_model import Texture, read_glb
from sira_assets.scene.camera import Camera


def front_uv(mesh) -> np.ndarray:
    """uv (V, 2), origin bottom-left: a picture thrown on the ball from +Z."""
    return mesh.vertices[:, :2] / 0.2 + 0.5


@pytest.fixture
def glb(tmp_path):
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:32] = [200, 100, 50]  # the upper half of the picture: +Y
    texture[32:] = [20, 30, 40]
    mesh = sphere(0.1, 4)
    write_test_glb(tmp_path / "avatar.glb", mesh, front_uv(mesh), texture, ks=0.7)
    return tmp_path / "avatar.glb"


def edited(path, change) -> None:
    """Rewrite the JSON part of a GLB."""
    raw = path.read_bytes()
    length = struct.unpack_from("<I", raw, 12)[0]
    gltf = json.loads(raw[20 : 20 + length])
    change(gltf)
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    rest = raw[20 + length :]
    path.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest)


def camera() -> Camera:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 1.0
    return Camera(np.array([[300.0, 0, 32], [0, 300.0, 32], [0, 0, 1]]), pose, 64, 64)


def test_geometry_comes_back(glb):
    model, mesh = read_glb(glb), sphere(0.1, 4)
    assert np.abs(model.vertices - mesh.vertices).max() < 1e-8  # float32 in the file
    assert np.array_equal(model.faces, mesh.faces)
    assert np.abs(model.normals - mesh.normals).max() < 1e-6
    assert (model.materials[0].metallic, model.materials[0].roughness) == (0.0, 0.5)


def test_maps_at_a_camera_are_the_texels(glb):
    view = view_asset(read_glb(glb), camera())
    assert view.diffuse[26, 32] == pytest.approx(linear_from_srgb(np.array([200, 100, 50]) / 255), abs=1e-6)
    assert view.diffuse[38, 32] == pytest.approx(linear_from_srgb(np.array([20, 30, 40]) / 255), abs=1e-6)
    assert np.abs(view.specular_ks[view.hit] - 0.7).max() < 1e-9
    assert view.diffuse[0, 0].tolist() == [0, 0, 0]
    assert not view.hit[0, 0]
    # The silhouette of a ball of radius R at distance d: R f / sqrt(d^2 - R^2) pixels.
    expected = np.pi * (0.1 * 300 / np.sqrt(1 - 0.01)) ** 2
    assert view.hit.sum() == pytest.approx(expected, rel=0.01)  # pixels on the rim


def test_normals_are_those_of_the_ball(glb):
    view = view_asset(read_glb(glb), camera())
    origins, directions = camera().rays_world()
    half = (origins * directions).sum(1)
    depth = -half - np.sqrt(np.maximum(half**2 - ((origins**2).sum(1) - 0.01), 0))
    exact = ((origins + depth[:, None] * directions) / 0.1).reshape(64, 64, 3)
    cosine = (view.normal_world * exact).sum(-1)[view.hit]
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 0.2  # faces of a level-4 ball are 4 degrees wide


def test_node_poses_are_applied(glb):
    def move(gltf):
        # half a turn about z, then a growth and a shift: T R S
        gltf["nodes"] = [
            {"translation": [1, 2, 3], "rotation": [0, 0, 1, 0], "scale": [2, 2, 2], "children": [1]},
            {"mesh": 0},
        ]
        gltf["scenes"] = [{"nodes": [0]}]
        gltf["scene"] = 0

    edited(glb, move)
    expected = sphere(0.1, 4).vertices * [-2, -2, 2] + [1, 2, 3]
    assert np.abs(read_glb(glb).vertices - expected).max() < 1e-6


def test_absent_metallic_factor_is_metal_and_shows_no_diffuse(glb):
    edited(glb, lambda gltf: gltf["materials"][0]["pbrMetallicRoughness"].pop("metallicFactor"))
    view = view_asset(read_glb(glb), camera())
    assert view.diffuse.max() == 0.0


def test_specular_factors_and_ior(glb):
    def change(gltf):
        gltf["materials"][0]["extensions"] = {
            "KHR_materials_specular": {"specularColorFactor": [0.5, 0.5, 0.5], "specularFactor": 0.5},
            "KHR_materials_ior": {"ior": 2.0},
        }

    edited(glb, change)
    # F0 = ((2 - 1) / (2 + 1))^2 * 0.5 * 0.5; ks = F0 / 0.04
    view = view_asset(read_glb(glb), camera())
    assert view.specular_ks[view.hit] == pytest.approx(0.25 / 9 / 0.04, rel=1e-9)


def test_bilinear_lookup_is_exact_at_centres_and_between():
    texels = np.random.default_rng(0).random((4, 5, 4)).astype(np.float32)
    texture = Texture(texels, (True, True))
    assert texture.at(np.array([[2.5 / 5, 1.5 / 4]]))[0] == pytest.approx(texels[1, 2], abs=1e-12)
    assert texture.at(np.array([[3.0 / 5, 1.5 / 4]]))[0] == pytest.approx((texels[1, 2] + texels[1, 3]) / 2, abs=1e-7)
    assert texture.at(np.array([[-3.0, 9.0]]))[0] == pytest.approx(texels[3, 0], abs=1e-12)
    assert Texture(texels).at(np.array([[1.5 / 5 + 7, 0.5 / 4 - 2]]))[0] == pytest.approx(texels[0, 1], abs=1e-6)


def test_broken_files_are_said_in_one_line(glb, tmp_path):
    whole = glb.read_bytes()
    for name, data in (("cut", whole[:-100]), ("text", b"not a GLB at all"), ("empty", b"")):
        path = tmp_path / f"{name}.glb"
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"binary glTF 2\.0"):
            read_glb(path)
    with pytest.raises(InputError, match="no such file"):
        read_glb(tmp_path / "none.glb")
    edited(glb, lambda gltf: gltf["meshes"][0]["primitives"][0].update(mode=1))
    with pytest.raises(InputError, match="no triangles"):
        read_glb(glb)
