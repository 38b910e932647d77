"""Lobes are made one where the seen surface cannot tell, and only there."""

import math

import mpmath
import numpy as np
import pytest
import torch
from ball_prior import ball_prior

from sira_assets.fit.fewer_lobes import fewer_lobes, mean_cosine, one_lobe, sharpness_of
from sira_assets.fit.light import FreeLight
from sira_assets.numerics.sg import irradiance, sg_integral


def unit(*rows):
    return torch.nn.functional.normalize(torch.tensor(rows, dtype=torch.float64), dim=-1)


def ball(count=800, seed=0):
    """Points of the half of a ball that a camera on +z sees: normals, view, a skin's albedo, F0."""
    n = torch.randn(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    n[:, 2] = n[:, 2].abs()
    n = torch.nn.functional.normalize(n, dim=-1)
    view = unit(*[(0.0, 0.0, 1.0)] * count)
    return n, view, torch.full_like(n, 0.5), torch.full((count,), 0.03, dtype=torch.float64)


@pytest.mark.parametrize("sharpness", [1e-6, 1e-3, 0.3, 1.0, 7.0, 500.0, 3000.0])
def test_mean_cosine_is_the_integral_and_has_its_inverse(sharpness):
    f = lambda t: mpmath.exp(sharpness * (t - 1))  # noqa: E731
    with mpmath.workdps(30):
        exact = mpmath.quad(lambda t: t * f(t), [-1, 0, 0.9, 1]) / mpmath.quad(f, [-1, 0, 0.9, 1])
    # coth x - 1/x loses eps / x^2 of it near the switch to the series at 1e-3: 3e-10.
    assert mean_cosine(sharpness) == pytest.approx(float(exact), rel=1e-6)
    assert sharpness_of(mean_cosine(sharpness)) == pytest.approx(sharpness, rel=1e-5)


def test_one_lobe_keeps_flux_and_mean_direction():
    lobes = (
        unit((1, 0, 1), (0, 1, 2), (-1, 0.2, 1)),
        torch.tensor([3.0, 20.0, 0.5], dtype=torch.float64),
        torch.tensor([[1.0, 0.5, 0.2], [2.0, 2.0, 2.0], [0.1, 0.2, 0.9]], dtype=torch.float64),
    )
    axis, sharpness, amplitude = one_lobe(lobes)
    flux = sg_integral(*lobes[1:])
    torch.testing.assert_close(sg_integral(sharpness, amplitude), flux.sum(0, keepdim=True), rtol=1e-12, atol=0)
    w = flux.mean(-1)
    vector = sum(w[k] * mean_cosine(float(lobes[1][k])) * lobes[0][k] for k in range(3)) / w.sum()
    torch.testing.assert_close(mean_cosine(float(sharpness)) * axis[0], vector, rtol=1e-6, atol=1e-9)
    # A lobe together with itself is itself.
    twice = tuple(torch.cat([t[:1], t[:1]]) for t in lobes)
    again = one_lobe(twice)
    torch.testing.assert_close(again[1], lobes[1][:1], rtol=1e-9, atol=0)
    torch.testing.assert_close(again[2], 2.0 * lobes[2][:1], rtol=1e-9, atol=0)


def test_opposite_lobes_become_even_light():
    lobes = unit((0, 0, 1), (0, 0, -1)), torch.full((2,), 5.0, dtype=torch.float64), torch.ones(2, 3).double()
    _, sharpness, amplitude = one_lobe(lobes)
    assert float(sharpness) == 0.0
    assert float(amplitude[0, 0]) * 4 * math.pi == pytest.approx(float(sg_integral(*lobes[1:])[:, 0].sum()), rel=1e-12)


def test_lobes_that_are_one_become_one_and_lamps_stay_apart():
    points = ball()
    split = (
        unit((1, 1, 2), (1.01, 1, 2), (1, 1.02, 2)),
        torch.tensor([12.0, 11.0, 13.0], dtype=torch.float64),
        0.4 * torch.ones(3, 3, dtype=torch.float64),
    )
    lobes, kept, change = fewer_lobes(*points, split, roughness=0.5, most_change=0.002)
    assert kept.tolist() == [True, False, False]
    assert 0.0 < change <= 0.002
    apart = (unit((2, 0, 1), (-2, 0, 1), (0, 2, 1)), torch.full((3,), 60.0, dtype=torch.float64), split[2])
    same, kept, change = fewer_lobes(*points, apart, roughness=0.5, most_change=0.002)
    assert kept.all()
    assert change == 0.0
    for a, b in zip(same, apart, strict=True):
        assert torch.equal(a, b)
    # What is promised is kept: the change of all of the radiance, not of the last pair's.
    many = (
        unit(*np.random.default_rng(1).normal(size=(10, 3)).tolist()),
        torch.full((10,), 4.0, dtype=torch.float64),
        0.1 * torch.ones(10, 3, dtype=torch.float64),
    )
    lobes, kept, _ = fewer_lobes(*points, many, roughness=0.5, most_change=0.004)
    assert 1 <= kept.sum() < 10
    before, after = (irradiance(points[0], *light) / 2 / math.pi for light in (many, tuple(t[kept] for t in lobes)))
    assert float((after - before).abs().mean() / before.mean()) < 0.03


def test_a_merged_light_has_the_lobes_that_count():
    light = FreeLight(ball_prior())
    start = [t.detach().clone() for t in light.lobes()]
    kept = torch.tensor([True, False, True, False])
    light.put(tuple(start), kept)
    for now, then in zip(light.lobes(), start, strict=True):
        torch.testing.assert_close(now, then[kept])
    one = tuple(t.detach().clone() for t in light.lobes())
    light.put(one, torch.tensor([False, True]))
    assert light.kept.tolist() == [False, False, True, False]
    torch.testing.assert_close(light.lobes()[1], start[1][2:3])
    light.lobes()[2].sum().backward()
    assert (light.log_amplitude.grad[[0, 1, 3]] == 0).all()
