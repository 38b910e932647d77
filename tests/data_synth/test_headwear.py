"""Headwear over hair, and over none."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.head.cover_params import HEADWEAR
from data_synth.head.headwear import headwear_field_mm, headwear_zone, under_headwear
from data_synth.head.params import sample_params


@pytest.mark.parametrize("kind", [kind for kind in HEADWEAR if kind != "none"])
def test_hair_lies_under_headwear_and_a_bald_head_wears_it_too(kind):
    drawn = sample_params(np.random.default_rng(5))
    params = replace(drawn, dress=replace(drawn.dress, headwear=kind))
    x = np.random.default_rng(6).uniform([-90, -120, -120], [90, 140, 120], (4000, 3))
    distance = np.linalg.norm(x, axis=1) - 95.0
    worn = headwear_field_mm(x, params, distance)
    assert np.isfinite(worn).all()
    pressed = under_headwear(distance - 20.0, worn, x, params)
    inside = headwear_zone(x, kind) == 1.0
    assert inside.any()
    assert (pressed[inside] >= worn[inside] + 2.0 - 1e-9).all()
    assert np.isposinf(under_headwear(np.full(len(x), np.inf), worn, x, params)).all()
