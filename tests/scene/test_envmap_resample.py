"""Maps at another size and turned: energy, exact cases, agreement with turned gaussians."""

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.scene.envmap import EnvironmentMap, envmap_from_sg
from sira_assets.scene.envmap_resample import envmap_resized, envmap_rotated, envmap_sampled, envmap_yawed
from sira_assets.scene.sg_light import SGLight


def yaw(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def tilt(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def energy(env):
    return (env.radiance * env.solid_angles()[..., None]).sum((0, 1))


@pytest.mark.parametrize(("old", "new"), [(32, 16), (32, 7), (7, 32), (1, 5), (48, 1), (30, 20)])
def test_resizing_keeps_energy_and_constants(old, new):
    env = EnvironmentMap(np.random.default_rng(0).random((old, 2 * old, 3)) ** 8)
    small = envmap_resized(env, new)
    assert small.radiance.shape == (new, 2 * new, 3)
    assert energy(small) == pytest.approx(energy(env), rel=1e-6)  # float32 pixels
    flat = envmap_resized(EnvironmentMap(np.full((old, 2 * old, 3), 0.7)), new)
    assert np.abs(flat.radiance - np.float32(0.7)).max() < 1e-6


def test_a_map_split_and_joined_is_itself():
    env = EnvironmentMap(np.random.default_rng(1).random((6, 12, 3)))
    assert np.abs(envmap_resized(envmap_resized(env, 18), 6).radiance - env.radiance).max() < 1e-6
    assert envmap_resized(env, 6) is env


def test_yaw_by_pixels_is_exact():
    env = EnvironmentMap(np.random.default_rng(2).random((16, 32, 3)))
    step = 360 / 32
    assert np.array_equal(envmap_yawed(env, 3 * step).radiance, np.roll(env.radiance, -3, 1))
    assert np.array_equal(envmap_yawed(envmap_yawed(env, 77 * step), -77 * step).radiance, env.radiance)
    assert np.array_equal(envmap_yawed(env, 360.0).radiance, env.radiance)
    # +Z, the centre, goes to +X, a quarter from the left.
    spot = np.zeros((16, 32, 3))
    spot[8, 16] = 1
    assert np.argwhere(envmap_yawed(EnvironmentMap(spot), 90).radiance[..., 0]).tolist() == [[8, 8]]


def test_yaw_between_pixels_keeps_each_rows_energy_and_agrees_with_the_rotation():
    env = EnvironmentMap(np.random.default_rng(3).random((16, 32, 3)))
    turned = envmap_yawed(env, 37.3)
    assert np.abs(turned.radiance.sum(1) - env.radiance.sum(1)).max() < 1e-5
    assert np.abs(envmap_rotated(env, yaw(37.3), samples=1).radiance - turned.radiance).max() < 1e-5


def test_turned_maps_are_maps_of_turned_gaussians():
    light = SGLight([[0.3, 0.2, 0.8], [0, 1, 0], [-0.5, -0.6, 0]], [30.0, 8.0, 50.0], [[1, 2, 3], [1, 1, 1], [2, 1, 0]])
    env = envmap_from_sg(light, 96)
    for turn in (tilt(0), tilt(1), yaw(40)):
        expected = envmap_from_sg(light.rotated(turn), 96)
        found = envmap_rotated(env, turn)
        # The lobe of 50 is 4 pixels wide: bilinear steps and the mean over a pixel each cut its peak by up to
        # lambda h^2 / 8, 0.7 %.
        assert np.abs(found.radiance - expected.radiance).max() < 0.02 * expected.radiance.max()
        assert energy(found) == pytest.approx(energy(expected), rel=1e-3)


def test_identity_constant_and_poles():
    env = EnvironmentMap(np.random.default_rng(4).random((12, 24, 3)))
    assert np.abs(envmap_rotated(env, np.eye(3), samples=1).radiance - env.radiance).max() < 1e-6
    flat = EnvironmentMap(np.full((12, 24, 3), 2.0))
    assert np.abs(envmap_rotated(flat, tilt(5)).radiance - 2.0).max() < 1e-6
    # At a pole, from whichever side, it is the mean of the two pixels that face each other there.
    for side in ([1e-9, 1, 0], [0, 1, 1e-9], [0, 1, 0]):
        value = envmap_sampled(env, np.array(side, float))
        pairs = 0.5 * (env.radiance[0] + np.roll(env.radiance[0], 12, 0))
        assert pairs.min(0).min() - 1e-6 <= value.min()
        assert value.max() <= pairs.max() + 1e-6


def test_refusals():
    env = EnvironmentMap(np.zeros((2, 4, 3)))
    for bad in (np.eye(4), -np.eye(3), 2 * np.eye(3), np.full((3, 3), np.nan)):
        with pytest.raises(InputError, match="rotation"):
            envmap_rotated(env, bad)
    with pytest.raises(InputError, match="sample"):
        envmap_rotated(env, np.eye(3), samples=0)
    with pytest.raises(InputError, match="finite"):
        envmap_yawed(env, np.nan)
    with pytest.raises(InputError, match="row"):
        envmap_resized(env, 0)
