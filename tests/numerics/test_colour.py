"""The sRGB curve: known values, round trip, the join, the ends."""

import numpy as np
import pytest

from sira_assets.numerics.colour import linear_from_srgb, luminance, srgb_from_linear


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_round_trip_over_the_whole_range(dtype):
    v = np.linspace(0.0, 1.0, 10001, dtype=dtype)
    back = srgb_from_linear(linear_from_srgb(v))
    assert back.dtype == dtype
    # The two pieces meet to 3e-8; beyond that only rounding, which the slope 12.92 near black magnifies.
    assert np.abs(back - v).max() < (1e-6 if dtype == np.float32 else 1e-7)


def test_known_values():
    # 8-bit 188 is the code nearest to half the light; the ends are exact.
    assert srgb_from_linear(np.array([0.0, 1.0])).tolist() == pytest.approx([0.0, 1.0], abs=1e-15)
    assert srgb_from_linear(0.5) * 255 == pytest.approx(187.516, abs=1e-3)
    assert linear_from_srgb(0.5) == pytest.approx(0.2140411, abs=1e-7)
    assert srgb_from_linear(0.002) == pytest.approx(0.02584, abs=1e-12)


def test_8_bit_codes_survive():
    codes = np.arange(256)
    assert np.array_equal(np.round(srgb_from_linear(linear_from_srgb(codes / 255.0)) * 255).astype(int), codes)


def test_encoding_is_monotonic_and_continuous_at_the_toe():
    x = np.linspace(0.003, 0.0033, 30001)
    step = np.diff(srgb_from_linear(x))
    # Slope is at most 12.92 and the known jump 3e-8.
    assert step.min() > -4e-8
    assert step.max() < 12.92 * 1e-8 + 4e-8


def test_out_of_range_clips_and_nan_stays():
    out = srgb_from_linear(np.array([-1.0, 2.0, np.inf, -np.inf, np.nan]))
    assert out[:4].tolist() == pytest.approx([0.0, 1.0, 1.0, 0.0])
    assert np.isnan(out[4])


def test_integers_become_float64_not_truncated():
    assert srgb_from_linear(np.array([0, 1])).dtype == np.float64


def test_luminance_of_white_and_primaries():
    assert luminance(np.ones(3)) == pytest.approx(1.0, abs=1e-12)
    assert luminance(np.eye(3)).tolist() == [0.2126, 0.7152, 0.0722]
