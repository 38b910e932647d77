"""Panoramas to spherical gaussians: known lobes come back, energy is kept, extremes hold, residuals are true."""

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.fit.lobe_descent import Lobes, Rows, blurred_lobe, descended, kernel
from sira_assets.fit.panorama import PanoramaFitConfig, fit_panorama, irradiance_residual_on
from sira_assets.fit.panorama_cells import (
    cells_blurred,
    cells_irradiance,
    fibonacci_sphere,
    gathered_lobe,
    panorama_cells,
)
from sira_assets.numerics.sg_reference import irradiance_exact
from sira_assets.scene.envmap import EnvironmentMap, envmap_from_sg, read_envmap
from sira_assets.scene.exr import read_exr
from sira_assets.scene.sg_light import SGLight


def flux_of_map(env):
    return (env.radiance * env.solid_angles()[..., None]).sum((0, 1))


def flux_of_lobes(light):
    return (-2 * np.pi * np.expm1(-2 * light.sharpness) / light.sharpness) @ light.amplitude


# ---- what a panorama sends


@pytest.mark.parametrize("height", [1, 8, 100, 200])
def test_cells_hold_flux_and_moments_exactly(height):
    env = EnvironmentMap(np.random.default_rng(height).random((height, 2 * height, 3)))
    cells = panorama_cells(env)
    assert cells.flux.sum(0) == pytest.approx(flux_of_map(env), rel=1e-12)
    # Pixel moments by 12 Gauss nodes a side, exact to rounding.
    if height <= 8:
        nodes, weights = np.polynomial.legendre.leggauss(12)
        step = np.pi / height
        theta = (step * (np.arange(height)[:, None] + 0.5 * (nodes + 1))).reshape(-1)
        phi = (step * (np.arange(2 * height)[:, None] + 0.5 * (nodes + 1))).reshape(-1)
        y = np.broadcast_to(np.cos(theta)[:, None], (len(theta), len(phi)))
        w = np.stack([np.sin(theta)[:, None] * np.sin(phi), y, -np.sin(theta)[:, None] * np.cos(phi)], -1)
        row = np.tile(weights * step / 2, height) * np.sin(theta)
        fine = env.radiance.repeat(12, 0).repeat(12, 1)
        expected = np.einsum("hwc,hwk,h,w->ck", fine, w, row, np.tile(weights * step / 2, 2 * height))
        assert np.abs(cells.moment.sum(0) - expected).max() < 1e-9 * cells.flux.sum()


def test_quadrature_agrees_with_the_closed_form():
    light = SGLight([[0.6, 0.64, 0.48]], [12.0], [[1.0, 2.0, 0.5]])
    cells = panorama_cells(envmap_from_sg(light, 256))
    d = fibonacci_sphere(200)
    cosine = d @ light.axis[0]
    exact = irradiance_exact(cosine, 12.0)[:, None] * light.amplitude
    # Pixels of 0.7 degrees hold the lobe's value at their centre, cells of 1.4 degrees their mean: h^2 lambda / 24.
    assert np.abs(cells_irradiance(cells, d) - exact).max() < 1e-3 * exact.max()
    blurred = blurred_lobe(torch.tensor(cosine), torch.full((200,), 12.0, dtype=torch.float64), 30.0).numpy()
    assert np.abs(cells_blurred(cells, d, 30.0) - blurred[:, None] * light.amplitude).max() < 2e-3 * 2.0


def test_a_blurred_lobe_keeps_its_energy_and_meets_its_limits():
    z, w = np.polynomial.legendre.leggauss(400)
    for lam, blur in [(1e-3, 30.0), (5.0, 30.0), (30.0, 30.0), (400.0, 10.0)]:
        value = blurred_lobe(torch.tensor(z), torch.full((400,), lam, dtype=torch.float64), blur).numpy()
        assert 2 * np.pi * (w @ value) == pytest.approx(-2 * np.pi * np.expm1(-2 * lam) / lam, rel=1e-9)
    sharp = blurred_lobe(torch.tensor([1.0, 0.9, -1.0]).double(), torch.full((3,), 1e6, dtype=torch.float64), 30.0)
    expected = 2 * np.pi / 1e6 * 30 / (2 * np.pi) * np.exp(30 * (np.array([1.0, 0.9, -1.0]) - 1))
    assert sharp.numpy() == pytest.approx(expected, rel=1e-4)  # first order in 30 / 1e6


@pytest.mark.parametrize("lam", [1e-3, 0.05, 0.7, 4.0, 80.0, 290.0, 310.0, 1e5])
def test_a_lobe_is_found_from_its_flux_and_moment(lam):
    mean = lam / 3 if lam < 1e-2 else 1 / np.tanh(lam) - 1 / lam
    axis, found = gathered_lobe(2.0, 2.0 * mean * np.array([0.0, 0.6, -0.8]))
    assert found == pytest.approx(lam, rel=1e-4)  # the switches near 1e-2 and 300 leave lambda^2 / 15 and e^-600
    assert np.allclose(axis, [0, 0.6, -0.8])
    assert gathered_lobe(1.0, np.zeros(3))[1] > 0


