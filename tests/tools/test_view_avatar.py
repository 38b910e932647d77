"""tools/view_avatar.py: the contract of its command line."""

import json
import sys
from pathlib import Path

import pytest
from PIL import Image

from sira_assets.asset.gltf import write_glb

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "asset"))
sys.path.append(str(ROOT / "tools"))
import view_avatar  # noqa: E402
from sample_avatar import avatar_of, flat_maps  # noqa: E402


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("avatars") / "me"
    write_glb(avatar_of(flat_maps()), folder / "avatar.glb")
    return folder


def test_a_page_of_a_folder_and_of_a_file(folder, tmp_path, capsys):
    out = tmp_path / "view.html"
    assert view_avatar.main([str(folder), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"page": str(out), "bytes": out.stat().st_size, "shadows": True}
    page = out.read_text(encoding="utf-8")
    assert "<title>me</title>" in page
    assert 'data-part="glb"' in page
    again = ["--out", str(out), "--overwrite", "--no-shadows", "--title", "A & B"]
    assert view_avatar.main([str(folder / "avatar.glb"), *again]) == 0
    page = out.read_text(encoding="utf-8")
    assert "<title>A &amp; B</title>" in page
    assert 'data-part="shadows-data"' not in page


def test_the_photo_comes_from_the_folder(folder, tmp_path):
    (folder / "renders").mkdir()
    Image.new("RGB", (8, 8), (10, 20, 30)).save(folder / "renders" / "input.png")
    assert view_avatar.main([str(folder), "--out", str(tmp_path / "view.html")]) == 0
    assert '<img id="photo" src="data:image/png' in (tmp_path / "view.html").read_text(encoding="utf-8")


def test_mistakes_are_one_line_and_3(folder, tmp_path, capsys):
    taken = tmp_path / "taken.html"
    taken.write_text("mine")
    mistakes = (
        [folder, "--out", taken],
        [folder, "--out", taken / "a.html"],
        [folder, "--out", tmp_path, "--overwrite"],
        [tmp_path / "none", "--out", tmp_path / "a.html"],
    )
    for arguments in mistakes:
        assert view_avatar.main([*map(str, arguments)]) == 3
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert taken.read_text() == "mine"
