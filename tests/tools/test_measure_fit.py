"""The tools that measure fits: known answers of what they add up, and each of them once in small."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from small_fits import TOOLS, make_scenes, tiny_settings

from sira_assets.scene.camera import Camera
from sira_assets.scene.image import write_png
from sira_assets.scene.sg_light import SGLight

sys.path.append(str(Path(__file__).resolve().parents[1] / "scene"))
from scene_on_disk import SceneOnDisk


@pytest.fixture(autouse=True)
def _tools(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.fixture(scope="module")
def scene_folder(egg, tmp_path_factory):
    return make_scenes(tmp_path_factory.mktemp("eggs"), egg, "--count", 1, "--views", 2, "--size", 64) / "egg_000000"


@pytest.fixture
def scene(scene_folder):
    from _fit_measurement import read_measured_scene

    return read_measured_scene(scene_folder, scene_folder)


@pytest.fixture
def tool(monkeypatch):
    """`tools/measure_fit.py` as a module, its fits of a few steps."""
    import _fit_measurement
    import _measure_heldout
    import measure_fit

    from sira_assets import pipeline

    monkeypatch.setattr(pipeline, "settings_for", tiny_settings)
    for module in (_fit_measurement, _measure_heldout):
        monkeypatch.setattr(module, "SAMPLES", 500)
    return measure_fit


def rotated(degrees):
    a = np.radians(degrees)
    out = np.eye(4)
    out[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
    return out


def test_renders_have_the_roughness_that_was_found(monkeypatch, scene):
    import _fit_measurement

    from sira_assets.render import view

    told = {}
    monkeypatch.setattr(view, "render_view", lambda *args, **options: told.update(args=args, **options))
    shape = SimpleNamespace(portrait=scene.portrait, surface=None)
    found = SimpleNamespace(head=None, roughness=0.37, shadowed=False)
    _fit_measurement.rendered(shape, found, scene.portrait.camera, "light")
    assert told["args"][4:6] == ("light", 0.37)


def test_figures_scored_in_another_way_are_not_taken_for_these(tmp_path, monkeypatch):
    import _fit_measurement

    facts = {"settings": "one"}
    assert _fit_measurement.Results(tmp_path, facts).of("a", lambda: {"mm": 1.0}) == {"mm": 1.0}
    assert _fit_measurement.Results(tmp_path, facts).of("a", lambda: {"mm": 2.0}) == {"mm": 1.0}
    monkeypatch.setattr(_fit_measurement, "SCORING", _fit_measurement.SCORING + 1)
    assert _fit_measurement.Results(tmp_path, facts).of("a", lambda: {"mm": 2.0}) == {"mm": 2.0}


def test_pose_error_of_known_motions():
    """A turn about the head's origin, a shift across the sight and another size are told apart, in any world."""
    from _measure_pose import pose_error

    world = rotated(40.0)
    world[:3, 3] = (0.3, -1.0, 2.0)
    world[:3, :3] *= 1.07
    camera_from_canonical = np.diag([1.0, -1.0, -1.0, 1.0])
    camera_from_canonical[2, 3] = 1.25
    pose = np.linalg.inv(world) @ np.linalg.inv(camera_from_canonical)
    pose[:3, :3] /= np.cbrt(np.linalg.det(pose[:3, :3]))
    camera = Camera(np.array([[500.0, 0, 32], [0, 500, 32], [0, 0, 1]]), pose, 64, 64)
    error = lambda found: pose_error(SimpleNamespace(camera=camera, canonical_from_world=found), world)  # noqa: E731
    for value in error(world).values():
        assert value == pytest.approx(0.0, abs=1e-5)  # arccos near 1 keeps half of float64's digits
    assert error(rotated(2.0) @ world)["turn_deg"] == pytest.approx(2.0, abs=1e-6)
    assert error(rotated(2.0) @ world)["aside_mm"] == pytest.approx(0.0, abs=1e-6)
    aside = np.eye(4)
    aside[0, 3] = 0.005
    assert error(aside @ world)["aside_mm"] == pytest.approx(5.0, rel=1e-4)  # 5 mm at 1.25 m: chord against shift


def test_light_error_is_that_of_irradiance(tmp_path):
    from _measure_heldout import light_error

    light = SGLight([[0.0, 0.0, 1.0]], [4.0], [[2.0, 1.0, 0.5]])
    path = tmp_path / "lights.json"
    path.write_text(json.dumps(light.to_dict()))
    assert light_error(light, path)["light"] == pytest.approx(0.0, abs=1e-12)
    brighter = light_error(light.scaled(1.5), path)
    assert brighter["light"] == pytest.approx(0.5, rel=1e-9)
    assert brighter["light_one_gain"] == pytest.approx(0.0, abs=1e-9)
    turned = light_error(SGLight([[0.0, 0.0, -1.0]], [4.0], [[2.0, 1.0, 0.5]]), path)
    assert turned["light_one_gain"] > 0.5
    assert light_error(light, tmp_path / "none.json") == {}


