"""Bilinear reading: exact on linear maps, the same as other programs', held at the border."""

import numpy as np
import pytest

from sira_assets.relight.glb_model import Texture
from sira_assets.texture.reading import bilinear, footprint


def test_a_linear_map_is_read_exactly():
    rows, columns = np.mgrid[:8, :8]
    ramp = np.stack([(columns + 0.5) / 8, 1 - (rows + 0.5) / 8], -1)
    uv = np.random.default_rng(0).uniform(0.1, 0.9, (50, 2))
    assert bilinear(ramp, uv) == pytest.approx(uv, abs=1e-12)


def test_it_reads_as_the_gltf_renderer_does():
    rng = np.random.default_rng(1)
    texels = rng.random((16, 16, 4)).astype(np.float32)
    uv = rng.random((200, 2))
    # glTF's v runs down the picture.
    theirs = Texture(texels, clamp=(True, True)).at(uv * [1, -1] + [0, 1])
    assert bilinear(texels, uv) == pytest.approx(theirs, abs=1e-6)


def test_weights_are_a_mean_and_the_border_goes_on():
    uv = np.random.default_rng(2).uniform(-0.2, 1.2, (300, 2))
    texels, weights = footprint(uv, 5)
    assert weights.sum(1) == pytest.approx(np.ones(300))
    assert weights.min() >= 0
    assert (texels.min(), texels.max()) == (0, 24)
    picture = np.arange(25.0).reshape(5, 5, 1)
    corners = np.array([[-0.1, 1.1], [1.1, 1.1], [-0.1, -0.1], [1.1, -0.1]])
    assert bilinear(picture, corners)[:, 0].tolist() == [0, 4, 20, 24]
