"""Skin colour: the spectral model at its limits, its table, and the range of measured human skin."""

import numpy as np
import pytest

from data_synth.head.skin import (
    BLOOD_RANGE,
    MELANIN_RANGE,
    RGB_FROM_XYZ,
    WAVELENGTH_NM,
    skin_albedo,
    skin_reflectance,
    spectral_albedo,
)

FACE_BLOOD = np.array([0.009, 0.018, 0.036])  # what `cover_sampling` draws from


def cielab(rgb: np.ndarray) -> np.ndarray:
    """CIELAB under D65 of linear Rec. 709 albedos (..., 3)."""
    from_rgb = np.linalg.inv(RGB_FROM_XYZ)
    ratio = (rgb @ from_rgb.T) / (from_rgb @ np.ones(3))
    f = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def test_the_spectrum_is_a_reflectance_and_has_bloods_dip():
    melanin, blood = np.meshgrid(np.geomspace(*MELANIN_RANGE, 12), np.geomspace(*BLOOD_RANGE, 12))
    spectrum = skin_reflectance(melanin, blood)
    assert spectrum.min() > 0
    assert spectrum.max() < 1
    fair = skin_reflectance(0.012, 0.02)
    at = {nm: fair[np.flatnonzero(nm == WAVELENGTH_NM)[0]] for nm in (500, 540, 560, 580, 650)}
    # oxyhaemoglobin's two bands around 560 nm: the W of light skin
    assert at[540] < at[500]
    assert at[540] < at[560]
    assert at[580] < at[560]
    assert at[650] > 1.4 * at[580]


def test_more_pigment_reflects_less_at_every_wavelength():
    melanin = skin_reflectance(np.geomspace(*MELANIN_RANGE, 30), np.full(30, 0.02))
    assert (np.diff(melanin, axis=0) < 0).all()
    blood = skin_reflectance(np.full(30, 0.03), np.geomspace(*BLOOD_RANGE, 30))
    assert (np.diff(blood, axis=0) < 0).all()
    turbid = [spectral_albedo(0.03, 0.02, s) for s in (0.7, 1.0, 1.6)]
    assert (np.diff(turbid, axis=0) > 0).all()


def test_the_table_is_the_spectral_model():
    rng = np.random.default_rng(0)
    melanin = np.exp(rng.uniform(*np.log(MELANIN_RANGE), 400))
    blood = np.exp(rng.uniform(*np.log(BLOOD_RANGE), 400))
    for scattering in (0.75, 1.0, 1.55):
        ratio = skin_albedo(melanin, blood, scattering) / spectral_albedo(melanin, blood, scattering)
        # bilinear on 96 nodes over 5 natural logarithms: h^2 / 8 = 3.5e-4 times a curvature below 2
        assert np.abs(ratio - 1).max() < 1e-3


def test_extremes_stay_between_black_and_white():
    far = np.array([0.0, 1e-6, 0.5, 1.0, 50.0])
    albedo = skin_albedo(np.repeat(far, 5), np.tile(far, 5))
    assert np.isfinite(albedo).all()
    assert albedo.min() > 0
    assert albedo.max() < 1


@pytest.mark.parametrize("blood", FACE_BLOOD)
def test_colour_stays_within_measured_human_skin(blood):
    """Ranges over thousands of measured faces: Xiao et al. 2017 (DOI 10.1111/srt.12295) and the very dark skin of
    Chardon's classes (1991; ITA below -30): L* 25 to 78, a* 4 to 20, b* 7 to 30."""
    lightness, a, b = cielab(spectral_albedo(np.geomspace(0.01, 0.30, 24), np.full(24, blood))).T
    assert 24 < lightness.min() < 32
    assert 64 < lightness.max() < 78
    assert 4 < a.min() < a.max() < 20
    assert 7 < b.min() < b.max() < 30
    # all six of Chardon's classes, from very light (above 55 at little blood) to dark (below -30)
    angle = np.degrees(np.arctan2(lightness - 50, b))
    assert angle.max() > 48
    assert angle.min() < -40


def test_chroma_is_highest_in_the_middle_of_the_range():
    """Light and very dark skins are both less colourful than tan ones (measured by spectrophotometer on 47 people of
    four groups, Wang et al., "Comparing skin colours between different skin groups")."""
    lab = cielab(spectral_albedo(np.geomspace(0.01, 0.30, 40), np.full(40, 0.016)))
    chroma = np.hypot(lab[:, 1], lab[:, 2])
    assert 5 < chroma.argmax() < 36
    assert chroma.max() > chroma[0] + 4
    assert chroma.max() > chroma[-1] + 4


@pytest.mark.slow
def test_a_tone_changes_the_skin_alone_and_not_what_the_light_is_exposed_for():
    from data_synth.subject import SkinTone, procedural_subject

    light, dark = (procedural_subject(np.random.default_rng(7), SkinTone(m, metered=0.05)) for m in (0.01, 0.2))
    np.testing.assert_array_equal(light.mesh.vertices, dark.mesh.vertices)
    np.testing.assert_array_equal(light.metered_albedo, dark.metered_albedo)
    region = light.regions(light.material_coordinates)
    np.testing.assert_array_equal(region, dark.regions(dark.material_coordinates))
    skin = region == next(number for number, name in light.region_names.items() if name == "skin")
    cloth = region == next(number for number, name in light.region_names.items() if name == "cloth")
    assert light.vertex_albedo[skin].mean() > 2.0 * dark.vertex_albedo[skin].mean()
    # What is half covered by cloth shows a little skin through its edge.
    assert abs(light.vertex_albedo[cloth] - dark.vertex_albedo[cloth]).mean() < 0.02