def test_albedo_error_is_relative_to_the_mean(scene_folder):
    from _measure_fairness import albedo_error, melanin_of

    from sira_assets.scene.image import read_image, read_mask

    true, skin = read_image(scene_folder / "gt" / "albedo.exr").linear, read_mask(scene_folder / "mask.png")
    found = albedo_error(1.2 * true, scene_folder, skin)
    assert found["albedo"] == pytest.approx(0.2, rel=1e-5)
    assert found["albedo_one_gain"] == pytest.approx(0.0, abs=1e-6)
    assert melanin_of(0.0) < melanin_of(0.5) < melanin_of(1.0)
    assert melanin_of(0.5) ** 2 == pytest.approx(melanin_of(0.0) * melanin_of(1.0))


def test_results_count_only_under_the_same_facts(tmp_path):
    from _fit_measurement import Results

    asked = []

    def compute():
        asked.append(1)
        return {"x": np.float64(1.23456789), "said": ("a",)}

    for _ in range(2):  # computed, then found
        assert Results(tmp_path, {"seed": 0}).of("case", compute) == {"x": 1.23457, "said": ["a"]}
    assert len(asked) == 1
    Results(tmp_path, {"seed": 1}).of("case", compute)
    assert len(asked) == 2
    Results(tmp_path, {"seed": 1}).of("case", compute, scene="other")
    assert len(asked) == 3
    (tmp_path / "case.json").write_text("{")
    Results(tmp_path, {"seed": 1}).of("case", compute, scene="other")
    assert len(asked) == 4


def test_figures_are_a_scene_s_own_whatever_its_name(tool, tmp_path, monkeypatch):
    """Another set under the same names is measured anew; two scenes of one name are kept side by side."""
    import _measure_heldout

    asked = []
    monkeypatch.setattr(_measure_heldout, "print_heldout", lambda rows: None)
    monkeypatch.setattr(_measure_heldout, "measure_heldout", lambda scene, *_: asked.append(scene.folder) or {})
    monkeypatch.setattr("_fit_measurement.read_measured_scene", lambda f, t: SimpleNamespace(folder=f, truth=t))
    monkeypatch.setattr("sira_assets.fields.prior.load_prior", lambda path: None)
    made = []
    for place in ("one", "other", "again"):
        folder = tmp_path / place / "head"
        folder.mkdir(parents=True)
        made.append(SceneOnDisk(folder))
    write_png(made[1].folder / "image.png", made[1].pixels[::-1])
    one, other, again = (str(scene.folder) for scene in made)

    def measured(*scenes):
        asked.clear()
        assert tool.main(["heldout", *scenes, "--out", str(tmp_path / "out"), "--quiet"]) == 0
        return [str(folder) for folder in asked]

    assert measured(one) == [one]
    assert measured(one) == []
    assert measured(again) == []  # the same scene elsewhere
    assert measured(other) == [other]
    assert measured(f"{other}={one}") == [other]
    assert measured(one, other) == [one, other]
    assert measured(one, other) == []
    made[1].data["fl_x"] *= 1.1
    made[1].save()
    assert measured(one, other) == [other]


def test_tones_of_other_options_are_other_scenes(tmp_path, monkeypatch):
    from _measure_fairness import write_tones

    import data_synth.draw_scene
    import data_synth.write_scene

    drawn = []
    monkeypatch.setattr(data_synth.draw_scene, "draw_scene", lambda settings, index, tone: settings)
    monkeypatch.setattr(
        data_synth.write_scene, "write_scene", lambda settings, folder: drawn.append(settings) or folder.mkdir()
    )
    options = {"size": 64, "samples": 4, "seed": 0}
    for changed in ({}, {"size": 32}, {"samples": 8}, {"seed": 1}):
        for new in (3, 0):
            drawn.clear()
            write_tones(tmp_path, range(1), **options | changed)
            assert len(drawn) == new


