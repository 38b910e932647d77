"""Write the baked maps as files of their own; docs/formats.md says what each holds."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sira_assets.asset.encoding import encode_ks, encode_normal, encode_srgb, quantised
from sira_assets.asset.exr_header import colour_header, data_header
from sira_assets.asset.png import encode_png
from sira_assets.atomic import write_bytes
from sira_assets.scene.image import write_exr
from sira_assets.texture.texture_set import TextureSet


@dataclass(frozen=True)
class TextureFiles:
    """Where `write_textures` put each map."""

    diffuse: Path
    specular: Path
    specular_exr: Path
    normal: Path
    normal_exr: Path
    irradiance: Path
    irradiance_exr: Path
    occlusion: Path | None = None
    position: Path | None = None
    radiance: Path | None = None
    visibility: tuple[Path, ...] = ()


def write_textures(textures: TextureSet, folder: str | Path) -> TextureFiles:
    """Write diffuse, specular, normal and irradiance as PNG, and as EXR where eight bits are too few.

    PNG: diffuse sRGB(a); specular ks = s / 0.04 on a linear scale 0..2; normal (n + 1) / 2, +Y up; irradiance
    sRGB(E / E_white), for looking at, with E_white in the metadata; occlusion, if it was baked, linear. EXR: specular
    F0, normal and irradiance in float32; position, radiance and each lobe's visibility where they were baked.

    Parameters
    ----------
    folder : made when it does not exist
    """
    folder = Path(folder)
    names = {
        "diffuse": folder / "diffuse.png",
        "specular": folder / "specular.png",
        "specular_exr": folder / "specular.exr",
        "normal": folder / "normal.png",
        "normal_exr": folder / "normal.exr",
        "irradiance": folder / "irradiance.png",
        "irradiance_exr": folder / "irradiance.exr",
    }
    files = TextureFiles(**names)
    white = irradiance_white(textures)
    for path, texels, description in (
        (files.diffuse, encode_srgb(textures.diffuse), "diffuse albedo, linear Rec. 709, sRGB encoded"),
        (files.specular, encode_ks(textures.specular_f0), "specular ks = 2 value/255, linear; F0 = 0.04 ks"),
        (files.normal, encode_normal(textures.normal_tangent), "tangent-space normal (n + 1)/2, linear, +Y up"),
        (
            files.irradiance,
            encode_srgb(textures.irradiance / white),
            f"irradiance / {white:.6g}, sRGB encoded, clipped; irradiance.exr holds the values",
        ),
    ):
        write_bytes(path, encode_png(texels, {"Description": description}))
    if textures.occlusion is not None:
        files = replace(files, occlusion=folder / "occlusion.png")
        text = {"Description": "share of the sky that the head leaves open, linear"}
        write_bytes(files.occlusion, encode_png(quantised(textures.occlusion), text))
    for path, values, header in (
        (files.specular_exr, textures.specular_f0, data_header("specular albedo F0, unitless")),
        (files.normal_exr, textures.normal_tangent, data_header("unit normal in the tangent frame, R G B = x y z")),
        (files.irradiance_exr, textures.irradiance, colour_header("irradiance of the estimated light")),
    ):
        write_exr(path, np.ascontiguousarray(values, np.float32), header=header)
    return _write_further(textures, folder, files)


def _write_further(textures: TextureSet, folder: Path, files: TextureFiles) -> TextureFiles:
    """The maps that are baked on request only, as EXR."""
    if textures.position is not None:
        files = replace(files, position=folder / "position.exr")
        write_exr(files.position, textures.position, header=data_header("position, scene world, R G B = x y z"))
    if textures.radiance is not None:
        files = replace(files, radiance=folder / "radiance.exr")
        write_exr(files.radiance, textures.radiance, header=colour_header("radiance seen along the normal"))
    if textures.visibility is not None:
        count = textures.visibility.shape[-1]
        files = replace(files, visibility=tuple(folder / f"visibility_{k:02d}.exr" for k in range(count)))
        for k, path in enumerate(files.visibility):
            said = data_header(f"share of the light of lobe {k} of lights.json that arrives")
            write_exr(path, np.ascontiguousarray(textures.visibility[..., k]), header=said)
    return files


def irradiance_white(textures: TextureSet) -> float:
    """The irradiance that irradiance.png shows as white: the 99.5th percentile of the brightest channel on the atlas.

    A percentile, since one texel in a sharp lamp's centre should not darken the whole picture; 1 where all is black.
    """
    used = textures.irradiance[textures.coverage] if textures.coverage.any() else textures.irradiance.reshape(-1, 3)
    white = float(np.quantile(used.max(-1), 0.995))
    return white if white > 0 else 1.0
