"""The asset renderer: furnaces, known shadows, invariances, and glTF's own rules."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from assets import asset, ball, camera, constant, lamp, material, plate

from sira_assets.errors import InputError
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.relight import render
from sira_assets.relight.cameras import rotation_about
from sira_assets.relight.glb_model import Texture
from sira_assets.relight.gltf_shading import grazing_share
from sira_assets.relight.render import light_asset, render_asset, see_asset
from sira_assets.relight.surface import Surface
from sira_assets.scene.sg_light import SGLight

MATT = material(base=(1.0, 1.0, 1.0), weight=0.0)


def test_a_white_matt_ball_vanishes_in_a_white_furnace():
    made = render_asset(ball(MATT), camera(), constant(), shadows=False)
    # pixels that the ball covers fully; 1e-4: float32 and the accurate grade's own error
    assert np.abs(made.radiance[made.alpha == 1] - 1.0).max() < 1e-4
    # premultiplied: at the rim radiance is the share of covered samples
    assert np.abs(made.radiance[..., 1] - made.alpha).max() < 1e-4


def test_a_shiny_ball_returns_no_more_than_it_gets():
    made = render_asset(ball(material(base=(1, 1, 1), f0=0.3)), camera(), constant(), shadows=False)
    assert made.radiance[made.alpha == 1].max() < 1.0 + 1e-3
    lossless = render_asset(
        ball(material(base=(1, 1, 1), f0=0.3)), camera(), constant(), shadows=False, gltf_weighting=False
    )
    assert lossless.radiance[24, 24, 0] > 1.25  # diffuse and specular simply added: what 1 - F is there to prevent


def test_a_plate_under_an_overhead_lamp_is_white_paper_and_glTF_takes_F_of_it():
    floor = asset(plate(0.5, 0.0), material(base=(0.8, 0.4, 0.2), f0=0.1, roughness=0.2))
    above = lamp([0, 0, 1])
    with_f, without = (
        render_asset(floor, camera(), above, shadows=False, gltf_weighting=w).diffuse[24, 24] for w in (True, False)
    )
    # The lamp's irradiance is pi (1 - 1 / sharpness ...): 1e-4 at sharpness 1e4. Head-on, v . h = 1 and F = F0.
    assert without == pytest.approx([0.8, 0.4, 0.2], rel=3e-4)
    assert with_f == pytest.approx(0.9 * without, rel=1e-4)


def test_the_shadow_of_a_plate_is_its_own_outline():
    """A lamp straight above, the camera aside: the floor is dark under the plate only."""
    floor, lid = plate(0.5, 0.0, 100), plate(0.05, 0.05, 10)
    vertices, faces = (floor.vertices, lid.vertices), (floor.faces, lid.faces + len(floor.vertices))
    both = TriangleMesh(np.concatenate(vertices), np.concatenate(faces))
    aside = replace(
        camera(64, focal=2.0), world_from_camera=rotate(camera().world_from_camera, rotation_about([0, 1, 0], 60.0))
    )
    seen = see_asset(asset(both, MATT), aside, supersample=1)
    made = render_asset(asset(both, MATT), aside, lamp([0, 0, 1], 1e6), shadows=True, supersample=1, rays=16)
    x, y, z = seen.surface.points.T
    light = made.diffuse.reshape(-1, 3)[seen.index, 0]
    under = (z < 0.01) & (np.maximum(np.abs(x), np.abs(y)) < 0.049)
    beside = (z < 0.01) & (np.maximum(np.abs(x), np.abs(y)) > 0.051)
    assert under.sum() > 20
    assert light[under].max() < 1e-6
    # 1e-3: the lamp is a milliradian wide at sharpness 1e6, so that under 5 cm the shadow's edge is 0.05 mm wide
    assert light[beside].min() == pytest.approx(1.0, abs=1e-3)
    assert light[z > 0.01].min() == pytest.approx(1.0, abs=1e-3)
    share = made.visibility.reshape(-1)[seen.index]
    assert share[under].max() == 0.0
    assert share[beside].min() == pytest.approx(1.0, abs=1e-6)


def rotate(pose: np.ndarray, turn: np.ndarray) -> np.ndarray:
    out = pose.copy()
    out[:3] = turn @ pose[:3]
    return out


def test_a_convex_body_casts_no_shadow_on_itself_where_it_faces_the_lamp():
    light = SGLight([[0.3, 0.2, 1.0]], [200.0], [[3.0, 2.0, 1.0]])
    free, cast = (render_asset(ball(), camera(), light, shadows=s, supersample=1) for s in (False, True))
    facing = free.diffuse[..., 0] > 0.15 * free.diffuse.max()
    # Facets lie under the ball's smooth normals, so near the terminator, and only there, rays meet their own facet.
    assert np.abs(cast.diffuse - free.diffuse)[facing].max() < 1e-6


def test_turning_head_light_and_camera_together_changes_nothing():
    turn = rotation_about([0.2, 1.0, -0.4], 77.0)
    light = SGLight([[0.5, 0.5, 1.0], [-1, 0, 0.2]], [30.0, 4.0], [[2, 2, 1], [0.3, 0.4, 0.5]])
    here = render_asset(ball(level=4), camera(), light, shadows=False)
    mesh = ball(level=4)
    turned = replace(mesh, vertices=mesh.vertices @ turn.T, normals=mesh.normals @ turn.T)
    there_camera = replace(camera(), world_from_camera=rotate(camera().world_from_camera, turn))
    there = render_asset(turned, there_camera, light.rotated(turn), shadows=False)
    # Rays through an edge of the outline may fall on either side of it in single precision.
    assert (np.abs(here.alpha - there.alpha) > 1e-6).mean() < 2e-3
    inside = (here.alpha == 1) & (there.alpha == 1)
    assert np.abs(here.radiance - there.radiance)[inside].max() < 2e-4


def test_alpha_is_the_balls_outline_and_converges_with_samples():
    size, focal = 48, 4.0
    exact = np.pi * (0.1 * focal * size / np.sqrt(1 - 0.01)) ** 2
    fine = render_asset(ball(MATT), camera(size, focal=focal), constant(), shadows=False, supersample=6)
    # facets of a level-5 ball: their outline lacks 0.2 % of the disc
    assert fine.alpha.sum() == pytest.approx(exact, rel=4e-3)
    assert set(np.unique(render_asset(ball(MATT), camera(), constant(), shadows=False, supersample=1).alpha)) == {0, 1}


def test_a_metal_has_no_diffuse_and_shines_in_its_own_colour():
    gold = material(base=(1.0, 0.7, 0.3), metallic=1.0, roughness=0.4)
    made = render_asset(ball(gold), camera(), constant(), shadows=False)
    assert made.diffuse.max() == 0.0
    # head-on F = base, and a constant light returns F times the albedo of a white rough mirror
    white = render_asset(ball(replace(gold, base_factor=np.ones(3))), camera(), constant(), shadows=False)
    ratio = made.specular[24, 24] / white.specular[24, 24]
    # Schlick's fifth power, spread by roughness 0.4, lifts a dark F0 by at most 0.2 %
    assert ratio == pytest.approx([1.0, 0.7, 0.3], abs=2e-3)


def test_coloured_F0_is_each_channel_on_its_own():
    light = SGLight([[0.4, 0.3, 1.0]], [25.0], [[2.0, 2.0, 2.0]])
    colours = (1.5, 0.6, 0.0)
    coloured = render_asset(ball(material(colour=colours)), camera(), light, shadows=False)
    for k, factor in enumerate(colours):
        grey = render_asset(ball(material(colour=(factor,) * 3)), camera(), light, shadows=False)
        assert np.abs(coloured.specular[..., k] - grey.specular[..., k]).max() < 1e-5


def test_a_weight_scales_the_whole_specular_lobe():
    light = SGLight([[0.4, 0.3, 1.0]], [25.0], [[2.0, 2.0, 2.0]])
    full, half = (render_asset(ball(material(weight=w)), camera(), light, shadows=False).specular for w in (1.0, 0.5))
    assert np.abs(half - 0.5 * full).max() < 1e-5


def test_a_roughness_texture_is_the_factor_where_it_says_so():
    light = SGLight([[0.4, 0.3, 1.0]], [25.0], [[2.0, 2.0, 2.0]])
    texels = np.full((4, 4, 4), 0.5, np.float32)  # 0.5 * 0.75 = 0.375, which is twelve steps of 1/32
    textured = replace(material(roughness=0.75), metallic_roughness_texture=Texture(texels), metallic=0.0)
    plain = render_asset(ball(material(roughness=0.375)), camera(), light, shadows=False).radiance
    assert np.abs(render_asset(ball(textured), camera(), light, shadows=False).radiance - plain).max() < 1e-6


def test_a_surface_seen_from_behind_is_lit_on_that_side():
    floor = plate(0.5, 0.0)
    behind = TriangleMesh(floor.vertices, floor.faces[:, ::-1], -floor.normals)
    front, back = (render_asset(asset(m, MATT), camera(), lamp([0, 0, 1]), shadows=False) for m in (floor, behind))
    assert np.array_equal(front.radiance, back.radiance)


@pytest.mark.parametrize("sharpness", [0.0, 1.0, 10.0, 100.0])
def test_the_diffuse_loss_by_F_against_quadrature(sharpness):
    rng = np.random.default_rng(3)
    height = 160
    theta, phi = (np.arange(height) + 0.5) * np.pi / height, (np.arange(2 * height) + 0.5) * np.pi / height
    w = np.stack(np.broadcast_arrays(np.sin(theta)[:, None] * np.cos(phi), np.sin(theta)[:, None] * np.sin(phi),
                                     np.cos(theta)[:, None]), -1).reshape(-1, 3)  # fmt: skip
    received = np.maximum(w[:, 2], 0.0) * np.repeat(np.sin(theta), 2 * height)
    head_on = (received * np.exp(sharpness * (w[:, 2] - 1.0))).sum()
    normal = np.array([0.0, 0.0, 1.0])
    for _ in range(25):
        axis, view = rng.normal(size=3), rng.normal(size=3)
        axis, view = axis / np.linalg.norm(axis), view / np.linalg.norm(view) * [1, 1, np.sign(view[2])]
        light = received * np.exp(sharpness * (w @ axis - 1.0))
        grazing = (1.0 - np.sqrt(np.maximum(0.5 + 0.5 * w @ view, 0.0))) ** 5
        n, v, a = (torch.tensor(x[None]) for x in (normal, view, axis))
        ours = grazing_share(n, v, a, torch.tensor([sharpness], dtype=torch.float64)).item()
        # what the docstring states
        assert abs(ours * light.sum() - (light * grazing).sum()) < 0.013 * head_on


def test_light_without_lobes_is_black():
    made = light_asset(see_asset(ball(), camera()), SGLight(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))))
    assert made.radiance.max() == 0.0
    assert made.alpha.max() == 1.0


def test_a_picture_cast_in_bands_is_the_very_same(monkeypatch):
    at = camera(37)
    whole = see_asset(ball(), at, supersample=3)
    cast, sizes = Raycaster.cast, []

    def counted(self, origins, directions):
        sizes.append(len(directions))
        return cast(self, origins, directions)

    monkeypatch.setattr(Raycaster, "cast", counted)
    monkeypatch.setattr(render, "_RAYS_AT_ONCE", 700)
    bands = see_asset(ball(), at, supersample=3)
    assert max(sizes) == 6 * 111  # rows that fit
    assert sum(sizes) == 111 * 111  # and the last band is what is left
    for name in ("index", "normals", "view"):
        np.testing.assert_array_equal(getattr(bands, name), getattr(whole, name))
    for name in Surface.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(bands.surface, name), getattr(whole.surface, name))


def test_cameras_that_see_nothing_are_said():
    backwards = replace(camera(), world_from_camera=camera().world_from_camera @ np.diag([1.0, -1, -1, 1]))
    with pytest.raises(InputError, match="whole avatar behind it"):
        see_asset(ball(), backwards)
    aside = rotate(camera().world_from_camera, np.eye(3))
    aside[0, 3] = 5.0
    with pytest.raises(InputError, match="looks past it"):
        see_asset(ball(), replace(camera(), world_from_camera=aside))
    with pytest.raises(InputError, match="1 to 8"):
        see_asset(ball(), camera(), supersample=9)
