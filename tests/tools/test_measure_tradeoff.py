"""tools/measure_tradeoff.py: a tiny sweep makes the page, goes on where it stopped, and keeps what does not change."""

import csv
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"
sys.path.insert(0, str(TOOLS))
from _tradeoff_figures import REFERENCE, Record, Setting, compared, curve_of, write_csv  # noqa: E402
from _tradeoff_keep import FarEnough, StageKeeper, digest, measured  # noqa: E402
from _tradeoff_measures import bare_percent  # noqa: E402
from _tradeoff_promises import Kept, bought, bought_section, promise_section  # noqa: E402


@dataclass(frozen=True)
class Made:
    values: np.ndarray
    said: str = ""


def test_digests_tell_contents_apart_and_nothing_else():
    import torch

    a, b = Made(np.arange(3.0), "x"), Made(np.arange(3.0), "x")
    assert digest(a) == digest(b)
    others = [Made(np.arange(3.0), "y"), Made(np.arange(3), "x"), Made(np.arange(3.0)[None], "x"), ("x", b), [b], None]
    others += [torch.nn.Linear(2, 2), torch.nn.Linear(2, 2), {"x": 1}, {"x": 1.0}, 1, True, "1"]
    assert len({digest(o) for o in [a, *others]}) == 1 + len(others)
    assert digest({"x": 1, "y": 2}) == digest({"y": 2, "x": 1})
    with pytest.raises(TypeError, match="function"):
        digest(digest)


def test_a_stage_is_run_once_for_the_same_inputs_and_found_by_a_later_process(tmp_path):
    calls = []

    def double(made, report=None):
        calls.append(made)
        return Made(2 * made.values)

    keeper = StageKeeper(tmp_path)
    start = Made(np.ones(3))
    first = keeper("fit geometry", double, start, report=print)
    again = keeper("fit geometry", double, Made(np.ones(3)), report=len)
    assert again is first
    assert len(calls) == 1
    assert keeper.runs[0] == keeper.runs[1]
    keeper("fit geometry", double, Made(np.zeros(3)))
    assert len(calls) == 2
    later = StageKeeper(tmp_path)
    assert later("fit geometry", double, start).values.tolist() == [2.0, 2.0, 2.0]
    assert len(calls) == 2
    # A file that was cut off is no stage; it is made again.
    for path in tmp_path.glob("*.pickle"):
        path.write_bytes(path.read_bytes()[:20])
    assert StageKeeper(tmp_path)("fit geometry", double, start).values.tolist() == [2.0, 2.0, 2.0]
    assert len(calls) == 3


def test_a_run_ends_where_it_should_and_leaves_out_what_it_may(tmp_path):
    keeper = StageKeeper(tmp_path)
    keeper("bake", lambda made: Made(made.values + 1), Made(np.ones(1)))
    keeper.begin(left_out=("bake", "write"))
    assert keeper("bake", lambda made: 1 / 0, Made(np.zeros(1))).values.tolist() == [2.0]
    assert keeper.runs == []
    assert keeper("write", lambda: "made, for nothing was kept") == "made, for nothing was kept"
    keeper.begin(last="clean")
    with pytest.raises(FarEnough):
        keeper("clean", lambda: 7)
    assert keeper.made == {"clean": 7}


def test_processor_time_of_children_counts():
    burn = "sum(i * i for i in range(3_000_000))"
    _, run = measured("x", subprocess.run, [sys.executable, "-S", "-c", burn], check=True)
    assert run.cpu_s > 0.05  # three million squares take some tenths of a second, and none of them in this process
    assert run.wall_s >= 0.5 * run.cpu_s  # one process, one thread


def record(knob, value, seconds, loss, *, speed=1.0, seed=0, scene="a", bake=2.0, as_reference=()):
    bench = {"network_s": 0.01 * speed, "rays_s": 0.02 * speed, "arrays_s": 0.03 * speed}
    stages = {"fit geometry": (seconds, 2 * seconds, 10), "bake": (bake, bake, 20)}
    stages = {k: v for k, v in stages.items() if k not in as_reference}
    return Record(scene, seed, knob, value, stages, bench, {"face_mm": loss, "final_db": 20 - loss}, as_reference)


