"""Where light comes from: the asset's extras, lights.json, panoramas; and what is refused."""

import json

import numpy as np
import pytest
from assets import ball

from sira_assets.errors import InputError
from sira_assets.relight.light_source import own_light, read_light_source
from sira_assets.scene.envmap import envmap_from_sg, write_envmap
from sira_assets.scene.sg_light import SGLight

LIGHT = SGLight([[0.2, 0.4, 1.0], [-1.0, 0.3, 0.1]], [12.0, 3.0], [[2.0, 1.5, 1.0], [0.2, 0.3, 0.5]])


def test_the_assets_own_light():
    found = own_light(ball(level=2, extras={"light": {"frame": "scene world", **LIGHT.to_dict()}}))
    assert found.axis == pytest.approx(LIGHT.axis, abs=1e-15)
    assert (found.amplitude == LIGHT.amplitude).all()
    with pytest.raises(InputError, match="--lights"):
        own_light(ball(level=2))


def test_lights_json(tmp_path):
    (tmp_path / "lights.json").write_text(json.dumps(LIGHT.to_dict()))
    source = read_light_source(tmp_path / "lights.json")
    assert len(source.light) == 2
    assert source.panorama is None
    assert (source.scaled(3.0).light.amplitude == 3.0 * source.light.amplitude).all()


def test_a_panorama_becomes_lobes_of_the_same_light(tmp_path):
    write_envmap(tmp_path / "studio.exr", envmap_from_sg(LIGHT, 32))
    source = read_light_source(tmp_path / "studio.exr")
    normals = np.random.default_rng(0).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    truth, found = (irradiance(light, normals) for light in (LIGHT, source.light))
    # 2 % RMS of the mean is what the fit is asked for
    assert np.sqrt(((truth - found) ** 2).mean()) < 0.025 * truth.mean()
    assert source.panorama.radiance.shape == (32, 64, 3)
    assert (source.scaled(0.5).panorama.radiance == np.float32(0.5) * source.panorama.radiance).all()


def irradiance(light: SGLight, normals: np.ndarray) -> np.ndarray:
    """By quadrature over a lat-long grid."""
    grid = envmap_from_sg(light, 64)
    w, omega = grid.directions().reshape(-1, 3), grid.solid_angles().reshape(-1, 1)
    return np.maximum(normals @ w.T, 0.0) @ (light.radiance(w) * omega)


def test_what_is_no_light_is_said_in_one_line(tmp_path):
    cases = {
        "none.json": None,
        "list.json": "[1, 2]",
        "broken.json": '{"sgs": [',
        "empty.json": '{"sgs": []}',
        "dark.json": json.dumps({"sgs": [{"axis": [0, 0, 1], "sharpness": 2, "amplitude": 0}]}),
        "negative.json": json.dumps({"sgs": [{"axis": [0, 0, 1], "sharpness": -2, "amplitude": 1}]}),
        "words.json": json.dumps({"sgs": "bright"}),
        "lights.txt": "{}",
        "text.exr": "no panorama",
        "text.hdr": "no panorama",
    }
    for name, text in cases.items():
        if text is not None:
            (tmp_path / name).write_text(text)
        with pytest.raises(InputError) as said:
            read_light_source(tmp_path / name)
        assert "\n" not in str(said.value), name


def test_a_square_or_black_panorama_is_refused(tmp_path):
    from sira_assets.scene.exr import write_exr

    write_exr(tmp_path / "square.exr", np.ones((8, 8, 3), np.float32))
    write_exr(tmp_path / "black.exr", np.zeros((8, 16, 3), np.float32))
    with pytest.raises(InputError, match="twice as wide"):
        read_light_source(tmp_path / "square.exr")
    with pytest.raises(InputError, match="black"):
        read_light_source(tmp_path / "black.exr")
