"""Rigs of lamps: what holds of every draw."""

import numpy as np
import pytest

from data_synth.lights import LUMINANCE, RIGS, Lamp, Rig, face_luminance, sample_exposure, sample_rig
from data_synth.render_irradiance import irradiance_per_lobe
from sira_assets.mesh.triangle_mesh import TriangleMesh


def test_every_draw_is_one_to_eight_lobes_within_the_stated_sharpness():
    seen = set()
    for seed in range(200):
        rig = sample_rig(np.random.default_rng(seed))
        light = rig.light()
        seen.add(rig.name)
        assert 1 <= len(light) <= 8
        assert light.sharpness.min() >= 0.05
        assert light.sharpness.max() <= 800
        assert light.amplitude.min() >= 0
        assert np.linalg.norm(light.axis, axis=1) == pytest.approx(np.ones(len(light)))
    assert seen == {name for name, *_ in RIGS}


def test_shares_of_the_rigs_sum_to_one():
    assert sum(share for *_, share in RIGS) == pytest.approx(1.0)


def test_the_same_seed_draws_the_same_rig():
    first, again = (sample_rig(np.random.default_rng(11)).light() for _ in range(2))
    assert np.array_equal(first.amplitude, again.amplitude)
    assert np.array_equal(first.axis, again.axis)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "axis"),
    [(0, 0, [0, 0, 1]), (90, 0, [1, 0, 0]), (0, 90, [0, 1, 0]), (-90, 0, [-1, 0, 0]), (180, 0, [0, 0, -1])],
)
def test_azimuth_turns_to_the_left_and_elevation_up(azimuth, elevation, axis):
    light = Rig("one", (Lamp(azimuth, elevation, 10.0, 1.0, np.ones(3)),)).light()
    assert light.axis[0] == pytest.approx(axis, abs=1e-12)


@pytest.mark.parametrize("sharpness", [0.05, 3.0, 700.0])
def test_power_is_the_luminance_of_the_irradiance_head_on(sharpness):
    light = Rig("one", (Lamp(30.0, 20.0, sharpness, 0.7, np.array([2.0, 1.0, 0.5])),)).light()
    irradiance = irradiance_per_lobe(light.axis, light.axis, light.sharpness) @ light.amplitude
    assert irradiance[0] @ LUMINANCE == pytest.approx(0.7, rel=1e-6)


def test_exposure_scales_with_the_light_and_favours_light_skin():
    rng = np.random.default_rng(2)
    mesh = TriangleMesh(rng.normal(size=(30, 3)), np.arange(30).reshape(10, 3))
    albedo, face = rng.uniform(0.1, 0.6, (30, 3)), np.arange(30) < 20
    light = sample_rig(rng).light()
    bright = face_luminance(mesh, albedo, light.scaled(3.0), face)
    assert bright == pytest.approx(3.0 * face_luminance(mesh, albedo, light, face))
    dark, pale = (sample_exposure(np.random.default_rng(4), luminance) for luminance in (0.06, 0.5))
    assert 0.05 < dark < pale < 0.5