def test_costs_are_beside_the_reference_of_that_scene_and_machine():
    records = [
        record(REFERENCE, "standard", 10.0, 1.0),
        record(REFERENCE, "standard", 30.0, 1.2, scene="b"),
        # The machine was half as fast at that moment.
        record("geometry steps", 0.5, 12.0, 1.5, speed=2.0, bake=4.0),
        record("geometry steps", 0.5, 18.0, 1.5, scene="b", as_reference=("bake",)),
    ]
    _, half = compared(records)
    assert half.stage_ratios == pytest.approx({"fit geometry": 0.6, "bake": 1.0})
    assert half.ratio == pytest.approx(np.mean([8 / 12, 20 / 32]))
    assert half.deltas["face_mm"] == pytest.approx(0.4)
    assert half.deltas["final_db"] == pytest.approx(0.4)  # a decibel less is worse
    # A stage that was found has the reference's own figures, however fast the machine is now.
    found = record("geometry steps", 0.25, 3.0, 1.5, speed=3.0)
    assert compared([records[0], found])[1].stage_ratios == pytest.approx({"fit geometry": 0.1, "bake": 1.0})
    assert half.spread["face_mm"] == pytest.approx(np.std([0.5, 0.3], ddof=1))
    # One head far from the others does not carry them.
    records += [record(REFERENCE, "standard", 10.0, 5.0, scene="c"), record("geometry steps", 0.5, 5.0, 3.0, scene="c")]
    assert compared(records)[1].deltas["face_mm"] == pytest.approx(0.3)


def test_a_curve_has_its_own_stages_only_and_its_values_in_order():
    from sira_assets.plan.knobs import knob

    base, one, two = compared(
        [
            record(REFERENCE, "standard", 10.0, 1.0),
            record("geometry steps", 2.0, 20.0, 0.9, bake=3.0),
            record("geometry steps", 0.25, 2.5, 2.0),
        ]
    )
    curve = curve_of([one, two, replace(base, knob="geometry steps", value=1.0)], knob("geometry steps"))
    assert [p.value for p in curve.points] == [0.25, 1.0, 2.0]
    assert [p.ratio("fit geometry") for p in curve.points] == pytest.approx([0.25, 1.0, 2.0])
    assert [p.ratio("bake") for p in curve.points] == [1.0, 1.0, 1.0]  # the knob does not touch it: noise


@pytest.mark.parametrize(
    ("name", "value", "others"), [("geometry steps", 0.3, (0.25, 0.5)), ("extraction cell", 2.5, (3.0, 2.0))]
)
def test_a_reference_between_the_values_stands_between_them(name, value, others):
    """Some knobs grow towards dearer values, some fall."""
    from sira_assets.plan.knobs import knob

    base, *rows = compared(
        [record(REFERENCE, "draft", 10.0, 1.0), *(record(name, v, 10.0 + k, 1.0) for k, v in enumerate(others))]
    )
    curve = curve_of([*rows, replace(base, knob=name, value=value)], knob(name))
    assert [p.value for p in curve.points] == [others[0], value, others[1]]


def test_pixels_without_a_surface_are_counted():
    from sira_assets.mesh.triangle_mesh import TriangleMesh
    from sira_assets.scene.camera import Camera

    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])  # OpenCV: looks along -z of the world, y down
    camera = Camera(np.array([[40.0, 0, 20], [0, 40.0, 10], [0, 0, 1]]), pose, 40, 20)
    # At a distance of 1, 40 pixels to a unit: x in [-0.25, 0.25] is ten columns on either side of the axis.
    corners = np.array([[-0.25, -1, -1], [0.25, -1, -1], [0.25, 1, -1], [-0.25, 1, -1]], float)
    strip = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    mask = np.ones((20, 40), bool)
    assert bare_percent(strip, camera, mask) == pytest.approx(50.0)
    mask[:, :10] = False
    assert bare_percent(strip, camera, mask) == pytest.approx(100.0 / 3.0)
    mask[:, 30:] = False
    assert bare_percent(strip, camera, mask) == 0.0


def test_every_run_is_a_line_of_the_table(tmp_path):
    write_csv([record(REFERENCE, "standard", 10.0, 1.0), record("lobes", 3, 5.0, 2.0)], tmp_path / "runs.csv")
    rows = list(csv.DictReader((tmp_path / "runs.csv").read_text().splitlines()))
    assert [(r["knob"], float(r["cpu_s"]), float(r["face_mm"])) for r in rows] == [
        ("reference", 12.0, 1.0),
        ("lobes", 7.0, 2.0),
    ]


