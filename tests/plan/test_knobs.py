"""Every knob puts what it reads, leaves the rest alone, and says which stages it touches."""

from dataclasses import replace

import pytest

from sira_assets.fit.geometry_losses import GeometryFitConfig
from sira_assets.pipeline import Settings, settings_for
from sira_assets.plan.knobs import KNOBS, knob, place

STAGES = {
    "fit geometry",
    "extract",
    "clean",
    "fit appearance",
    "shadows",
    "simplify",
    "measure",
    "unwrap",
    "bake",
    "render",
    "write",
}


@pytest.mark.parametrize("one", KNOBS, ids=lambda k: k.name)
def test_a_knob_reads_what_it_puts_and_turns_nothing_else(one):
    for quality in ("draft", "standard", "high"):
        start = settings_for(quality)
        for value in one.values:
            settings = one.put(start, value)
            read = one.read(settings)
            # Steps and rays are whole numbers: a factor of 0.06 of 80 steps is 5 of them.
            assert read == (value if isinstance(value, str) else pytest.approx(value, rel=0.03))
            others = [k for k in KNOBS if k is not one]
            assert [k.read(settings) for k in others] == [k.read(start) for k in others]
    assert set(one.stages) <= STAGES


def test_defaults_are_what_a_knob_says_of_them():
    settings = Settings()
    assert knob("geometry steps").put(settings, 1.0) == settings
    assert knob("appearance steps").put(settings, 1.0) == settings
    assert knob("geometry rays").put(settings, 1.0) == settings
    assert replace(settings, photo_side=None) == knob("photo size").put(settings, "all")
    with pytest.raises(KeyError):
        knob("luck")


def test_few_geometry_steps_leave_the_networks_alone_and_read_less_of_the_shading():
    one, default = knob("geometry steps"), GeometryFitConfig()
    fits = [one.put(settings_for("standard"), f).geometry for f in (0.02, 0.1, 0.25, 0.5, 1.0, 2.0)]
    assert [g.steps_networks > 0 for g in fits] == [False, False, False, True, True, True]
    assert all(g.steps_appearance > 0 and g.steps_codes > 0 and g.steps_cover > 0 for g in fits)
    # Those of the networks are given away, not saved: a quarter of the default is a quarter of all steps.
    all_steps = lambda g: g.steps_appearance + g.steps_codes + g.steps_networks + g.steps_cover  # noqa: E731
    assert all_steps(fits[2]) == pytest.approx(0.25 * all_steps(default), abs=2)
    holds = [g.hold for g in fits]
    assert holds == sorted(holds)
    assert holds[2] == holds[5] == default.hold
    reads = [(g.shading.pixels, g.shading.steps) for g in fits]
    assert reads == sorted(reads)
    assert reads[0] >= (600, 3)
    assert fits[3].shading == fits[5].shading == default.shading


def test_presets_take_their_places_on_the_geometrys_curve():
    steps = [knob("geometry steps").read(settings_for(q)) for q in ("draft", "standard", "high")]
    assert steps == sorted(steps)
    assert steps[1] == pytest.approx(1.5)
    assert knob("geometry rays").read(settings_for("standard")) == 0.6
    assert knob("geometry steps").put(settings_for("draft"), 1.5).geometry.steps_networks == 480


def test_names_are_different():
    assert len({k.name for k in KNOBS}) == len(KNOBS)


def test_places_between_measured_values():
    assert place((1.0, 4.0, 16.0), 4.0) == (1, 1, 0.0)
    assert place((1.0, 4.0, 16.0), 8.0) == (1, 2, pytest.approx(0.5))
    assert place((16.0, 4.0, 1.0), 2.0) == (2, 1, pytest.approx(0.5))
    assert place((1.0, 4.0), 0.1) == (0, 0, 0.0)
    assert place((1.0, 4.0), 99.0) == (1, 1, 0.0)
    assert place((64, 128, "all"), "all") == (2, 2, 0.0)
    assert place((64, 128, "all"), 90) == (0, 1, pytest.approx(0.49, abs=0.01))
    assert place((0, 64, 256), 0) == (0, 0, 0.0)
    assert place(("fast", "accurate"), "accurate") == (1, 1, 0.0)