def test_truth_is_in_metres_whatever_the_world_s_unit(tmp_path):
    """A world of centimetres that does not say so: the portrait's reader finds it, and the truth goes by that."""
    import trimesh
    from _fit_measurement import read_measured_scene
    from _tradeoff_measures import read_measured

    scene = SceneOnDisk(tmp_path)
    pose = np.array(scene.frame["transform_matrix"])
    pose[:3, 3] *= 100.0
    scene.frame["transform_matrix"] = pose.tolist()
    scene.data["canonical_from_world"] = np.diag([0.01, 0.01, 0.01, 1.0]).tolist()
    scene.save()
    (tmp_path / "gt").mkdir()
    trimesh.creation.icosphere(2, radius=12.0).export(tmp_path / "gt" / "mesh.ply")
    for read in (lambda: read_measured_scene(tmp_path, tmp_path), lambda: read_measured(tmp_path)):
        truth = read().truth
        np.testing.assert_allclose(np.ptp(truth.mesh.vertices, axis=0), 0.24, rtol=1e-6)
        np.testing.assert_allclose(truth.canonical_from_world, np.eye(4), atol=1e-12)
        np.testing.assert_allclose(truth.camera.world_from_camera, scene.camera.world_from_camera, atol=1e-12)


def test_every_case_spoils_what_it_names(scene):
    from _measure_stability import CASES

    spoilt = {case.name: case.spoil(scene) for case in CASES if "4096" not in case.name}
    files = {"".join(c if c.isalnum() else "_" for c in case.name) for case in CASES}
    assert len(files) == len(CASES)  # figures are kept under these names
    p = spoilt.pop("sound")

    def bright(name):
        return spoilt[name].saturated[spoilt[name].mask].mean()

    def black(q):
        return (q.image_linear[q.mask].max(-1) < 1e-3).mean()

    assert bright("saturated") > 0.3
    assert bright("extreme light") > 0.1
    assert black(spoilt["extreme light"]) > 0.2
    assert black(spoilt["black region"]) > black(p) + 0.15
    assert 0.3 < spoilt["holes in the mask"].mask.sum() / p.mask.sum() < 0.98
    assert spoilt["focal length 1.2 times"].camera.intrinsics[0, 0] == pytest.approx(1.2 * p.camera.intrinsics[0, 0])
    small = spoilt["64 pixels"]
    assert small.image_linear.shape == (64, 64, 3)
    # The same rays whatever the number of pixels: the head's centre stays at its share of the picture.
    centre = np.linalg.inv(p.canonical_from_world)[None, :3, 3]
    u, v = (q.camera.project(centre)[0][0] / q.camera.width for q in (p, small))
    np.testing.assert_allclose(u, v, atol=1e-9)
    for name in ("yaw", "pitch"):
        turned = spoilt[f"camera 3 deg about the head, {name}"].canonical_from_world
        turn = turned[:3, :3] @ np.linalg.inv(p.canonical_from_world[:3, :3])
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(3.0, abs=1e-6)


