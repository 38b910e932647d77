import io

import numpy as np
import pytest
from PIL import Image

from sira_assets.asset.encoding import (
    decode_ks,
    decode_normal,
    decode_srgb,
    encode_ks,
    encode_normal,
    encode_srgb,
    quantised,
)
from sira_assets.asset.png import encode_png

CODES = np.arange(256, dtype=np.uint8)


def test_every_code_survives_decoding_and_encoding():
    assert (encode_srgb(decode_srgb(CODES)) == CODES).all()
    assert (encode_ks(decode_ks(CODES)) == CODES).all()


def test_codes_are_rounded_not_truncated():
    x = np.linspace(0, 1, 100_001)
    error = quantised(x) / 255 - x
    # Half a step is the most that rounding errs; its mean vanishes, where truncation would leave half a step (2e-3).
    assert np.abs(error).max() <= 0.5 / 255 + 1e-12
    assert abs(error.mean()) < 1e-5


def test_values_out_of_range_are_clipped():
    assert encode_srgb(np.array([-1.0, 2.0])).tolist() == [0, 255]
    assert encode_ks(np.array([-0.1, 0.04, 0.5])).tolist() == [0, 128, 255]


def test_specular_png_reads_as_f0_of_eight_hundredths_of_its_value():
    assert decode_ks(np.array([255])) == pytest.approx(0.08)
    s = np.linspace(0, 0.08, 999)
    # Half an 8-bit step of a range of 0.08.
    assert np.abs(decode_ks(encode_ks(s)) - s).max() <= 0.04 / 255 + 1e-12


def test_normals_survive_within_the_step_of_eight_bits():
    rng = np.random.default_rng(0)
    n = rng.normal(size=(20_000, 3))
    n[:, 2] = np.abs(n[:, 2])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((decode_normal(encode_normal(n)) * n).sum(1), -1, 1)))
    # Half a step (1/255) in each of three axes: atan(sqrt(3)/255) = 0.39 degrees.
    assert angle.max() <= 0.40


def test_normals_below_the_surface_are_laid_flat_and_those_of_no_length_point_outward():
    decoded = decode_normal(encode_normal(np.array([[0.6, 0.0, -0.8], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0, 0, 5.0]])))
    # One code is 1/127.5; 128 stands for zero with half of that as its error.
    assert decoded == pytest.approx(np.array([[1, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 1.0]]), abs=0.5 / 127.5 + 1e-9)
    assert (encode_normal(np.array([0.6, 0.0, -0.8]))[2]) == 128


def test_green_grows_with_v():
    assert encode_normal(np.array([0.0, 0.6, 0.8]))[1] > 128


def test_png_keeps_texels_and_says_how_to_read_them():
    texels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    data = encode_png(texels, {"Description": "linear"})
    with Image.open(io.BytesIO(data)) as image:
        assert (np.array(image) == texels).all()
        assert image.text == {"Description": "linear"}
    assert data == encode_png(texels, {"Description": "linear"})
    # A view with strides must not be read as if it were packed.
    with Image.open(io.BytesIO(encode_png(texels[::-1, ::-1]))) as image:
        assert (np.array(image) == texels[::-1, ::-1]).all()


@pytest.mark.parametrize("bad", [np.zeros((4, 4)), np.zeros((4, 4, 2), np.uint8), np.zeros(4, np.uint8)])
def test_png_refuses_what_it_cannot_hold(bad):
    with pytest.raises((TypeError, ValueError)):
        encode_png(bad)