def test_wrong_usage(tmp_path):
    command = [sys.executable, str(TOOLS / "measure_tradeoff.py"), "--out", str(tmp_path)]
    assert subprocess.run([*command, "--count", "0"], capture_output=True).returncode == 2
    done = subprocess.run([*command, "nowhere", "--knob", "luck"], capture_output=True, text=True)
    assert done.returncode == 3
    assert "geometry steps" in done.stderr


def kept(scene, seconds, face, seed=0, final=30.0, took=None):
    measures = {"face_mm": face, "final_psnr_db": final}
    took = seconds if took is None else took
    return Kept(scene, f"{seconds}s", float(seconds), took, seconds, measures if took else {}, seed)


def test_a_budget_is_kept_within_a_fifth_and_a_tolerance_altogether():
    assert kept("a", 100, 1.0, took=119.0).holds
    assert not kept("a", 100, 1.0, took=121.0).holds
    assert Kept("a", "0.5mm", 0.5, 0.499, None, {}).holds
    assert not Kept("a", "0.5mm", 0.5, 0.501, None, {}).holds
    rows = promise_section([kept("a", 100, 1.0, took=121.0), Kept("a", "5s", 5.0, None, None, {}, 1)]).rows
    assert [(row[0], row[2], row[-1]) for row in rows] == [("a", "121", "not kept"), ("a, seed 1", "refused", "")]


def test_more_time_is_worse_where_chance_does_not_explain_it():
    # Two scenes and two seeds of each budget that differ by 0.2: a deviation of sqrt(2) / 10 everywhere.
    runs = [
        *(kept(s, 60, f, seed) for s in "ab" for seed, f in enumerate((1.1, 0.9))),
        *(kept("a", 180, f, seed) for seed, f in enumerate((1.3, 1.1))),
        *(kept("b", 180, f, seed) for seed, f in enumerate((0.8, 1.0))),
    ]
    face, final = bought(runs)
    assert (face.shorter, face.longer, face.worst) == ("60s", "180s", "a")
    assert face.change == pytest.approx(0.05)
    assert face.worst_change == pytest.approx(0.2)
    assert face.worst_chance == pytest.approx(0.1 * np.sqrt(2.0))
    assert face.chance == pytest.approx(0.1)
    assert not face.worse
    assert not final.worse
    assert final.change == 0.0
    # Student's t of 4 degrees of freedom: two measures, on average and on either scene, share 5 %.
    assert face.limit == pytest.approx(3.495, abs=0.01)
    assert face.worst_limit == pytest.approx(4.315, abs=0.01)

    def moved(a, b):
        more = {("a", 180.0): a, ("b", 180.0): b}
        return [
            replace(k, measures={"face_mm": k.measures["face_mm"] + more.get((k.scene, k.asked), 0.0)}) for k in runs
        ]

    (one,) = bought(moved(0.7, -0.7))  # one scene far worse, another as much better
    assert one.change == pytest.approx(0.05)
    assert one.worse
    (all_of_them,) = bought(moved(0.35, 0.35))  # each a little: no scene by itself says it
    assert all_of_them.worst_change < all_of_them.worst_limit * all_of_them.worst_chance
    assert all_of_them.worse
    assert bought_section([all_of_them]).rows[0][-1] == "worse"
    assert not bought(moved(0.2, 0.2))[0].worse


def test_a_render_that_meets_the_photo_better_is_no_loss():
    runs = [kept("a", s, 1.0, seed, final=f + 0.1 * seed) for s, f in ((60, 25.0), (180, 35.0)) for seed in (0, 1)]
    (final,) = (m for m in bought(runs) if m.measure == "final_psnr_db")
    assert final.change == pytest.approx(-10.0)
    assert not final.worse


def test_of_one_seed_or_of_refusals_nothing_is_said():
    runs = [kept("a", 60, 1.0), kept("a", 180, 3.0)]
    assert not any(m.worse for m in bought(runs))
    assert not any(m.worse for m in bought([*runs, *(replace(k, seed=1) for k in runs)]))  # seeds that agree to the bit
    assert bought([kept("a", 20, 1.0, took=0.0), *runs])[0].shorter == "60s"
    assert bought([replace(runs[0], kept=None), runs[1]]) == []


