"""The GLB's options: each says the same asset in other bytes."""

import dataclasses
import io
import json
import struct

import numpy as np
import pytest
from glb_reader import read_glb as read_strictly
from PIL import Image
from sample_avatar import avatar_of, flat_maps, shaded_maps, smooth_maps

from sira_assets.asset.encoding import encode_normal, encode_srgb
from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.gltf import glb_bytes, write_glb
from sira_assets.asset.jpeg import encode_jpeg
from sira_assets.asset.quantise import quantise_positions, quantise_signed, quantise_uv
from sira_assets.asset.textures import write_textures
from sira_assets.errors import InputError
from sira_assets.relight.glb_model import GlbModel, read_glb
from sira_assets.relight.surface import mesh_of, surface_at

FACTOR = ExportConfig(specular_form="factor")
SMALL = ExportConfig(quantise=True)


def read(avatar, config, folder) -> GlbModel:
    write_glb(avatar, folder / "a.glb", config)
    return read_glb(folder / "a.glb")


def surface_of(model: GlbModel):
    """The material at the middle of every triangle."""
    count = len(model.faces)
    return surface_at(model, mesh_of(model), np.arange(count), np.full((count, 3), 1 / 3))


@pytest.mark.parametrize("scale", [0.0, 0.3, 1.0, 10.0])
def test_both_specular_forms_say_the_same_F0(scale, tmp_path):
    maps = smooth_maps()
    maps = dataclasses.replace(maps, specular_f0=maps.specular_f0 * np.float32(scale))
    colour, factor = (surface_of(read(avatar_of(maps), c, tmp_path)) for c in (ExportConfig(), FACTOR))
    largest = maps.specular_f0.max()
    # Half a step of each: 0.0045 of the largest in sRGB at its steepest, half a 255th on the linear scale.
    assert np.abs(colour.f0 - factor.f0).max() <= (0.0045 + 0.5 / 255) * largest + 1e-12
    assert (colour.f90 == (scale > 0)).all()
    # The factor form scales F90 with F0, as its documentation says; the colour is what F0 has above 0.04.
    assert factor.f90 == pytest.approx(factor.f0[:, 0] / (0.04 * max(largest / 0.04, 1)), abs=1e-6)


def test_the_factor_form_keeps_within_what_the_extension_allows():
    for maps in (smooth_maps(), flat_maps(), dataclasses.replace(flat_maps(), specular_f0=np.full((8, 8), 0.2))):
        specular = read_strictly(glb_bytes(avatar_of(maps), FACTOR)).specular
        assert 0 <= specular["specularFactor"] <= 1
        assert "specularColorTexture" not in specular
    assert specular == {"specularColorFactor": [pytest.approx(5.0)] * 3, "specularFactor": pytest.approx(1.0)}


@pytest.mark.parametrize("maps", [smooth_maps(), flat_maps()], ids=["textured", "flat"])
def test_quantised_geometry_is_the_same_within_its_steps(maps, tmp_path):
    avatar = avatar_of(maps)
    plain, small = (read(avatar, c, tmp_path) for c in (ExportConfig(), SMALL))
    side = np.ptp(plain.vertices, axis=0).max()
    # Half a step in each axis, and float32 of the plain file.
    assert np.abs(small.vertices - plain.vertices).max() <= 0.5 * side / 65535 + 3e-7
    assert np.abs(small.uv - plain.uv).max() <= 0.5 / 65535 + 1e-7
    # sqrt(3)/2 steps of 1/32767 are 0.0015 degrees, of 1/127 (tangents) 0.39 degrees.
    assert (small.normals * plain.normals).sum(1).min() > np.cos(np.radians(0.002))
    if plain.tangents is not None:
        assert (small.tangents[:, :3] * plain.tangents[:, :3]).sum(1).min() > np.cos(np.radians(0.4))
        assert (small.tangents[:, 3] == plain.tangents[:, 3]).all()
    assert (small.faces == plain.faces).all()
    glb = json_of((tmp_path / "a.glb").read_bytes())
    assert glb["extensionsRequired"] == ["KHR_mesh_quantization"]
    assert set(glb["extensionsRequired"]) <= set(glb["extensionsUsed"])
    assert all(view.get("byteStride", 4) % 4 == 0 for view in glb["bufferViews"])


def json_of(raw: bytes) -> dict:
    (length,) = struct.unpack_from("<I", raw, 12)
    return json.loads(raw[20 : 20 + length])


def test_quantised_vertices_take_half_the_bytes(avatar):
    def vertex_bytes(config):
        views = json_of(glb_bytes(avatar, config))["bufferViews"]
        return sum(v["byteLength"] for v in views if v.get("target") == 34962)

    assert vertex_bytes(SMALL) == vertex_bytes(ExportConfig()) / 2


