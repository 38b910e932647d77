"""PSNR and SSIM: known answers, masks, gains, the cases that break naive code."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sira_assets.errors import InputError
from sira_assets.measure.image_metrics import best_gain, correlation, pooled_psnr, score_image

FULL = np.ones((16, 16), bool)


def picture(seed=0, shape=(16, 16, 3)):
    return np.random.default_rng(seed).random(shape)


@pytest.mark.parametrize("error", [1.0, 0.1, 1e-3, 1e-6])
def test_constant_error_has_the_textbook_psnr(error):
    score = score_image(np.full((16, 16, 3), error), np.zeros((16, 16, 3)), FULL, encoding="linear")
    assert score.mse == pytest.approx(error**2, rel=1e-12)
    assert score.psnr_db == pytest.approx(-20 * math.log10(error), abs=1e-9)


def test_equal_pictures_are_infinite_and_pool_to_a_finite_figure():
    same = score_image(picture(), picture(), FULL)
    assert same.psnr_db == math.inf
    assert same.ssim == pytest.approx(1.0, abs=1e-12)
    off = score_image(picture() * 0, picture() * 0 + 0.1, FULL, encoding="linear")
    pooled = pooled_psnr([score_image(picture(), picture(), FULL, encoding="linear"), off])
    assert pooled == pytest.approx(20 + 10 * math.log10(2), abs=1e-9)  # half the values carry all the error
    with pytest.raises(ValueError, match="one encoding"):
        pooled_psnr([same, off])


@given(st.floats(0.05, 20.0))
def test_a_global_gain_is_undone(gain):
    truth = picture(1) * 0.5 + 0.1
    score = score_image(truth * gain, truth, FULL, encoding="linear", scale_invariant=True)
    assert score.gain == pytest.approx(1 / gain, rel=1e-12)
    assert score.mse < 1e-28  # rounding of a product and a quotient, squared


def test_the_gain_is_the_least_squares_one():
    p, t = picture(2), picture(3)
    g = best_gain(p, t, FULL)
    here = ((g * p - t) ** 2).sum()
    assert all(((h * p - t) ** 2).sum() > here for h in (g * 0.999, g * 1.001))
    assert best_gain(p * 0, t, FULL) == 1.0


def test_only_masked_pixels_count():
    truth, spoiled = picture(4), picture(4)
    mask = np.zeros((16, 16), bool)
    mask[2:14, 2:14] = True
    spoiled[~mask] = 1e6
    assert score_image(spoiled, truth, mask).mse == 0.0
    assert score_image(spoiled, truth, mask).ssim == pytest.approx(1.0, abs=1e-12)
    spoiled[~mask] = np.nan
    assert score_image(spoiled, truth, mask).mse == 0.0


def test_srgb_clips_and_encodes():
    # Linear 0.5 and 0.25 are 0.735357 and 0.537099 in sRGB (IEC 61966-2-1); above 1 both are white.
    score = score_image(np.full((16, 16, 3), 0.5), np.full((16, 16, 3), 0.25), FULL, encoding="srgb")
    assert score.mse == pytest.approx((0.735357 - 0.537099) ** 2, rel=1e-4)
    assert score_image(np.full((16, 16, 3), 3.0), np.full((16, 16, 3), 2.0), FULL, encoding="srgb").mse == 0.0
    assert score_image(np.full((16, 16, 3), 3.0), np.full((16, 16, 3), 2.0), FULL, encoding="linear").mse == 1.0


def test_ssim_of_flat_pictures_is_the_luminance_term():
    # No variance: SSIM = (2 a b + C1) / (a^2 + b^2 + C1), C1 = 0.01^2 at data range 1 (Wang et al. 2004).
    a, b = 0.3, 0.6
    score = score_image(np.full((16, 16), a), np.full((16, 16), b), FULL, encoding="linear")
    assert score.ssim == pytest.approx((2 * a * b + 1e-4) / (a * a + b * b + 1e-4), rel=1e-9)


def test_small_pictures_have_no_ssim_but_a_psnr():
    score = score_image(picture(shape=(6, 9, 3)), picture(1, (6, 9, 3)), np.ones((6, 9), bool))
    assert score.ssim is None
    assert math.isfinite(score.psnr_db)


def test_float32_pictures_far_from_zero_keep_their_ssim():
    # At an offset of 100 float32 variances are noise; float64 arithmetic keeps the value.
    p, t = (picture(s) * 0.5 for s in (5, 6))
    exact = score_image(p + 128.0, t + 128.0, FULL, encoding="linear").ssim
    single = score_image(np.float32(p + 128.0), np.float32(t + 128.0), FULL, encoding="linear").ssim
    assert single == pytest.approx(
        exact, abs=1e-4
    )  # the rounding of the pixels themselves, 8e-6, over variances of 0.02


def test_correlation():
    x = picture(7, (16, 16))
    assert correlation(3 * x + 1, x, FULL) == pytest.approx(1.0, abs=1e-12)
    assert correlation(-x, x, FULL) == pytest.approx(-1.0, abs=1e-12)
    assert correlation(np.ones_like(x), x, FULL) == 0.0


def test_unusable_pictures_are_said():
    with pytest.raises(InputError, match="one size"):
        score_image(picture(), picture(shape=(16, 15, 3)), FULL)
    with pytest.raises(InputError, match="empty mask"):
        score_image(picture(), picture(), ~FULL)
    bad = picture()
    bad[3, 4] = np.inf
    with pytest.raises(InputError, match="1 pixel"):
        score_image(bad, picture(), FULL)
