"""What the measure of a latent space says of heads that are known."""

import numpy as np
import pytest
import torch

from sira_assets.fields.af_sm import AppearanceConfig, AppearanceFactorModel
from sira_assets.fields.prior import CodeStatistics, Prior, freeze, load_prior
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig
from sira_assets.train.latent_space import LatentConfig, decode_head, draw_coefficients, interpolated


def ball_prior() -> Prior:
    """The unit ball of the untrained reference, ten centimetres, whatever the code."""
    torch.manual_seed(0)
    shape = ShapeAppearanceModel(ShapeConfig(code_size=4, feature_size=2, deformation_width=16, reference_width=16))
    for net in (shape.deformation, shape.reference):
        torch.nn.init.zeros_(net.out.weight)
    statistics = [CodeStatistics.of(0.1 * torch.randn(12, size)) for size in (4, 64, 32, 8, 32)]
    return Prior(freeze(shape), freeze(AppearanceFactorModel(AppearanceConfig(), feature_size=2)), *statistics)


def test_a_ball_is_one_closed_piece_of_known_volume_and_slope():
    head = decode_head(ball_prior(), np.zeros(4), LatentConfig(cell_m=0.01))
    assert (head.pieces, head.floaters, head.closed) == (1, 0.0, True)
    # A polyhedron inscribed with edges h in a ball of radius r lacks about (h/r)^2 / 5 of the volume.
    assert head.volume_l == pytest.approx(4 / 3 * np.pi, rel=0.005)
    assert head.slope_mean == pytest.approx(1.0, abs=1e-3)  # the guard under the root, 1e-6 of a unit
    assert head.slope_greatest <= 1.0 + 1e-5


def test_draws_stay_within_their_bound_and_repeat():
    drawn = draw_coefficients(ball_prior(), LatentConfig(draws=50))
    assert np.abs(drawn).max() <= 2.0
    np.testing.assert_array_equal(drawn, draw_coefficients(ball_prior(), LatentConfig(draws=50)))


def test_interpolation_walks_from_each_draw_to_the_next():
    ends = np.array([[0.0, 0.0], [4.0, 8.0], [4.0, 0.0]])
    np.testing.assert_allclose(interpolated(ends, 3)[:3], [[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]])
    np.testing.assert_allclose(interpolated(ends, 1), [[2.0, 4.0], [4.0, 4.0]])


@pytest.mark.slow
def test_shipped_codes_decode_to_one_closed_head():
    prior, config = load_prior(), LatentConfig(draws=4, cell_m=0.006)
    for row in draw_coefficients(prior, config):
        head = decode_head(prior, row, config)
        assert head.closed
        assert head.floaters < 0.01
        # Training leaves a mean square deviation of 0.01 from 1, more between ear and skull.
        assert head.slope_mean == pytest.approx(1.0, abs=0.15)