@pytest.mark.slow
def test_a_quick_sweep_makes_everything_and_goes_on(tmp_path, capsys):
    import measure_tradeoff

    from sira_assets.plan.figures import read_figures, write_figures

    out = tmp_path / "t"
    command = ["--quick", "--size", "48", "--out", str(out)]
    assert measure_tradeoff.main(command) == 0
    for name in ("index.html", "runs.csv", "figures.json"):
        assert (out / name).stat().st_size > 0
    page = (out / "index.html").read_text()
    assert page.count("<img ") == 2
    assert "http" not in page  # it loads nothing
    before = {p.name: p.stat().st_mtime_ns for p in (out / "runs").iterdir()}
    rows = list(csv.DictReader((out / "runs.csv").read_text().splitlines()))
    assert [r["knob"] for r in rows] == ["reference", "texture size", "geometry steps"]
    assert len(before) == 3
    assert float(rows[0]["face_mm"]) > 0
    assert float(rows[1]["bake cpu_s"]) > 0
    assert rows[2]["bake cpu_s"] == ""  # as in the reference: the knob does not reach it
    figures = read_figures(out / "figures.json")
    assert {c.name for c in figures.curves} == {"geometry steps", "texture size"}
    assert all(s.seconds > 0 for s in figures.reference)
    # A stopped sweep goes on: the run that is missing is made, the others are found.
    gone = next(p for p in (out / "runs").iterdir() if '"geometry steps"' in p.read_text())
    gone.unlink()
    capsys.readouterr()
    assert measure_tradeoff.main(command) == 0
    assert capsys.readouterr().out.count("(found)") == 2
    after = {p.name: p.stat().st_mtime_ns for p in (out / "runs").iterdir()}
    assert {n: t for n, t in after.items() if n != gone.name} == {n: t for n, t in before.items() if n != gone.name}
    assert set(after) == set(before)
    # A command for fewer knobs reports those alone, or all that is kept.
    fewer = [*command, "--knob", "texture size", "--quiet"]
    for options, knobs in (((), {"texture size"}), (("--all-runs",), {"geometry steps", "texture size"})):
        assert measure_tradeoff.main([*fewer, *options]) == 0
        assert {c.name for c in read_figures(out / "figures.json").curves} == knobs
    # The reference alone, found again, with another sweep's curves.
    curves = tmp_path / "curves.json"
    write_figures(figures, curves)
    assert measure_tradeoff.main([*command, "--curves", str(curves), "--quiet"]) == 0
    mixed = read_figures(out / "figures.json")
    assert mixed.reference == figures.reference
    assert (mixed.curves, mixed.spread) == (figures.curves, figures.spread)
    assert figures.made_by in mixed.made_by
    with pytest.raises(SystemExit, match="2"):
        measure_tradeoff.main([*command, "--curves", str(curves), "--knob", "triangles"])


def test_the_knee_is_of_the_curve_in_whatever_order_its_values_were_measured():
    from _tradeoff_report import knob_section

    from sira_assets.plan.knobs import knob

    steps = knob("geometry steps")
    made = {0.06: (0.6, 1.0), 0.25: (0.7, 0.1), 0.5: (0.8, 0.08), 1.0: (1.0, 0.0), 2.0: (2.0, -0.01)}
    for order in (sorted(made), [2.0, 0.06, 1.0, 0.25, 0.5]):
        rows = [Setting("geometry steps", v, made[v][0], 1.0, {}, {"face_mm": made[v][1]}, {}, 1, 2) for v in order]
        for row in rows:
            row.spread["face_mm"] = 0.01
        section = knob_section(steps, rows, {}, 1.0)
        assert section.say.startswith("Knee: 0.25.")
        assert [row[0] for row in section.rows] == ["0.06", "0.25", "0.5", "1", "2"]
        assert len(section.figure.axes) == 1


def test_settings_measured_to_different_ends_share_a_table():
    from _tradeoff_report import plot, settings_table

    whole = Setting("k", 1, 1.0, 1.0, {}, {"face_mm": 0.0, "asset_mm": 0.0}, {"face_mm": 0.1, "asset_mm": 0.2}, 1, 2)
    short = Setting("k", 2, 0.5, 0.5, {}, {"face_mm": 0.3}, {"face_mm": float("nan")}, 1, 1)
    for rows in ([whole, short], [short, whole]):  # their order is that of their costs, so of the machine's whims
        head, table = settings_table(rows)
        column = head.index("asset_mm")
        assert {row[0]: row[column] for row in table} == {"1": "+0 ± 0.2", "2": "–"}
        assert [a.get_title().split(":")[0] for a in plot(rows, {}).axes] == ["face_mm"]
