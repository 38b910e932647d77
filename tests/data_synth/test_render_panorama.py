"""Panoramas as light: drawn as they shine, integrated as quadrature does, alike to the gaussians behind them."""

import numpy as np
import pytest

from data_synth.render_light import direct_light
from data_synth.render_panorama import PanoramaSource
from data_synth.render_source import LUMINANCE, SGSource
from sira_assets.errors import InputError
from sira_assets.scene.envmap import EnvironmentMap, envmap_from_sg
from sira_assets.scene.sg_light import SGLight

LIGHT = SGLight([[0.3, 0.8, 0.5], [-0.7, 0.1, 0.7]], [30.0, 2.0], [[6, 5, 4], [0.3, 0.5, 0.9]])


def random_map(height=12, seed=0) -> EnvironmentMap:
    """Rough, with black pixels and a sun of one pixel."""
    rng = np.random.default_rng(seed)
    radiance = rng.exponential(size=(height, 2 * height, 3)) * (rng.random((height, 2 * height, 1)) > 0.4)
    radiance[3, 17] = [900, 800, 600]
    return EnvironmentMap(radiance)


def unit(count, seed=1):
    x = np.random.default_rng(seed).normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def test_pixels_are_drawn_as_often_as_they_shine():
    envmap = random_map()
    source, count = PanoramaSource(envmap), 200_000
    x, y, z = source.draw(0, *np.random.default_rng(3).random((2, count), np.float32))
    row = np.minimum((np.arccos(y.astype(np.float64)) * 12 / np.pi).astype(int), 11)
    turn = np.arctan2(x, -z).astype(np.float64) / (2 * np.pi)
    column = np.minimum(((turn - np.floor(turn)) * 24).astype(int), 23)
    drawn = np.bincount(row * 24 + column, minlength=288) / count
    mass = ((envmap.radiance @ LUMINANCE) * envmap.solid_angles()).ravel()
    expected = mass / mass.sum()
    # Five standard errors of each pixel's count, and one draw in 50,000 that float32 puts beyond a pixel's edge.
    assert (np.abs(drawn - expected) < 5 * np.sqrt(expected / count) + 2e-5).all()


def test_density_is_that_of_the_draws_and_integrates_to_one():
    envmap = random_map()
    g, density = PanoramaSource(envmap).evaluate(*np.moveaxis(envmap.directions(), -1, 0).astype(np.float32))
    assert np.array_equal(np.moveaxis(g, 0, -1), envmap.radiance)
    assert (density[0] * envmap.solid_angles()).sum() == pytest.approx(1.0, rel=1e-5)


def test_irradiance_is_the_sum_over_pixels_and_that_of_the_gaussians():
    envmap, normals = envmap_from_sg(LIGHT, 128), unit(50)
    ours = PanoramaSource(envmap).irradiance(normals)
    cosine = np.maximum(np.einsum("ijk,pk->pij", envmap.directions(), normals), 0)
    summed = np.einsum("pij,ij,ijc->pc", cosine, envmap.solid_angles(), envmap.radiance)
    # Blocks of 3.75 degrees that the horizon cuts: the square of their size, 4e-3, over a few, of the largest value.
    assert np.abs(ours - summed).max() < 2e-3 * summed.max()
    by_gaussians = SGSource(LIGHT).irradiance(normals) @ LIGHT.amplitude
    # Sampled at 128 rows, a lobe 10 degrees wide is off by less than 1 % at the terminator.
    assert np.abs(ours - by_gaussians).max() < 5e-3 * by_gaussians.max()


@pytest.mark.parametrize("height", [4, 128])
def test_lights_a_surface_as_the_gaussians_do(height):
    """Through the whole integrator, with half of the sky hidden and a highlight."""
    source = PanoramaSource(envmap_from_sg(LIGHT, 128) if height > 4 else EnvironmentMap(np.ones((4, 8, 3))))
    light = LIGHT if height > 4 else SGLight([[0, 1, 0]], [1e-6], [[1, 1, 1]])
    points = 256
    n, v = np.tile([0.0, 0.6, 0.8], (points, 1)), np.tile([0.0, 0.0, 1.0], (points, 1))
    arguments = {"roughness": 0.4, "directions": 128}
    rotations = np.random.default_rng(4).random((points, 3))
    albedo, f0 = np.full((points, 3), 0.5), np.full(points, 0.04)

    def hidden(index, w):
        return w[:, 0] > 0.1

    one, two = (direct_light(n, v, albedo, f0, s, hidden, rotations, **arguments) for s in (source, light))
    for name in ("diffuse", "specular", "specular_unshadowed", "diffuse_unshadowed"):
        a, b = getattr(one, name), getattr(two, name)
        error = 4 * np.sqrt((a.var(0) + b.var(0)) / points)
        # Four standard errors of both, and the map's pixels of 1.4 degrees.
        assert (np.abs(a.mean(0) - b.mean(0)) < error + 4e-3 * b.mean(0)).all(), name


def test_black_and_negative_maps_are_refused():
    for value in (0.0, -1.0):
        with pytest.raises(InputError):
            PanoramaSource(EnvironmentMap(np.full((4, 8, 3), value)))
