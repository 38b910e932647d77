"""Hair, beards and headwear as fields: strands that close, faces that stay free, hats that lie over hair."""

from dataclasses import replace

import numpy as np
import pytest

from data_synth.head.beard import beard_cover, beard_zone, brow_cover, face_hair_relief_mm, inside_lips_mm
from data_synth.head.cover_params import BEARDS, HAIR_STYLES, HEADWEAR, Groom
from data_synth.head.hair import hair_field_mm
from data_synth.head.hair_colour import hair_albedo
from data_synth.head.hair_flow import SKULL, Flow, clumps, strand_coordinates, strands
from data_synth.head.hair_styles import STYLES, hairline_height
from data_synth.head.headwear import headwear_field_mm, headwear_zone, under_headwear
from data_synth.head.noise import plane_noise, smooth_max, smooth_min
from data_synth.head.params import HeadParams, mean_params
from sira_assets.errors import InputError


def test_every_style_has_a_shape():
    assert set(STYLES) == set(HAIR_STYLES)
    assert len(HAIR_STYLES) >= 10


def test_strands_are_meridians_of_their_pole():
    flow = Flow(pole=(0.2, 0.7, -0.5))
    pole = np.array(flow.pole) / np.linalg.norm(flow.pole)
    across = np.cross(pole, [0.3, 0.1, 0.9])
    across /= np.linalg.norm(across)
    angle = np.linspace(0.3, 2.8, 40)[:, None]
    along = SKULL + 90.0 * (np.cos(angle) * pole + np.sin(angle) * across)
    u, w, fade = strand_coordinates(along, flow, 0.0)
    assert np.ptp(u) < 1e-9
    assert (np.diff(w) > 0).all()
    assert (fade > 0).all()


def test_relief_closes_on_itself_around_the_head():
    u, w = np.linspace(-3, 3, 50), np.linspace(0, 3, 50)
    for make in (lambda a: clumps(a, w, 30, 4, 0.5), lambda a: strands(a, w, 200, 4)):
        assert np.abs(make(u) - make(u + 2 * np.pi)).max() < 1e-9  # whole waves only
    assert clumps(u, w, 30, 4).min() >= -0.65
    assert clumps(u, w, 30, 4).max() <= 0.35 + 1e-12


def test_noise_has_unit_spread_and_smooth_minimum_bounds():
    x = np.random.default_rng(0).uniform(-200, 200, (20_000, 3))
    # 30 independent waves: each realisation's RMS is 1 up to the sampling of the points
    assert abs(plane_noise(x, 3, 30, 20.0).std() - 1) < 0.05
    a, b = x[:, 0], x[:, 1]
    assert (smooth_min(a, b, 8.0) <= np.minimum(a, b)).all()
    assert np.abs(smooth_min(a, b, 8.0) - np.minimum(a, b)).max() <= 2.0 + 1e-12  # a quarter of the width
    assert np.array_equal(smooth_max(a, b, 8.0), -smooth_min(-a, -b, 8.0))


def _face_points() -> np.ndarray:
    """From the brows to the chin, on and before the skin of any template: (N, 3) mm."""
    x, y, z = np.meshgrid(np.linspace(-44, 44, 23), np.linspace(-105, 12, 30), np.linspace(2, 50, 9))
    return np.stack([x.ravel(), y.ravel(), z.ravel()], -1)


@pytest.mark.parametrize("style", HAIR_STYLES)
def test_hair_leaves_the_face_free(style):
    x = _face_points()
    for seed, length, fall in ((1, 0.72, 0.0), (2, 1.35, 40.0)):
        groom = Groom(front_fall_mm=fall, wave=1.0, clump=1.6, part=-1.0, front_mm=-8.0, peak_mm=9.0)
        params = replace(mean_params(style), seed=seed, hair_length=length, groom=groom)
        # before the face, so far from the scalp that only the sign matters
        assert hair_field_mm(x, params, np.full(len(x), 0.5)).min() > 0.5


def test_recession_lifts_the_hairline_and_a_peak_lowers_it():
    temple, middle = np.array([[40.0, 66.0, 0.0]]), np.array([[0.0, 70.0, 10.0]])
    plain = Groom(recede_mm=0.0, peak_mm=0.0)
    assert hairline_height(temple, replace(plain, recede_mm=15.0)) < hairline_height(temple, plain) - 8
    assert hairline_height(middle, replace(plain, peak_mm=8.0)) > hairline_height(middle, plain) + 6


@pytest.mark.parametrize("kind", BEARDS)
def test_beards_leave_lips_and_eyes_free(kind):
    params = replace(mean_params(), groom=Groom(beard=kind, beard_mm=15.0))
    x = _face_points()
    zone = beard_zone(x, kind)
    assert zone.min() >= 0
    assert zone.max() <= 1
    free = (inside_lips_mm(x) > 0.5) | (x[:, 1] > -2)
    assert zone[free].max() < 0.05
    assert beard_cover(x, params, np.zeros(len(x)))[free].max() < 0.05
    assert (kind == "none") == (zone.max() < 0.5)


def test_brows_rise_a_little_and_only_where_they_are():
    x = _face_points() + np.array([0.0, 20.0, 0.0])
    params = mean_params()
    relief, brow = face_hair_relief_mm(x, params), brow_cover(x, params)
    assert 0.3 < relief.max() < 1.2
    assert relief[brow < 1e-6].max() < 1e-6
    assert brow[np.abs(x[:, 0]) < 6].max() < 0.05  # two brows, not one


@pytest.mark.parametrize("kind", [k for k in HEADWEAR if k != "none"])
def test_hair_stays_below_headwear(kind):
    rng = np.random.default_rng(0)
    x = rng.uniform([-110, -60, -200], [110, 150, 40], (4000, 3))
    d = rng.uniform(-3, 40, 4000)
    base = mean_params("short")
    params = replace(base, dress=replace(base.dress, headwear=kind))
    g = headwear_field_mm(x, params, d)
    pressed = under_headwear(hair_field_mm(x, params, d), g, x, params)
    inside = headwear_zone(x, kind) > 0.999
    assert inside.sum() > 300
    assert (pressed - g)[inside].min() > 1.9


def test_hair_darkens_with_melanin_and_reddens_with_phaeomelanin():
    pigment = mean_params().pigment
    shades = np.array([hair_albedo(replace(pigment, hair_melanin=m)) for m in np.linspace(0, 1, 12)])
    assert (np.diff(shades, axis=0) < 0).all()
    # from nearly white blond to black
    assert shades[0].max() > 0.3
    assert shades[-1].max() < 0.05
    ash, red = (hair_albedo(replace(pigment, hair_melanin=0.4, hair_redness=r)) for r in (0.0, 1.0))
    assert red[0] / red[1] > ash[0] / ash[1]


def test_unknown_covers_are_refused():
    with pytest.raises(InputError, match="beard"):
        Groom(beard="mutton chops")
    with pytest.raises(InputError, match="headwear"):
        replace(mean_params().dress, headwear="crown")
    with pytest.raises(InputError, match="garment"):
        replace(mean_params().dress, garment="toga")
    with pytest.raises(InputError, match="hair style"):
        HeadParams(0, hair_style="mullet")
