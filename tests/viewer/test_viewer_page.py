"""What the 3D view's part of the page is made of."""

import base64
import dataclasses
import gzip
import hashlib
import json
import re
from importlib.resources import files

import numpy as np
import pytest
from two_balls import two_balls

from sira_assets.asset.gltf import write_glb
from sira_assets.errors import InputError
from sira_assets.scene.sg_light import SGLight
from sira_assets.viewer.page import viewer_html
from sira_assets.viewer.scene import MAX_SHADED_LOBES, viewer_scene


def test_the_script_is_built_from_the_sources_beside_it():
    room = files("sira_assets.viewer")
    digest = hashlib.sha256()
    for path in sorted((room / "source").iterdir(), key=lambda p: p.name):
        if path.name.endswith(".js") or path.name == "package.json":
            digest.update(path.read_bytes())
    first = (room / "viewer.min.js").read_text(encoding="utf-8").splitlines()[0]
    assert f"sources {digest.hexdigest()}." in first, "run `npm ci && npm run build` in sira_assets/viewer/source"
    version = json.loads((room / "source" / "package.json").read_text(encoding="utf-8"))["dependencies"]["three"]
    assert f"three.js {version}," in first
    assert "MIT License" in (room / "LICENSE-three.txt").read_text(encoding="utf-8")


def test_the_page_carries_the_file_and_loads_nothing(glb):
    page = viewer_html(viewer_scene(glb), photo_id="photo")
    assert set(re.findall(r"https?://[^\"'`\s)]*", page)) <= {"http://www.w3.org/1999/xhtml"}
    assert not re.search(r"@import|<link|\ssrc=\"(?!data:)", page.split("<script>")[0])
    text = re.search(r'data-part="glb">([^<]*)<', page)[1]
    assert gzip.decompress(base64.b64decode(text)) == glb.read_bytes()


def test_the_same_file_gives_the_same_page(glb):
    assert viewer_html(viewer_scene(glb)) == viewer_html(viewer_scene(glb))


def test_names_are_text_not_markup(glb):
    scene = dataclasses.replace(viewer_scene(glb, shadows=False), name='</script><b>"x')
    page = viewer_html(scene)
    assert "</script><b>" not in page
    assert page.count("<script") == page.count("</script>")


def test_the_bits_are_what_the_vertices_see(glb):
    """No direction below a vertex's horizon, all above it where nothing stands before it."""
    from sira_assets.relight.glb_model import read_glb

    scene = viewer_scene(glb)
    normals = read_glb(glb).normals
    seen = np.unpackbits(scene.shadows.packed, axis=1).astype(bool)
    above = normals @ scene.shadows.directions.T > 0
    assert not (seen & ~above).any()
    share = (seen & above).sum(1) / above.sum(1)
    assert (share == 1).mean() > 0.3  # the far halves of two balls
    assert share.min() < 0.5  # where they meet


def test_a_file_without_a_camera_is_framed_and_shows_no_photo(tmp_path):
    write_glb(dataclasses.replace(two_balls(), camera=None), tmp_path / "a.glb")
    scene = viewer_scene(tmp_path / "a.glb", shadows=False)
    assert not scene.is_photos
    page = viewer_html(scene, photo_id="photo")
    assert 'data-part="photo" data-from="photo" hidden' in page
    assert "First camera" in page


def test_more_lobes_than_a_browser_passes_on_leave_shadows_out(tmp_path):
    count = MAX_SHADED_LOBES + 1
    many = SGLight(np.tile([[0.0, 0, 1]], (count, 1)), np.full(count, 5.0), np.ones((count, 3)))
    write_glb(dataclasses.replace(two_balls(), light=many), tmp_path / "a.glb")
    assert viewer_scene(tmp_path / "a.glb").shadows is None


def test_a_file_without_light_is_refused(tmp_path, glb):
    (tmp_path / "a.glb").write_bytes(glb.read_bytes().replace(b'"light"', b'"sight"'))
    with pytest.raises(InputError, match="light"):
        viewer_scene(tmp_path / "a.glb")
