"""The paper's ablations from scenes to its table, in small: what each setting is, and that a stopped run goes on."""

import json
import sys
from pathlib import Path

import pytest
from small_fits import TOOLS, make_scenes, tiny_settings

from sira_assets.fields.sa_sm import ShapeConfig
from sira_assets.scene.image import write_png

sys.path.append(str(Path(__file__).resolve().parents[1] / "scene"))
from scene_on_disk import SceneOnDisk


@pytest.fixture
def tool(monkeypatch):
    """`tools/run_ablations.py` as a module, its fits of a few steps."""
    monkeypatch.syspath_prepend(str(TOOLS))
    import _ablations
    import _fit_measurement
    import run_ablations

    from sira_assets import pipeline

    monkeypatch.setattr(_fit_measurement, "SAMPLES", 1000)
    monkeypatch.setattr(_ablations, "settings_for", tiny_settings)
    monkeypatch.setattr(pipeline, "settings_for", tiny_settings)
    return run_ablations


def test_the_one_network_has_as_many_weights_as_the_two(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    from _ablations import shape_models, shape_weights

    models = shape_models()
    assert set(models) == {"plain", "deformed", "full"}
    assert models["full"] == ShapeConfig()
    counts = {name: shape_weights(config) for name, config in models.items()}
    assert counts["deformed"] == counts["full"]
    # Widths go in steps of four: 2 * 4 / 180 of the weights.
    assert 1.0 <= counts["plain"] / counts["full"] < 1.06


def test_each_row_changes_what_it_says_and_keeps_the_steps(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    from _ablations import ABLATIONS

    rows = {row.name: row.settings(seed=3) for row in ABLATIONS}
    shape_steps = ("steps_appearance", "steps_codes", "steps_networks", "steps_cover")
    geometry = lambda s: sum(getattr(s.geometry, name) for name in shape_steps)  # noqa: E731
    steps = ("steps_light", "steps_albedo", "steps_specular", "steps_refinement")
    appearance = lambda s: sum(getattr(s.appearance, name) for name in steps)  # noqa: E731
    assert len({geometry(s) for s in rows.values()}) == 1
    assert len({appearance(s) for s in rows.values()}) == 1
    assert [name for name, s in rows.items() if s.geometry.steps_networks == 0] == ["a.1"]
    assert [name for name, s in rows.items() if not s.appearance.scheduled] == ["b.1"]
    assert [name for name, s in rows.items() if s.appearance.steps_refinement == 0] == ["b.2"]
    assert rows["a.4"] == rows["b.3"] == rows["a.2"]


def test_a_prior_is_found_again_for_the_same_settings_and_scenes_only(tool, tmp_path, monkeypatch):
    from sira_assets.train import prior

    trained = []

    def train_prior(scenes, path, run, **options):
        trained.append(run)
        path.touch()

    monkeypatch.setattr(prior, "train_prior", train_prior)
    for name in ("one", "other"):
        (tmp_path / name / "head").mkdir(parents=True)
        scene = SceneOnDisk(tmp_path / name / "head")
    write_png(scene.folder / "image.png", scene.pixels[::-1])

    def asked(*options, train="one"):
        folders = ["--train", str(tmp_path / train), "--out", str(tmp_path / "out")]
        assert tool.main(["SCENE", *folders, "--priors-only", "--only", "b.1", "--quiet", *options]) == 0
        return len(trained)

    assert [asked(), asked()] == [1, 1]
    assert [asked("--steps", "7"), asked("--steps", "7")] == [2, 2]
    assert [asked("--appearance-steps", "7"), asked("--seed", "7"), asked(train="other"), asked()] == [3, 4, 5, 5]
    assert len(set(trained)) == 5


def test_no_scenes_to_train_on_is_bad_input(tool, tmp_path, capsys):
    assert tool.main([str(tmp_path), "--train", str(tmp_path), "--out", str(tmp_path / "out"), "--quiet"]) == 3
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_from_scenes_to_the_table_and_on_from_what_is_there(tool, egg, tmp_path, capsys, monkeypatch):
    scenes = make_scenes(tmp_path / "scenes", egg, "--count", 1, "--views", 1, "--size", 64)
    table = tmp_path / "table.json"
    command = [str(scenes / "egg_000000"), "--train", str(scenes), "--out", str(tmp_path / "out"), "--quiet"]
    command += ["--steps", "2", "--appearance-steps", "1", "--workers", "1", "--table", str(table)]
    assert tool.main(command) == 0
    said = capsys.readouterr().out
    rows = {row["row"]: row for row in json.loads(table.read_text())}
    assert sorted(rows) == ["a.1", "a.2", "a.3", "a.4", "b.1", "b.2", "b.3"]
    assert all(row in said for row in rows)
    assert "2.17" in said  # the paper's
    assert all(0 < rows[name]["placed"] < 100 for name in ("a.1", "a.2", "a.3", "a.4"))
    assert len({rows[name]["final"] for name in ("b.1", "b.2", "b.3")}) == 3
    assert len(list((tmp_path / "out" / "priors").glob("samples-*"))) == 1  # one stack for three priors

    import _fit_measurement

    def fitted_again(*arguments):
        raise AssertionError("fitted again")

    monkeypatch.setattr(_fit_measurement, "fit_shape", fitted_again)
    (tmp_path / "out" / "figures" / "egg_000000" / "b.2.json").unlink()
    assert tool.main([*command, "--only", "a.1", "a.4"]) == 0
    with pytest.raises(AssertionError, match="fitted again"):
        tool.main(command)
