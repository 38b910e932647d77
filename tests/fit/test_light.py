"""The light as parameters of a fit: what its tint says and does not say."""

import math

import pytest
import torch
from ball_prior import ball_prior

from sira_assets.fit.light import TINT_BLUE, TINT_RED, FreeLight


def coloured(red=1.0, blue=1.0, gain=1.0):
    """A light of that colour in every lobe."""
    light = FreeLight(ball_prior())
    with torch.no_grad():
        grey = light.log_amplitude.mean(-1, keepdim=True)
        light.log_amplitude.copy_(grey + torch.tensor([red, 1.0, blue]).log() + math.log(gain))
    return light


@pytest.mark.parametrize("gain", [1e-3, 1.0, 1e3])
def test_grey_light_of_any_brightness_has_no_tint(gain):
    assert float(coloured(gain=gain).tint().detach()) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("red", "blue"), [(1.3, 1.0), (1 / 1.3, 1.0), (1.0, 0.8), (1.2, 0.7), (40.0, 0.01)])
def test_the_tint_is_that_of_the_irradiance(red, blue):
    expected = math.log1p((math.log(red) / TINT_RED) ** 2) + math.log1p((math.log(blue) / TINT_BLUE) ** 2)
    for gain in (0.1, 10.0):
        # float32 through logarithms of irradiances.
        assert float(coloured(red, blue, gain).tint().detach()) == pytest.approx(expected, rel=1e-4)


def test_lobes_behind_the_head_have_no_say():
    light = coloured()
    with torch.no_grad():
        light.log_sharpness.fill_(math.log(50.0))
        light.axis[0] = torch.tensor([0.0, 0.0, -1.0])
        before = light.tint()
        light.log_amplitude[0] += torch.tensor([3.0, 0.0, -3.0])
    assert float(light.tint().detach()) == pytest.approx(float(before), abs=1e-4)


def test_descending_makes_it_grey_and_keeps_the_brightness():
    light = coloured(1.5, 0.7)
    start = light.log_amplitude.detach().mean().clone()
    optimiser = torch.optim.Adam(light.parameters(), 0.02)
    for _ in range(200):
        optimiser.zero_grad()
        light.tint().backward()
        optimiser.step()
    assert float(light.tint().detach()) < 0.01
    assert float((light.log_amplitude.detach().mean() - start).abs()) < 0.5


def test_the_darkest_light_is_finite():
    light = coloured()
    with torch.no_grad():
        light.log_amplitude.fill_(-100.0)
    tint = light.tint()
    tint.backward()
    assert torch.isfinite(tint)
    assert all(torch.isfinite(p.grad).all() for p in light.parameters() if p.grad is not None)
