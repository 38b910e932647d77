"""Which heads `--plain` passes over."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.draw_scene import plain_indices
from data_synth.head.cover_params import is_plain
from data_synth.head.params import sample_params
from data_synth.scene_settings import SceneSettings


def test_hats_scarves_beards_and_hair_of_its_own_shape_are_not_plain():
    drawn = sample_params(np.random.default_rng(2))
    plain = replace(
        drawn,
        hair_style="short",
        groom=replace(drawn.groom, beard="none"),
        dress=replace(drawn.dress, headwear="none", garment="shirt"),
    )
    assert is_plain(plain)
    for hair_style in ("wavy", "bun", "ponytail", "fringe"):
        assert not is_plain(replace(plain, hair_style=hair_style))
    for beard in ("moustache", "full", "long"):
        assert not is_plain(replace(plain, groom=replace(plain.groom, beard=beard)))
    for dress in ({"headwear": "cap"}, {"garment": "scarf"}):
        assert not is_plain(replace(plain, dress=replace(plain.dress, **dress)))


def test_the_first_plain_scenes_are_the_same_scenes_by_the_same_numbers():
    settings = SceneSettings()
    few, more = plain_indices(settings, 0, 5), plain_indices(settings, 0, 20)
    assert more[:5] == few
    assert more == sorted(set(more))
    assert plain_indices(settings, more[3], 2) == more[3:5]
    # about a third of the heads are plain
    assert more[-1] == pytest.approx(65, abs=30)