def test_the_descent_goes_where_differences_point():
    """From a disturbed start, noise-free rows take lobes back to where they came from: the slopes are right."""
    d = fibonacci_sphere(700)
    true = Lobes(np.eye(3)[[0, 2]], np.log([6.0, 25.0]), np.array([[1.0, 2, 0], [3, 1, 1]]), np.log([6.0, 25.0]))
    rows = Rows(d, np.zeros((700, 3)), np.ones(700) / 40, 200, 30.0)
    target = kernel(rows, true.axis, np.exp(true.log_sharpness)) @ true.amplitude / rows.weight[:, None]
    rows = Rows(d, target, rows.weight, 200, 30.0)
    axis = np.array([[0.96, 0.28, 0], [0.1, -0.1, 0.99]])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    off = Lobes(axis, np.log([15.0, 12.0]), np.zeros((2, 3)), true.start)
    found = descended(rows, off, steps=30, gain=1e-12)
    assert np.abs(found.axis - true.axis).max() < 1e-5
    assert np.abs(found.log_sharpness - true.log_sharpness).max() < 1e-4
    assert np.abs(found.amplitude - true.amplitude).max() < 1e-3


# ---- fits


@pytest.mark.slow
def test_known_lobes_come_back():
    light = SGLight([[0, 0.2, 1], [1, 0.5, 0], [-1, 0, 0.3]], [3, 20, 200], [[1, 0.5, 0.2], [2, 3, 4], [30, 30, 20]])
    found = fit_panorama(envmap_from_sg(light, 128), PanoramaFitConfig(residual=1e-3, glossy_residual=2e-3))
    assert found.reached
    assert len(found.light) == 3
    order = np.argsort(found.light.sharpness)
    # The map's pixels blur the lobe of 200 by h^2 lambda / 12 = 1 %; the pull towards its patch's own spread, which
    # leaves out a tenth of its flux or holds some of its neighbours', is worth another 2 %.
    assert np.abs(found.light.axis[order] - light.axis).max() < 1e-3
    assert found.light.sharpness[order] == pytest.approx(light.sharpness, rel=0.04)
    assert np.abs(found.light.amplitude[order] / light.amplitude - 1).max() < 0.04


def test_a_constant_is_one_lobe():
    env = EnvironmentMap(np.full((32, 64, 3), [0.5, 1.0, 2.0]))
    found = fit_panorama(env)
    assert len(found.light) == 1
    d = fibonacci_sphere(50)
    # Sharpness 1e-3 is constant to 1e-3 either way.
    assert np.abs(found.light.radiance(d) / [0.5, 1.0, 2.0] - 1).max() < 1.1e-3
    assert found.irradiance_residual < 1e-3