def test_codes_are_rounded_and_reach_both_ends():
    points = np.random.default_rng(0).normal(size=(500, 3)) * [1, 5, 0.01] + [100, 0, -7]
    made = quantise_positions(points)
    back = made.translation + made.scale * made.codes / 65535
    assert np.abs(back - points).max() <= 0.5 * made.scale / 65535 + 1e-12
    assert (made.codes.min(), made.codes.max()) == (0, 65535)
    assert quantise_positions(np.full((3, 3), 2.5)).translation.tolist() == [2.5] * 3
    assert quantise_uv(np.array([-0.1, 0.0, 0.5, 1.0, 1.1])).tolist() == [0, 0, 32768, 65535, 65535]
    assert quantise_signed(np.array([-1.0, 0.0, 1.0]), np.int8).tolist() == [-127, 0, 127]


def test_jpeg_pictures_are_near_and_say_what_they_are(avatar):
    glb = read_strictly(glb_bytes(avatar, ExportConfig(jpeg_quality=95)))
    kinds = {image["name"]: image["mimeType"] for image in glb.document["images"]}
    assert kinds == {"diffuse": "image/jpeg", "normal": "image/png", "specular": "image/jpeg"}
    base = glb.texels(glb.material["pbrMetallicRoughness"]["baseColorTexture"])
    # Quality 95 divides by 10 or less: a few codes on smooth maps.
    assert np.abs(base.astype(int) - encode_srgb(avatar.textures.diffuse)).max() <= 4
    # Highlights show a turned normal; these are not touched.
    assert (glb.texels(glb.material["normalTexture"]) == encode_normal(avatar.textures.normal_tangent)).all()


def test_jpeg_keeps_colours_at_full_resolution():
    # Columns of two colours of one brightness: at half resolution in colour they would melt into grey.
    texels = np.zeros((16, 16, 3), np.uint8)
    texels[:, ::2], texels[:, 1::2] = (200, 60, 60), (40, 120, 140)
    with Image.open(io.BytesIO(encode_jpeg(texels, 98))) as picture:
        assert np.abs(np.array(picture).astype(int) - texels).max() < 16
    with pytest.raises(ValueError, match="uint8"):
        encode_jpeg(np.zeros((4, 4, 4), np.uint8), 90)


def test_a_weight_in_alpha_stays_png(avatar):
    glb = read_strictly(glb_bytes(avatar, ExportConfig(specular_form="factor", jpeg_quality=90)))
    kinds = {image["name"]: image["mimeType"] for image in glb.document["images"]}
    assert kinds == {"diffuse": "image/jpeg", "normal": "image/png", "specular": "image/png"}
    weight = glb.texels(glb.specular["specularTexture"])[..., 3] / 255 * glb.specular["specularFactor"]
    f0 = 0.04 * glb.specular["specularColorFactor"][0] * weight
    assert f0 == pytest.approx(avatar.textures.specular_f0, abs=0.5 / 255 * 0.07 + 1e-9)


@pytest.mark.parametrize("config", [ExportConfig(), FACTOR, SMALL, ExportConfig(jpeg_quality=80)])
def test_every_choice_gives_the_same_bytes_twice(config):
    assert glb_bytes(avatar_of(smooth_maps()), config) == glb_bytes(avatar_of(smooth_maps()), config)


@pytest.mark.parametrize("choice", [{"specular_form": "colour"}, {"jpeg_quality": 0}, {"jpeg_quality": 101}])
def test_other_choices_are_refused(choice):
    with pytest.raises(InputError):
        ExportConfig(**choice)


def test_occlusion_is_the_red_of_its_own_linear_picture(tmp_path):
    avatar = avatar_of(shaded_maps())
    glb = read_strictly(glb_bytes(avatar))
    assert glb.texels(glb.material["occlusionTexture"])[..., 0] / 255 == pytest.approx(
        avatar.textures.occlusion, abs=0.5 / 255 + 1e-7
    )
    files = write_textures(avatar.textures, tmp_path)
    with Image.open(files.occlusion) as picture:
        assert np.array(picture) / 255 == pytest.approx(avatar.textures.occlusion, abs=0.5 / 255 + 1e-7)
    open_sky = dataclasses.replace(avatar.textures, occlusion=np.ones((64, 64), np.float32))
    for maps in (open_sky, smooth_maps()):
        assert "occlusionTexture" not in read_strictly(glb_bytes(avatar_of(maps))).material
    assert write_textures(smooth_maps(), tmp_path / "none").occlusion is None
