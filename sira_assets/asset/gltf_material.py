"""An avatar's glTF material: which maps become pictures, which become factors, and where F0 stands.

Notation: s specular albedo (F0); S its largest value on the atlas; g = max(S / 0.04, 1); a diffuse albedo. With an
index of refraction of 1.5, KHR_materials_specular means F0 = min(0.04 colour, 1) weight and F90 = weight.

colour form   colour = s / 0.04, weight 1: F0 is s whatever its range, F90 stays 1, as the fitted model has it.
factor form   weight = s / (0.04 g), colour g: F0 is the same, but F90 is the weight, so grazing angles shine less.
"""

import numpy as np

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.encoding import F0_OF_IOR_1_5, encode_normal, encode_srgb, quantised
from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.glb_file import GlbFile
from sira_assets.asset.jpeg import encode_jpeg
from sira_assets.asset.png import encode_png
from sira_assets.texture.texture_set import constant_map

FLAT_NORMAL = np.array([0.0, 0.0, 1.0])


def gltf_material(avatar: Avatar, file: GlbFile, config: ExportConfig) -> dict:
    """The material's JSON, its pictures added to `file`; a map that is constant on the atlas becomes a factor."""
    maps = avatar.textures
    used = maps.coverage if maps.coverage.any() else np.ones_like(maps.coverage)
    pbr: dict = {"metallicFactor": 0.0, "roughnessFactor": float(avatar.roughness)}
    material: dict = {"name": f"{avatar.name}_material", "pbrMetallicRoughness": pbr}

    base = encode_srgb(maps.diffuse)
    if _constant(base, used):
        pbr["baseColorFactor"] = [*np.clip(maps.diffuse[used].mean(0, np.float64), 0, 1).tolist(), 1.0]
    else:
        pbr["baseColorTexture"] = _texture(file, base, "diffuse", "diffuse albedo, sRGB encoded", config)

    normal = encode_normal(maps.normal_tangent)
    if not (normal[used] == encode_normal(FLAT_NORMAL)).all():
        # Always PNG: JPEG of quality 92 turns a head's normals by 1.4 degrees in the worst hundredth and by 15 at the
        # borders of charts, which highlights show.
        text = {"Description": "tangent-space normal (n + 1) / 2, linear, +Y up"}
        material["normalTexture"] = {"index": file.add_texture(encode_png(normal, text), "normal")}

    if maps.occlusion is not None:
        # Red is read; three equal channels look like what they are in any viewer. Open everywhere says nothing.
        codes = quantised(maps.occlusion)
        if not (codes[used] == 255).all():
            rgb = np.repeat(codes[..., None], 3, -1)
            material["occlusionTexture"] = _texture(file, rgb, "occlusion", "share of open sky, linear", config)

    form = _colour_form if config.specular_form == "color" else _factor_form
    material["extensions"] = {"KHR_materials_specular": form(maps.specular_f0, used, file, config)}
    return material


def _colour_form(specular_f0: np.ndarray, used: np.ndarray, file: GlbFile, config: ExportConfig) -> dict:
    """F0 as a colour; the factor may pass 1, so S / 0.04 there keeps the texture within 8 bits whatever S."""
    largest = _largest(specular_f0, used)
    if largest <= 0:
        # A colour of 0 would leave the reflection at grazing angles.
        return {"specularFactor": 0.0}
    codes = encode_srgb(specular_f0 / largest)
    if _constant(codes, used):
        return {"specularColorFactor": [_mean(specular_f0, used) / F0_OF_IOR_1_5] * 3}
    said = "F0 / (0.04 specularColorFactor), sRGB encoded"
    rgb = np.repeat(codes[..., None], 3, -1)
    return {
        "specularColorTexture": _texture(file, rgb, "specular", said, config),
        "specularColorFactor": [largest / F0_OF_IOR_1_5] * 3,
    }


def _factor_form(specular_f0: np.ndarray, used: np.ndarray, file: GlbFile, config: ExportConfig) -> dict:
    """F0 as a weight, which may not pass 1: what is above 0.04 is lent to the colour's factor."""
    largest = _largest(specular_f0, used)
    gain = max(largest / F0_OF_IOR_1_5, 1.0)
    extension: dict = {} if gain == 1.0 else {"specularColorFactor": [gain] * 3}
    codes = quantised(specular_f0 / largest) if largest > 0 else np.zeros(used.shape, np.uint8)
    if _constant(codes, used):
        return {**extension, "specularFactor": min(_mean(specular_f0, used) / (F0_OF_IOR_1_5 * gain), 1.0)}
    # The weight is read from alpha, which JPEG has not; the colours there are of no account.
    rgba = np.concatenate([np.full((*codes.shape, 3), 255, np.uint8), codes[..., None]], -1)
    text = {"Description": "alpha: F0 / (0.04 specularColorFactor specularFactor), linear"}
    return {
        **extension,
        "specularTexture": {"index": file.add_texture(encode_png(rgba, text), "specular")},
        "specularFactor": min(largest / (F0_OF_IOR_1_5 * gain), 1.0),
    }


def _texture(file: GlbFile, texels: np.ndarray, name: str, description: str, config: ExportConfig) -> dict:
    if config.jpeg_quality is None:
        return {"index": file.add_texture(encode_png(texels, {"Description": description}), name)}
    return {"index": file.add_texture(encode_jpeg(texels, config.jpeg_quality), name, "image/jpeg")}


def _constant(codes: np.ndarray, used: np.ndarray) -> bool:
    return constant_map(codes / 255.0, used) is not None


def _largest(specular_f0: np.ndarray, used: np.ndarray) -> float:
    return float(np.clip(specular_f0[used], 0.0, 1.0).max())


def _mean(specular_f0: np.ndarray, used: np.ndarray) -> float:
    return float(specular_f0[used].mean(dtype=np.float64))
