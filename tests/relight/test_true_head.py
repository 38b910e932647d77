"""A real scan with its true maps, relit, against an independent path tracer's picture of it."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from assets import material
from PIL import Image
from scipy.ndimage import binary_erosion, uniform_filter

from sira_assets.measure.image_metrics import score_image
from sira_assets.numerics.colour import linear_from_srgb
from sira_assets.relight.glb_model import GlbModel, Texture
from sira_assets.relight.render import light_asset, see_asset, visibility_of
from sira_assets.scene.image import read_image, read_mask
from sira_assets.scene.sg_light import SGLight
from sira_assets.scene.transforms_json import read_camera


def scan(head) -> GlbModel:
    """heads/james with its photographic albedo and its ks, which scales F0 and F90 as KHR_materials_specular does."""
    mesh = trimesh.load(head / "mesh.ply", process=False)
    with Image.open(head / "albedo.png") as picture:
        albedo = linear_from_srgb(np.asarray(picture.convert("RGB"), np.float32) / 255)
    with Image.open(head / "specular.png") as picture:
        ks = 2 * np.asarray(picture.convert("L"), np.float32) / 255
    skin = replace(
        material(base=(1, 1, 1)),
        base_texture=Texture(np.concatenate([albedo, np.ones_like(albedo[..., :1])], -1)),
        specular_texture=Texture(np.repeat(ks[..., None], 4, -1)),
    )
    return GlbModel(
        vertices=np.asarray(mesh.vertices),
        normals=np.asarray(mesh.vertex_normals),
        uv=np.asarray(mesh.visual.uv) * [1, -1] + [0, 1],
        colours=np.ones((len(mesh.vertices), 3)),
        tangents=None,
        faces=np.asarray(mesh.faces),
        material=np.zeros(len(mesh.faces), np.int64),
        materials=(skin,),
        extras={},
    )


@pytest.mark.slow
def test_a_true_head_relit_comes_near_the_path_tracer(real_data):
    """Radiance model of the scenes: kd / pi without 1 - F, GGX at roughness 0.5, one texture for each map."""
    folder = real_data / "scenes" / "james_soft"
    seen = see_asset(scan(real_data / "heads" / "james"), read_camera(folder / "transforms.json"), supersample=2)
    mask = read_mask(folder / "mask.png")
    inside = binary_erosion(mask, iterations=4)
    light = SGLight.from_dict(json.loads((folder / "relight" / "lights.json").read_text()))
    free = light_asset(seen, light, gltf_weighting=False).radiance
    visibility = visibility_of(seen, light, rays=192)
    cast = light_asset(seen, light, visibility=visibility, gltf_weighting=False).radiance
    traced = read_image(folder / "relight" / "image.exr").linear
    unshadowed = read_image(folder / "relight" / "image_unshadowed.exr").linear

    def box(picture):
        return uniform_filter(picture, (5, 5, 0))

    # The same local model; what is left is the tracer's noise (6 to 9 % a pixel, a fifth of it after the box) and GGX
    # against its gaussian: 42.6 dB measured.
    assert score_image(box(free), box(unshadowed), inside).psnr_db > 41.5
    # With shadows only bounces are missing (3 % of the light here), and the noise is the picture's own (36 dB):
    # 32.3 dB measured, 31.5 without shadows.
    shadowed = score_image(cast, traced, mask).psnr_db
    assert shadowed > 31.8
    assert shadowed > score_image(free, traced, mask).psnr_db + 0.5