@pytest.mark.parametrize("height", [8, 64])
def test_one_bright_pixel_is_one_lobe_there(height):
    pixels = np.zeros((height, 2 * height, 3))
    pixels[height // 3, height // 5] = [1e4, 9e3, 8e3]
    env = EnvironmentMap(pixels)
    found = fit_panorama(env)
    assert found.reached
    assert len(found.light) == 1
    centre = env.directions()[height // 3, height // 5]
    assert found.light.axis[0] @ centre > np.cos(0.1 * np.pi / height)  # a tenth of the pixel
    # A square of side h, foreshortened to h sin(theta) in longitude, has the spread 1 / lambda = h^2 (1 + sin^2) / 24.
    spread = (np.pi / height) ** 2 * (1 + np.sin(np.pi * (height // 3 + 0.5) / height) ** 2) / 24
    assert 1 / found.light.sharpness[0] == pytest.approx(spread, rel=0.25)
    assert flux_of_lobes(found.light) == pytest.approx(flux_of_map(env), rel=1e-6)


def test_black_has_no_lobes():
    found = fit_panorama(EnvironmentMap(np.zeros((8, 16, 3))))
    assert len(found.light) == 0
    assert found.reached
    assert found.irradiance_residual == 0.0
    assert irradiance_residual_on(EnvironmentMap(np.zeros((8, 16, 3))), found.light, np.eye(3)) == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_the_scale_of_radiance_does_not_matter(scale):
    pixels = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32) ** 4
    config = PanoramaFitConfig(residual=0.03, glossy_residual=np.inf)
    one, other = (fit_panorama(EnvironmentMap(pixels * np.float32(s)), config) for s in (1.0, scale))
    assert len(one.light) == len(other.light)
    # The float32 maps differ in their last digit, which the descent magnifies.
    assert np.abs(other.light.amplitude / scale - one.light.amplitude).max() < 1e-2 * one.light.amplitude.max()
    assert flux_of_lobes(other.light) == pytest.approx(
        flux_of_map(EnvironmentMap(pixels * np.float32(scale))), rel=1e-6
    )


@pytest.mark.slow
def test_more_is_spent_where_more_is_asked():
    pixels = np.random.default_rng(1).random((8, 16, 3)) ** 8
    env = EnvironmentMap(pixels)
    asked = [fit_panorama(env, PanoramaFitConfig(residual=r, glossy_residual=np.inf)) for r in (0.1, 0.03, 0.01)]
    counts = [len(f.light) for f in asked]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]
    for found, r in zip(asked, (0.1, 0.03, 0.01), strict=True):
        assert found.reached
        assert found.irradiance_residual <= r
        # The same residual at other normals, by quadrature and the public irradiance.
        other = irradiance_residual_on(env, found.light, np.roll(fibonacci_sphere(700), 2, 1))[0]
        assert other == pytest.approx(found.irradiance_residual, rel=0.15)
        assert flux_of_lobes(found.light) == pytest.approx(flux_of_map(env), rel=1e-6)
        assert (found.light.amplitude >= 0).all()


@pytest.mark.slow
def test_a_number_of_lobes_is_kept_and_a_residual_out_of_reach_is_said():
    env = EnvironmentMap(np.random.default_rng(2).random((8, 16, 3)) ** 8)
    four = fit_panorama(env, PanoramaFitConfig(lobes=4))
    assert len(four.light) == 4
    assert four.reached
    short = fit_panorama(env, PanoramaFitConfig(residual=1e-4, max_lobes=3))
    assert len(short.light) == 3
    assert not short.reached


@pytest.mark.slow
def test_same_map_same_bytes_and_negative_counts_as_black():
    pixels = np.random.default_rng(3).random((8, 16, 3)).astype(np.float32) ** 4
    config = PanoramaFitConfig(lobes=3)
    first, second = (fit_panorama(EnvironmentMap(pixels), config).light for _ in range(2))
    assert first.to_dict() == second.to_dict()
    holed = np.where(pixels < 0.1, 0, pixels)
    negative = np.where(pixels < 0.1, -pixels, pixels)
    lights = [fit_panorama(EnvironmentMap(p), config).light.to_dict() for p in (holed, negative)]
    assert lights[0] == lights[1]


def test_bad_wishes_are_refused():
    for bad in ({"residual": 0.0}, {"glossy_residual": np.nan}, {"lobes": 0}, {"max_lobes": 0}, {"blur_degrees": 1.0}):
        with pytest.raises(InputError, match="residual"):
            PanoramaFitConfig(**bad)


@pytest.mark.slow
def test_a_large_map_costs_what_its_cells_cost():
    """4096 x 2048 pixels that repeat a small map are the same light: exact cells make it the same fit."""
    pixels = np.random.default_rng(4).random((16, 32, 3)).astype(np.float32) ** 4
    config = PanoramaFitConfig(lobes=3)
    small = fit_panorama(EnvironmentMap(pixels), config).light
    large = fit_panorama(EnvironmentMap(pixels.repeat(128, 0).repeat(128, 1)), config).light
    # Sums of 8 million pixels in another order, and cells half as high where the small map's pixels are split.
    assert large.axis == pytest.approx(small.axis, abs=2e-3)
    assert large.sharpness == pytest.approx(small.sharpness, rel=1e-2)


@pytest.mark.slow
def test_a_real_garden_on_a_real_face(real_data):
    """`ict_a_hdri`: irradiance on the true normals within 2 % RMS, by few lobes."""
    scenes = real_data / "scenes"
    env = read_envmap(scenes / "ict_a_hdri" / "gt" / "envmap.exr")
    pixels = read_exr(scenes / "ict_a_soft" / "gt" / "normal.exr").astype(np.float64)  # same camera, same head
    length = np.linalg.norm(pixels, axis=-1)
    seen = np.abs(length - 1) < 0.01
    normals = (pixels[seen] / length[seen][:, None])[::40]
    theirs = read_exr(scenes / "ict_a_hdri" / "gt" / "diffuse_shading.exr")[seen][::40]
    ours = cells_irradiance(panorama_cells(env), normals) / np.pi
    # Half floats (5e-4) and their quadrature's own pixels.
    assert np.sqrt(((ours - theirs) ** 2).mean()) < 2e-3 * theirs.mean()
    found = fit_panorama(env)
    assert len(found.light) <= 12
    assert irradiance_residual_on(env, found.light, normals)[0] < 0.02
    assert found.irradiance_residual < 0.02
