"""Edits of an asset's material, as a painter would ask for them; the geometry and the textures stay what they are."""

from dataclasses import dataclass, replace

import numpy as np

from sira_assets.errors import InputError
from sira_assets.relight.glb_model import GlbModel, Material
from sira_assets.relight.gltf_shading import ROUGHNESS_RANGE


@dataclass(frozen=True)
class MaterialEdit:
    """What to change, on every material of an asset.

    Parameters
    ----------
    specular_scale : >= 0. Below 1 the whole specular lobe of dielectrics fades (F0 and F90), to none at 0; above 1 F0
        grows, up to 1
    roughness : 0.05 to 1 in place of the asset's own, or None
    albedo_gain : >= 0, factor on the base colour
    albedo_tint : three factors >= 0 on the base colour's linear R, G, B

    Raises
    ------
    InputError : a value out of range.
    """

    specular_scale: float = 1.0
    roughness: float | None = None
    albedo_gain: float = 1.0
    albedo_tint: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self):
        factors = np.array([self.specular_scale, self.albedo_gain, *self.albedo_tint], np.float64)
        if len(factors) != 5 or not np.isfinite(factors).all() or (factors < 0).any():
            raise InputError(
                expected="a specular scale, an albedo gain and three factors of tint, all 0 or more",
                received=f"{self.specular_scale}, {self.albedo_gain}, {self.albedo_tint}",
                remedy="correct the edit",
            )
        low, high = ROUGHNESS_RANGE
        if self.roughness is not None and not low <= self.roughness <= high:
            raise InputError(
                expected=f"a roughness of {low} to {high:g}", received=f"{self.roughness}", remedy="correct the edit"
            )


def edit_material(model: GlbModel, edit: MaterialEdit) -> GlbModel:
    """The asset with its materials edited; albedo stays within 1 when it is looked up."""
    return replace(model, materials=tuple(_edited(material, edit) for material in model.materials))


def _edited(material: Material, edit: MaterialEdit) -> Material:
    own = edit.roughness is None
    # The texture's blue channel is metallic: without its green one that stays.
    texture = material.metallic_roughness_texture
    if not own and texture is not None:
        texels = texture.texels.copy()
        texels[..., 1] = 1.0
        texture = replace(texture, texels=texels)
    return replace(
        material,
        base_factor=material.base_factor * edit.albedo_gain * np.array(edit.albedo_tint, np.float64),
        specular_factor=material.specular_factor * min(edit.specular_scale, 1.0),
        specular_colour_factor=material.specular_colour_factor * max(edit.specular_scale, 1.0),
        roughness=material.roughness if own else float(edit.roughness),
        metallic_roughness_texture=texture,
    )