def test_not_a_scene_is_one_line(tool, tmp_path, capsys):
    assert tool.main(["heldout", str(tmp_path), "--out", str(tmp_path / "out"), "--quiet"]) == 3
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_held_out_and_pose_in_small(tool, scene_folder, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out"), "--quiet"]
    assert tool.main(["heldout", str(scene_folder.parent), *out, "--table", str(tmp_path / "t.csv")]) == 0
    said = capsys.readouterr().out
    assert "novel_seen" in said
    assert "geometry" in said
    assert (tmp_path / "t.csv").read_text().startswith("scene,")
    command = ["pose", str(scene_folder), *out, "--json", "--noise", "0"]
    assert tool.main(command) == 0
    (row,) = json.loads(capsys.readouterr().out)
    # Without noise and with the population's own landmarks, the pose is found; the solver stops at 1e-8 of its cost.
    assert row["before_turn_deg"] < 0.2
    assert row["before_aside_mm"] < 0.2
    assert row["given_placed"] > 0


def test_every_extreme_is_what_it_says(scene):
    from _measure_extremes import CASES, accepted

    assert len({case.name for case in CASES}) == len(CASES)
    made = {case.name: case.spoil(scene) for case in CASES if "8192" not in case.name}
    p = scene.portrait
    assert made["black"].image_linear.max() == 0.0
    assert made["white"].saturated.all()
    assert (made["one pixel of light"].image_linear.max(-1) > 0).sum() == 1
    assert made["mask of 50 pixels"].mask.sum() == 50
    assert made["mask that is everything"].mask.all()
    # A sharp lamp is a directional one: what it lights is the cosine, so half of a ball and no more.
    lamp = made["lamp of sharpness 1e6"].image_linear[p.mask].max(-1)
    assert np.isfinite(lamp).all()
    assert 0.5 < (lamp > 0.01).mean() <= 1.0
    assert (made["rim light"].image_linear[p.mask].max(-1) > 0.01).mean() < 0.5
    tele, wide, far = (made[name] for name in ("field of view 2 deg", "field of view 170 deg", "10 m away"))
    for q, degrees in ((tele, 2.0), (wide, 170.0)):
        assert 2 * np.degrees(np.arctan(q.camera.width / 2 / q.camera.intrinsics[0, 0])) == pytest.approx(degrees)
    assert 0.05 < tele.mask.mean() < 0.9
    assert far.mask.sum() < 0.1 * tele.mask.sum()
    # What another camera sees is the photo: the head's mean colour stays, but for what the photo did not see.
    mean = p.image_linear[p.mask].mean(0)
    np.testing.assert_allclose(tele.image_linear[tele.mask].mean(0), mean, rtol=0.35)
    # A refusal in words is an end as good as a sane avatar; anything else is not.
    assert accepted({"sane": False, "wrong": "refused"})["sane"]
    assert not accepted({"sane": False, "wrong": "radiance"})["sane"]


def test_a_scene_under_made_light_is_its_own_maps_shaded(scene):
    from _measure_thrift import LIGHTS, drawn_lobes, relit

    axis, sharpness, amplitude = drawn_lobes(40, np.random.default_rng(0))
    assert (axis[:, 2] > 0).all()
    flux = 2 * np.pi * amplitude / sharpness[:, None]
    assert flux.std() < 0.1 * flux.mean()  # but for colour, which differs by 15 % at most
    p = scene.portrait
    plain, shiny = (relit(scene, 3, highlights, 0) for highlights in (False, True))
    for q in (plain, shiny):
        assert q.image_linear[~p.mask].max() == 0.0
        assert 0.3 < np.quantile(q.image_linear[p.mask], 0.98) <= 1.0
        assert 0.0 < q.saturated[p.mask].mean() < 0.03 or not q.saturated.any()
    assert not np.allclose(plain.image_linear, shiny.image_linear, atol=1e-3)
    assert {highlights for _, highlights in LIGHTS} == {True, False}


@pytest.mark.slow
def test_thrift_fits_twice_and_says_what_it_kept(tool, scene, capsys, tmp_path):
    assert tool.main(["thrift", str(scene.folder), "--out", str(tmp_path), "--quiet", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert 1 <= row["lobes_kept"] <= 12
    for kind in ("required", "everything"):
        assert row[f"{kind}_s"] > row["shape_s"] > 0
        assert row[f"{kind}_kB"] > 1
        for name in ("final", "asset", "diffuse"):
            assert np.isfinite(row[f"{kind}_{name}"])


@pytest.mark.slow
def test_an_extreme_is_refused_in_words(tool, scene, capsys, monkeypatch, tmp_path):
    import _measure_extremes

    wanted = [case for case in _measure_extremes.CASES if case.name == "black"]
    monkeypatch.setattr(_measure_extremes, "CASES", wanted)
    assert tool.main(["extremes", str(scene.folder), "--out", str(tmp_path), "--quiet"]) == 0
    assert "refused" in capsys.readouterr().out


@pytest.mark.slow
def test_a_spoilt_scene_ends_sane(tool, scene, capsys, monkeypatch, tmp_path):
    import _measure_stability

    # The tool's own case is six times as bright: of this small bright scene it would leave nothing to fit.
    twice = lambda s: _measure_stability.clipped(s.portrait, 2.0 * s.portrait.image_linear)  # noqa: E731
    wanted = [case for case in _measure_stability.CASES if case.name in ("saturated", "holes in the mask")]
    monkeypatch.setattr(_measure_stability, "CASES", [replace(wanted[0], spoil=twice), wanted[1]])
    command = ["stability", str(scene.folder), "--out", str(tmp_path), "--quiet"]
    assert tool.main([*command, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["sane"] for row in rows] == [True, True]
    assert any("clipped" in line for line in rows[0]["said"])
    assert any("holes" in line for line in rows[1]["said"])


def test_an_open_or_empty_avatar_is_not_sane(scene):
    import trimesh
    from _measure_stability import insane

    from sira_assets.mesh.triangle_mesh import TriangleMesh

    ball = trimesh.creation.icosphere(2, 0.2)
    mesh = TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    light = SGLight([[0.0, 0.0, 1.0]], [4.0], [[1.0, 1.0, 1.0]])
    view = SimpleNamespace(final=np.zeros((2, 2, 3)), hit=np.ones((2, 2), bool))
    avatar = SimpleNamespace(mesh=mesh, light=light)
    journey = SimpleNamespace(surface=mesh, avatar=avatar, view=view, portrait=scene.portrait)
    assert insane(journey) == []
    journey.surface = replace(mesh, faces=mesh.faces[1:])
    assert "3 open edges" in insane(journey)[0]
    journey.surface, view.final = mesh, np.full((2, 2, 3), np.nan)
    assert insane(journey) == ["radiance"]
