"""sh.json and the two environment maps say the light of lights.json."""

import json

import numpy as np
import pytest

from sira_assets.asset.lights import sh_dict, write_lights
from sira_assets.scene.envmap import read_envmap
from sira_assets.scene.envmap_sh import envmap_sh, sh_basis
from sira_assets.scene.exr import read_exr
from sira_assets.scene.sg_light import SGLight

SOFT = SGLight([[0.2, 0.5, 1.0], [-1.0, 0.3, 0.1]], [1.0, 4.0], [[1.0, 0.8, 0.6], [0.2, 0.5, 1.5]])


def quadrature(values, height):
    """Sum over a lat-long grid of values times solid angle."""
    theta = (np.arange(height) + 0.5) * np.pi / height
    weight = np.sin(theta)[:, None] * (np.pi / height) ** 2
    return (values * weight[..., None]).sum((0, 1))


def test_sh_json_is_the_projection_of_the_environment_map(tmp_path):
    write_lights(SOFT, tmp_path, height=128)
    said = json.loads((tmp_path / "sh.json").read_text())
    # Another road to the same numbers: the sampled map, projected pixel by pixel; midpoint samples of 1.4 degrees.
    assert np.array(said["radiance"]) == pytest.approx(envmap_sh(read_envmap(tmp_path / "envmap.exr")), abs=1e-3)
    assert len(said["order"]) == len(said["radiance"]) == len(said["irradiance"]) == 9


def test_the_order_that_is_written_is_the_order_of_the_numbers():
    polynomial = {"1": lambda x, y, z: 1 + 0 * x, "y": lambda x, y, z: y, "z": lambda x, y, z: z,
                  "x": lambda x, y, z: x, "xy": lambda x, y, z: x * y, "yz": lambda x, y, z: y * z,
                  "3z^2-1": lambda x, y, z: 3 * z * z - 1, "xz": lambda x, y, z: x * z,
                  "x^2-y^2": lambda x, y, z: x * x - y * y}  # fmt: skip
    w = np.random.default_rng(0).normal(size=(200, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    for k, name in enumerate(sh_dict(SOFT)["order"]):
        ratio = sh_basis(w)[:, k] / polynomial[name](*w.T)
        assert ratio == pytest.approx(np.full(200, ratio.mean()), rel=1e-9)
        assert ratio.mean() > 0


def test_irradiance_from_sh_json_is_that_of_the_light():
    height = 200
    theta = (np.arange(height) + 0.5) * np.pi / height
    phi = (np.arange(2 * height) + 0.5) * np.pi / height
    w = np.stack(np.broadcast_arrays(np.sin(theta)[:, None] * np.cos(phi), np.cos(theta)[:, None],
                                     np.sin(theta)[:, None] * np.sin(phi)), -1)  # fmt: skip
    radiance = sum(m * np.exp(k * (w @ a - 1))[..., None] for a, k, m in zip(SOFT.axis, SOFT.sharpness, SOFT.amplitude,
                                                                             strict=True))  # fmt: skip
    coefficients = np.array(sh_dict(SOFT)["irradiance"])
    brightest = 0.0
    errors = []
    for n in np.vstack([np.eye(3), -np.eye(3), SOFT.axis]):
        exact = quadrature(radiance * np.maximum(w @ n, 0)[..., None], height)
        errors.append(np.abs(sh_basis(n) @ coefficients - exact).max())
        brightest = max(brightest, exact.max())
    # Bands from 4 on are left out: 1.4 % at sharpness 5, less below.
    assert max(errors) < 0.014 * brightest


def test_radiance_hdr_holds_the_same_map(avatar, tmp_path):
    write_lights(avatar.light, tmp_path)
    exact, shared = read_exr(tmp_path / "envmap.exr"), read_envmap(tmp_path / "envmap.hdr").radiance
    # RGBE's mantissa has eight bits of the brightest channel.
    assert (np.abs(shared - exact) <= exact.max(-1, keepdims=True) / 128 + 1e-30).all()


def test_no_light_is_no_light(tmp_path):
    dark = SGLight(np.zeros((0, 3)), [], np.zeros((0, 3)))
    write_lights(dark, tmp_path)
    assert np.array(sh_dict(dark)["radiance"]).tolist() == np.zeros((9, 3)).tolist()
    assert read_envmap(tmp_path / "envmap.hdr").radiance.max() == 0
