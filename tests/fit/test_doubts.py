"""Every doubt is raised by the fault that it names and by no sound portrait."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from small_portrait import portrait

from sira_assets.fields.prior import CodeStatistics
from sira_assets.fit import doubts
from sira_assets.fit.doubts import geometry_doubts, portrait_doubts, sigma_distance
from sira_assets.fit.pixels import silhouette_band


@pytest.fixture(autouse=True)
def _small_is_no_fault(monkeypatch):
    monkeypatch.setattr(doubts, "FEWEST_PIXELS", 100)


def sound():
    p = portrait()
    return replace(p, image_linear=np.clip(p.image_linear, 0.1, 0.9))


def test_a_sound_portrait_raises_none():
    assert portrait_doubts(sound()) == ()


def faults():
    p = sound()
    rows, columns = np.mgrid[:96, :96]
    upper = p.mask & (rows < 50)
    hole = (rows - 45) ** 2 + (columns - 48) ** 2 < 9
    yield "clipped", replace(p, saturated=upper)
    yield "black", replace(p, image_linear=np.where(upper[..., None], 0.0, p.image_linear))
    yield "holes", replace(p, mask=p.mask & ~hole)
    yield "cut by the top", replace(p, mask=p.mask | ((rows < 30) & (abs(columns - 48) < 10)))


@pytest.mark.parametrize(("word", "portrait"), list(faults()))
def test_a_fault_is_named(word, portrait):
    said = portrait_doubts(portrait)
    assert len(said) == 1
    assert word in said[0]
    assert "\n" not in said[0]


def test_few_pixels_are_named(monkeypatch):
    monkeypatch.setattr(doubts, "FEWEST_PIXELS", 10_000)
    assert "larger photo" in portrait_doubts(sound())[0]


def test_sigma_distance_is_the_root_mean_square_of_the_coefficients():
    torch.manual_seed(0)
    statistics = CodeStatistics.of(torch.randn(40, 6), variance=1.0)
    coefficients = torch.tensor([3.0, -4.0, 0.0, 0.0, 0.0, 0.0])
    assert sigma_distance(statistics, statistics.code(coefficients)) == pytest.approx((25 / 6) ** 0.5, rel=1e-4)


def test_pixels_of_a_hole_are_no_silhouette():
    p = sound()
    rows, columns = np.mgrid[:96, :96]
    hole = (rows - 30) ** 2 + (columns - 48) ** 2 < 30
    band = set(zip(*silhouette_band(replace(p, mask=p.mask & ~hole)), strict=True))
    assert not any(hole[pixel] for pixel in band)
    assert band == {pixel for pixel in zip(*silhouette_band(p), strict=True) if not hole[pixel]}


def test_holes_in_the_mask_are_no_want_of_overlap():
    p = sound()
    statistics = CodeStatistics.of(torch.randn(40, 6))
    geometry = SimpleNamespace(warnings=(), z_sdf=statistics.mean, pose_change_deg=0.0, history=())
    rows, columns = np.mgrid[:96, :96]
    hole = (rows - 40) ** 2 + (columns - 48) ** 2 < 120
    assert (p.mask & hole).sum() > 0.15 * p.mask.sum()
    said = geometry_doubts(replace(p, mask=p.mask & ~hole), geometry, SimpleNamespace(z_sdf=statistics), p.mask)
    assert said == ()
    half = p.mask & (columns < 48)
    assert "overlap" in geometry_doubts(p, geometry, SimpleNamespace(z_sdf=statistics), half)[0]


def test_an_outline_that_no_code_reaches_is_named():
    p = sound()
    statistics = CodeStatistics.of(torch.randn(40, 6))
    settling, codes, networks = {"colour": 1.0}, {"silhouette": 0.9}, {"silhouette": 0.001, "anchor": 0.1}
    settled = {"silhouette": 2.0 * doubts.MOST_OUTLINE}
    history = ((10, settling), (20, codes), *((k, settled) for k in (30, 40, 50)), (60, networks))
    assert doubts.outline_left(history) == pytest.approx(2.0 * doubts.MOST_OUTLINE)
    assert doubts.outline_left(history[:1]) == 0.0
    geometry = SimpleNamespace(warnings=(), z_sdf=statistics.mean, pose_change_deg=0.0, history=history)
    (said,) = geometry_doubts(p, geometry, SimpleNamespace(z_sdf=statistics), p.mask)
    assert "2.0 times" in said
    assert "focal length" in said
