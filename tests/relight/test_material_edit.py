"""Material edits: what they change, what they leave, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest
from assets import ball, camera, constant, material

from sira_assets.errors import InputError
from sira_assets.relight.glb_model import Texture
from sira_assets.relight.material_edit import MaterialEdit, edit_material
from sira_assets.relight.render import render_asset
from sira_assets.relight.surface import mesh_of, surface_at


def shown(model):
    return render_asset(model, camera(), constant(), shadows=False, supersample=1, gltf_weighting=False)


def test_no_edit_is_no_change_and_the_asset_given_stays_as_it_was():
    model = ball(material(base=(0.5, 0.4, 0.3)))
    assert np.array_equal(shown(edit_material(model, MaterialEdit())).radiance, shown(model).radiance)
    before = model.materials[0].base_factor.copy()
    edit_material(model, MaterialEdit(0.0, 0.3, 2.0, (1, 0, 0)))
    assert (model.materials[0].base_factor == before).all()
    assert model.materials[0].roughness == 0.5


def test_gain_and_tint_multiply_the_albedo_and_stop_at_white():
    model = ball(material(base=(0.5, 0.4, 0.3)))
    plain, edited = shown(model), shown(edit_material(model, MaterialEdit(albedo_gain=1.5, albedo_tint=(1, 0.5, 4.0))))
    factor = np.array([1.5, 0.75, 1 / 0.3])  # 0.3 * 6 is held at 1
    assert np.abs(edited.diffuse - plain.diffuse * factor).max() < 1e-5
    assert np.array_equal(edited.specular, plain.specular)


def test_specular_scale_fades_to_nothing_and_grows_in_F0():
    model = ball()
    face, weights = np.zeros(1, np.int64), np.full((1, 3), 1 / 3)

    def fresnel(scale):
        surface = surface_at(edit_material(model, MaterialEdit(scale)), mesh_of(model), face, weights)
        return [*surface.f0[0], surface.f90[0]]

    assert fresnel(1.0) == pytest.approx([0.04] * 3 + [1.0])
    assert fresnel(0.5) == pytest.approx([0.02] * 3 + [0.5])
    assert fresnel(3.0) == pytest.approx([0.12] * 3 + [1.0])
    assert fresnel(100.0) == pytest.approx([1.0] * 4)
    assert shown(edit_material(model, MaterialEdit(0.0))).specular.max() == 0.0


def test_roughness_replaces_factor_and_texture_but_not_metal():
    texels = np.zeros((2, 2, 4), np.float32)
    texels[..., 1], texels[..., 2] = 0.2, 0.25
    rough = replace(material(roughness=1.0, metallic=1.0), metallic_roughness_texture=Texture(texels))
    model = edit_material(ball(rough), MaterialEdit(roughness=0.7))
    surface = surface_at(model, mesh_of(model), np.zeros(1, np.int64), np.full((1, 3), 1 / 3))
    assert surface.roughness[0] == pytest.approx(0.7)
    assert surface.diffuse[0] == pytest.approx(0.75 * 0.5)


@pytest.mark.parametrize(
    "wrong",
    [
        {"specular_scale": -1.0},
        {"roughness": 0.01},
        {"roughness": 1.5},
        {"albedo_gain": float("nan")},
        {"albedo_tint": (1.0, -0.1, 1.0)},
        {"albedo_tint": (1.0, 1.0)},
    ],
)
def test_edits_out_of_range_are_refused(wrong):
    with pytest.raises(InputError):
        MaterialEdit(**wrong)
