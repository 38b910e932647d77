"""Covered heads as surfaces: closed, in one piece, with nothing floating, whatever is worn."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import label

from data_synth.head.cover import composed_field
from data_synth.head.cover_params import BEARDS, GARMENTS, HAIR_STYLES, HEADWEAR
from data_synth.head.grid import extract
from data_synth.head.material import Region, region_of
from data_synth.head.params import HeadParams, sample_params

pytestmark = pytest.mark.slow


def _worn(k: int) -> HeadParams:
    """Style ``k``, with beards, headwear and garments taken in turn, at the lengths' extremes."""
    base = sample_params(np.random.default_rng([77, k]))
    headwear = HEADWEAR[k % len(HEADWEAR)]
    return replace(
        base,
        hair_style=HAIR_STYLES[k],
        hair_length=0.72 if k % 2 else 1.35,
        groom=replace(base.groom, beard=BEARDS[k % len(BEARDS)], beard_mm=16.0, wave=1.0),
        dress=replace(base.dress, garment=GARMENTS[k % len(GARMENTS)], headwear=headwear, neckline=(k % 3) / 2),
    )


@pytest.mark.parametrize("k", range(len(HAIR_STYLES)), ids=HAIR_STYLES)
def test_every_style_gives_one_closed_surface(k):
    params = _worn(k)
    grid, field = composed_field(params)
    inside, _ = label(field < 0)
    sizes = np.bincount(inside.ravel())[1:]
    # crumbs that `extract` drops: fewer than one node in five thousand
    assert sizes.max() > (1 - 2e-4) * sizes.sum()
    vertices, faces = extract(grid, field)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all()
    assert _components(len(vertices), faces) == 1
    region = region_of(vertices[::5], params)
    present = {Region(r).name for r in np.unique(region)}
    assert {"SKIN", "LIPS", "EYE"} <= present
    assert ("HAIR" in present) == (params.hair_style != "bald")
    assert ("BEARD" in present) == (params.groom.beard != "none")
    assert ("CLOTH" in present) == (params.dress.garment != "none")
    assert ("HEADWEAR" in present) == (params.dress.headwear != "none")


def _components(count: int, faces: np.ndarray) -> int:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    rows, columns = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    return connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)), False)[0]
