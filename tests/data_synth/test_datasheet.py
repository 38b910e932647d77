"""The datasheet says what the scenes hold, and only that."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from data_synth.datasheet import Distribution, distribution, tally, typology_angle, write_datasheet
from data_synth.datasheet_page import figure_html, histogram_svg


def test_a_distribution_has_the_values_moments_and_all_of_them_in_its_bins():
    values = np.random.default_rng(0).normal(3.0, 2.0, 500)
    found = distribution("x", "mm", [*values.tolist(), float("nan")])
    assert found.count == sum(found.counts) == 500
    # Six digits are kept.
    assert [found.mean, found.std, found.least, found.median, found.most] == pytest.approx(
        [values.mean(), values.std(), values.min(), np.median(values), values.max()], rel=1e-5
    )
    assert len(found.edges) == len(found.counts) + 1
    assert distribution("x", "", [2.0, 2.0]).counts == (2,)
    assert distribution("x", "", []).count == 0


def test_a_tally_is_sorted_by_count_then_name():
    assert tally("t", ["b", "a", "c", "c"]).counts == (("c", 2), ("a", 1), ("b", 1))


def test_typology_angle_at_known_colours():
    # A grey has b* = 0: 90 degrees when lighter than L* = 50, -90 when darker. L* = 50 is a luminance of 0.1842.
    assert typology_angle(np.full(3, 0.5)) == pytest.approx(90.0, abs=0.1)  # the matrix has four digits
    assert typology_angle(np.full(3, 0.05)) == pytest.approx(-90.0, abs=0.1)
    light, dark = np.array([0.55, 0.36, 0.27]), np.array([0.08, 0.045, 0.03])
    assert typology_angle(light) > 41
    assert typology_angle(dark) < -30


def test_bars_are_as_high_as_their_counts_and_stay_inside():
    figure = distribution("x <&> y", "", [0.0, 0.0, 1.0])
    bars = ElementTree.fromstring(histogram_svg(figure)).findall("rect")
    heights = [float(bar.get("height")) for bar in bars]
    assert heights[0] == pytest.approx(2 * heights[-1], abs=0.1)  # one decimal is written
    assert sum(h > 0 for h in heights) == 2
    assert all(float(bar.get("x")) + float(bar.get("width")) <= 260 for bar in bars)
    assert "x &lt;&amp;&gt; y" in figure_html(figure)


def scene_on_disk(folder, name, *, yaw_deg, rig, hair):
    from PIL import Image

    from sira_assets.scene.image import write_exr

    (folder / name / "gt").mkdir(parents=True)
    (folder / name / "images").mkdir()
    (folder / name / "masks").mkdir()
    pixels = np.full((20, 20, 3), 188, np.uint8)
    Image.fromarray(pixels).save(folder / name / "images" / "000.png")
    Image.fromarray(np.full((20, 20), 255, np.uint8)).save(folder / name / "masks" / "000.png")
    yaw = np.radians(yaw_deg)
    pose = np.eye(4)  # OpenGL: looks along its own -Z
    pose[:3, :3] = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    pose[:3, 3] = 2.0 * pose[:3, 2]
    frame = {"file_path": "images/000.png", "mask_path": "masks/000.png", "transform_matrix": pose.tolist()}
    intrinsics = {"fl_x": 40.0, "fl_y": 40.0, "cx": 10.0, "cy": 10.0, "w": 20, "h": 20}
    canonical = np.diag([0.5, 0.5, 0.5, 1.0]).tolist()
    write = {
        "transforms.json": {**intrinsics, "frames": [frame], "canonical_from_world": canonical},
        "gt/provenance.json": {"rig": rig, "head": {"seed": 3, "hair_style": hair, "pigment": {"melanin": 0.1}}},
        "gt/lights.json": {"sgs": [{"axis": [0, 0, 1], "sharpness": 100.0, "amplitude": [1, 1, 1]}]},
        "gt/brdf.json": {"roughness": 0.4},
        "gt/landmarks.json": {"nose_tip": {"xyz_m": [0, 0, 0], "pixel": [10.0, 10.0], "visible": True}},
    }
    for path, data in write.items():
        (folder / name / path).write_text(json.dumps(data))
    write_exr(folder / name / "gt" / "albedo.exr", np.full((20, 20, 3), 0.5, np.float32))


def test_a_folder_is_described_from_its_scenes(tmp_path):
    scene_on_disk(tmp_path, "train_000001", yaw_deg=30.0, rig="studio", hair="bob")
    scene_on_disk(tmp_path, "train_000000", yaw_deg=-30.0, rig="window", hair="bob")
    (tmp_path / "train.json").write_text(json.dumps({"kind": "train", "seed": 7, "generator": "0"}))
    sheet = write_datasheet(tmp_path)
    assert (sheet.scenes, sheet.pictures) == (2, 2)
    found = {figure.name: figure for group in sheet.by_group.values() for figure in group}
    assert found["light rig"].counts == (("studio", 1), ("window", 1))
    assert found["hair_style"].counts == (("bob", 2),)
    assert found["melanin"].mean == 0.1
    assert "seed" not in found
    yaw = found["yaw of the portrait"]
    assert (yaw.least, yaw.most) == pytest.approx((-30.0, 30.0), rel=1e-4)
    # World metres, not canonical ones, of which a metre here has half.
    assert found["distance from the head"].mean == pytest.approx(2.0, rel=1e-5)
    assert found["focal length, 35 mm equivalent"].mean == pytest.approx(72.0)
    assert found["luminance of the portrait's head, sRGB-encoded"].mean == pytest.approx(188 / 255, abs=1e-4)
    written = json.loads((tmp_path / "datasheet.json").read_text())
    assert written["settings"]["train"]["seed"] == 7
    page = (tmp_path / "datasheet.html").read_text()
    assert "2 scenes" in page
    assert "<script" not in page
    assert "http" not in page
    before = page, (tmp_path / "datasheet.json").read_bytes()
    write_datasheet(tmp_path)
    assert before == ((tmp_path / "datasheet.html").read_text(), (tmp_path / "datasheet.json").read_bytes())
    assert isinstance(found["melanin"], Distribution)


def test_what_is_no_data_set_is_passed_over(tmp_path):
    scene_on_disk(tmp_path, "egg_000000", yaw_deg=0.0, rig="studio", hair="bob")
    scene_on_disk(tmp_path, ".egg_000001.x7.partial", yaw_deg=0.0, rig="studio", hair="bob")
    (tmp_path / "photo").mkdir()
    (tmp_path / "photo" / "transforms.json").write_text("{}")
    (tmp_path / "egg.json").write_text(json.dumps({"kind": "scan", "generator": "0"}))
    (tmp_path / "landmarks.json").write_text(json.dumps({"landmarks_m": {"nose_tip": [0, 0, 0]}}))
    (tmp_path / "list.json").write_text("[1, 2]")
    (tmp_path / "empty.json").touch()
    sheet = write_datasheet(tmp_path)
    assert sheet.scenes == 1
    assert list(sheet.settings) == ["egg"]
    page = (tmp_path / "datasheet.html").read_text()
    assert "the user of the generator brought" in page
    assert "no person" not in page
