"""The 3D view in a real browser, opened from disk: what it shows is what other readers of the same file see."""

import base64
import io
import json

import numpy as np
import pytest
from browser import Browser
from PIL import Image
from two_balls import HEIGHT, WIDTH

from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.relight.asset_view import view_asset
from sira_assets.relight.cameras import portrait_camera, rotation_about, up_axis
from sira_assets.relight.glb_model import read_glb
from sira_assets.relight.light_source import own_light
from sira_assets.relight.render import light_asset, see_asset, visibility_of

# A browser without a graphics card starts and draws in seconds.
pytestmark = pytest.mark.slow

VIEW = "document.querySelector('.viewer').view"
MAPS = ("final", "diffuse", "specular", "normals", "light")


def snapshot(page, name="final", *, azimuth=0.0, shaded=True) -> np.ndarray:
    """(H, W, 4) in [0, 1], premultiplied, at the photo's camera and size."""
    state = f"v.azimuth = {np.radians(azimuth)}; v.shaded = {json.dumps(shaded)}; v.light(); v.show('{name}')"
    url = page.js(f"(() => {{ const v = {VIEW}; {state}; return v.snapshot({WIDTH}, {HEIGHT}); }})()")
    picture = Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGBA")
    pixels = np.asarray(picture, np.float64) / 255
    return np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], -1)


def psnr(a, b, mask) -> float:
    return float(-10 * np.log10(((a - b)[mask] ** 2).mean()))


def smooth(seen) -> np.ndarray:
    """(H, W) pixels whose samples all meet one surface and one chart of the sample's maps, which jump at their seam.

    A browser mixes the samples of an edge after encoding, the reference before.
    """
    k, camera = seen.supersample, seen.camera
    depth = np.linalg.norm(seen.surface.points - camera.world_from_camera[:3, 3], axis=1)
    whole = np.ones((camera.height, camera.width), bool)
    for values, step in ((depth, 0.02), (seen.surface.diffuse[:, 0], 0.1)):
        grid = np.full(camera.height * k * camera.width * k, np.inf)
        grid[seen.index] = values
        grid = grid.reshape(camera.height, k, camera.width, k)
        whole &= grid.max((1, 3)) < grid.min((1, 3)) + step
    return whole


def test_it_opens_from_disk_without_error_or_request(page, opened, report_page):
    _, console, requests = opened
    assert console == []
    assert {url.split(":")[0] for url in requests} <= {"file", "data", "blob"}
    assert [url for url in requests if url.startswith("file:")] == [report_page.resolve().as_uri()]
    picture = snapshot(page)
    assert 0.2 < (picture[..., 3] > 0.5).mean() < 0.8  # the balls, and what is behind them
    assert np.ptp(picture[picture[..., 3] == 1][:, :3]) > 0.2


def test_switches_and_sliders_change_what_they_name(page):
    def seen() -> np.ndarray:
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(page.js(f"{VIEW}.snapshot(72, 56)").split(",")[1]))))

    def do(part: str, change: str, event: str = "input") -> None:
        page.js(
            f"""new Promise((done) => {{ const x = document.querySelector('{part}'); {change};
            x.dispatchEvent(new Event('{event}'));
            requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done))); }})"""
        )

    pictures = {}
    for name in MAPS:
        do(f"[data-map][value={name}]", "x.checked = true", "change")
        pictures[name] = seen().astype(int)
    for a in MAPS:
        for b in MAPS:
            assert a == b or np.abs(pictures[a] - pictures[b]).mean() > 2, (a, b)
    before = seen().astype(int)  # the light alone
    do("[data-part=azimuth]", "x.value = 90")
    assert np.abs(seen() - before).mean() > 2
    do("[data-part=relight-reset]", "x.click()", "none")
    assert (seen() == before).all()
    do("[data-part=exposure]", "x.value = 1")
    assert seen().astype(int).sum() > before.sum()
    do("[data-part=relight-reset]", "x.click()", "none")
    do("[data-part=shadows]", "x.checked = false", "change")
    assert seen()[..., :3].astype(int).sum() > before[..., :3].sum()
    do("[data-map][value=diffuse]", "x.checked = true", "change")
    before = seen()
    do("[data-part=azimuth]", "x.value = 90")
    assert (seen() == before).all()  # albedo knows no light


@pytest.mark.parametrize(("azimuth", "shaded"), [(0.0, False), (0.0, True), (70.0, True)])
def test_the_final_picture_is_what_relight_renders(page, glb, azimuth, shaded):
    model = read_glb(glb)
    light = own_light(model).rotated(rotation_about(up_axis(model), azimuth))
    seen = see_asset(model, portrait_camera(model)[0], supersample=4)
    visibility = visibility_of(seen, light, rays=256) if shaded else None
    reference = light_asset(seen, light, visibility=visibility)
    expected = srgb_from_linear(np.clip(reference.radiance, 0, 1))
    view, inside = snapshot(page, azimuth=azimuth, shaded=shaded), smooth(seen)
    found = psnr(view[..., :3], expected, inside)
    print(f"azimuth {azimuth}, shadows {shaded}: {found:.1f} dB over {inside.sum()} pixels")
    # Eight bits alone leave 59 dB; shadows are linear between vertices, and the reference's rays are few.
    assert found > (44 if shaded else 55)
    assert np.abs(view[..., 3] - reference.alpha).mean() < 0.005  # silhouettes agree
    if shaded:
        dark = inside & (reference.visibility < 0.6)
        assert dark.sum() > 100
        without = snapshot(page, azimuth=azimuth, shaded=False)
        assert psnr(without[..., :3], expected, dark) < 25 < 35 < psnr(view[..., :3], expected, dark)


def test_maps_and_orientation_are_those_of_other_readers(page, glb):
    import trimesh

    model = read_glb(glb)
    camera = portrait_camera(model)[0]
    other = view_asset(model, camera)
    inside = smooth(see_asset(model, camera, supersample=4))
    diffuse = srgb_from_linear(other.diffuse)
    assert psnr(snapshot(page, "diffuse")[..., :3], diffuse, inside) > 50
    normals = other.mapped_normal_world @ camera.camera_from_world[:3, :3].T * np.array([1.0, -1.0, -1.0])
    assert psnr(snapshot(page, "normals")[..., :3], 0.5 + 0.5 * normals, inside) > 45  # a mirrored axis gives some 10
    specular = np.repeat(other.specular_ks[..., None] / 2, 3, -1)
    assert psnr(snapshot(page, "specular")[..., :3], specular, inside) > 50

    mesh = trimesh.load(glb, process=False).to_geometry()
    box = page.js(
        f"""(() => {{ const v = {VIEW}, low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9]; let count = 0, faces = 0;
        for (const m of v.meshes) {{ const p = m.geometry.getAttribute('position'), e = m.matrixWorld;
          faces += m.geometry.index.count / 3; count += p.count;
          for (let i = 0; i < p.count; i++) {{
            const x = m.position.clone().fromBufferAttribute(p, i).applyMatrix4(e).toArray();
            x.forEach((a, k) => {{ low[k] = Math.min(low[k], a); high[k] = Math.max(high[k], a); }}); }} }}
        const u = v.meshes[0].material.uniforms, size = (t) => [t.value.image.width, t.value.image.height];
        return {{ low, high, count, faces, sizes: [size(u.base_map), size(u.normal_map)] }}; }})()"""
    )
    # Both read the same float32 positions.
    np.testing.assert_allclose([box["low"], box["high"]], mesh.bounds, rtol=0, atol=1e-6)
    assert (box["count"], box["faces"]) == (len(mesh.vertices), len(mesh.faces))
    material = mesh.visual.material
    assert box["sizes"] == [list(material.baseColorTexture.size), list(material.normalTexture.size)]


def test_shares_of_a_turned_light_are_the_tables_own(page, glb):
    import torch

    from sira_assets.relight.surface import mesh_of
    from sira_assets.render.visibility_table import VisibilityTable, even_directions
    from sira_assets.viewer.scene import viewer_scene

    model = read_glb(glb)
    light = own_light(model).rotated(rotation_about(up_axis(model), 70.0))
    bits = viewer_scene(glb).shadows
    normals = torch.as_tensor(np.array(mesh_of(model).normals), dtype=torch.float32)
    table = VisibilityTable(even_directions(len(bits.directions)), normals, torch.as_tensor(bits.packed))
    axis, sharpness = (torch.as_tensor(np.array(a), dtype=torch.float32) for a in (light.axis, light.sharpness))
    expected = table.share(torch.arange(len(normals)), axis, sharpness).numpy()
    axes, sharp = json.dumps(light.axis.tolist()), json.dumps(light.sharpness.tolist())
    found = np.array(page.js(f"{VIEW}.shadows.shares({axes}, {sharp}).map((a) => [...a])"))
    found = found.reshape(-1, len(normals), 4).transpose(1, 0, 2).reshape(len(normals), -1)[:, : len(light)]
    # Where a lobe gives a vertex less than a thousandth of its head-on light, the ratio is of single precision's dregs.
    lit = (normals @ axis.T).numpy() > -0.3
    np.testing.assert_allclose(found[lit], expected[lit], atol=2e-3)
    assert expected[lit].min() < 0.3


def test_the_photo_lies_over_its_own_camera_alone(page):
    page.js("document.querySelector('[data-part=canvas]').focus()")
    at = lambda: page.js(f"{VIEW}.orbit.atPhoto")  # noqa: E731
    disabled = "document.querySelector('[data-part=cut]').disabled"
    photo = "getComputedStyle(document.querySelector('.viewer .photo')).visibility"
    assert at()
    assert not page.js(disabled)
    assert page.js("document.querySelector('.viewer .photo').naturalWidth") == WIDTH
    first = snapshot(page, "normals")
    page.key("ArrowRight", 39)
    page.wait(disabled)
    assert not at()
    assert page.js(photo) == "hidden"
    assert np.abs(snapshot(page, "normals") - first).mean() > 0.005
    page.key("Home", 36)
    page.wait(f"!{disabled}")
    assert at()
    assert page.js(photo) == "visible"
    assert (snapshot(page, "normals") == first).all()
    x, y = page.js("(({x, y}) => [x, y])(document.querySelector('.viewer canvas').getBoundingClientRect())")
    page.drag(x + 60, y + 100, 60, 0)
    page.wait(disabled)
    page.js("document.querySelector('[data-part=reset]').click()")
    page.wait(f"!{disabled}")
    assert at()


def test_turning_keeps_the_distance_and_stops_at_the_poles(page):
    place = f"""(() => {{ const o = {VIEW}.orbit, e = o.eye.sub(o.pivot);
        return [e.length(), e.normalize().dot(o.up)]; }})()"""
    before, _ = page.js(place)
    page.js(f"for (let i = 0; i < 40; i++) {VIEW}.orbit.orbit(0.3, 0.2)")
    after, height = page.js(place)
    assert after == pytest.approx(before, rel=1e-9)  # double precision, forty turns
    assert height == pytest.approx(np.sin(np.radians(85)), abs=1e-6)
    page.js(f"for (let i = 0; i < 40; i++) {VIEW}.orbit.zoom(1.5)")
    assert page.js(place)[0] == pytest.approx(0.15 * before, rel=1e-6)
    page.js(f"{VIEW}.orbit.reset()")
    assert page.js(f"{VIEW}.orbit.atPhoto")


def test_filling_the_view_centres_the_avatar(page):
    page.js(f"{VIEW}.orbit.orbit(0.5, 0.2); {VIEW}.orbit.pan(0.3, 0.1); {VIEW}.orbit.frame()")
    seen = snapshot(page, "normals")[..., 3] > 0.5
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    assert rows[0] > 0
    assert rows[-1] < HEIGHT - 1
    assert 0.6 * HEIGHT < max(np.ptp(rows), np.ptp(columns)) < HEIGHT  # the shorter side, nearly filled
    # The sphere about the middle of the box is centred; its balls fill it unevenly.
    assert abs(rows.mean() - HEIGHT / 2) < 0.15 * HEIGHT
    assert abs(columns.mean() - WIDTH / 2) < 0.15 * WIDTH


def test_the_light_map_is_the_irradiance(page, glb):
    import torch

    from sira_assets.numerics.sg import irradiance
    from sira_assets.viewer.scene import viewer_scene

    model = read_glb(glb)
    seen = see_asset(model, portrait_camera(model)[0], supersample=4)
    light = own_light(model)
    parts = (seen.normals, light.axis, light.sharpness, light.amplitude)
    received = irradiance(*(torch.as_tensor(np.array(a), dtype=torch.float32) for a in parts)).numpy()
    expected = srgb_from_linear(np.clip(seen.picture(received) / viewer_scene(glb).brightest, 0, 1))
    assert psnr(snapshot(page, "light", shaded=False)[..., :3], expected, smooth(seen)) > 55


def test_a_narrow_screen_needs_no_sideways_scrolling(page):
    page.size(400, 800, scale=2)
    page.js("new Promise((done) => setTimeout(done, 100))")
    assert page.js("document.documentElement.scrollWidth") == 400
    canvas = page.js("document.querySelector('.viewer canvas').getBoundingClientRect().width")
    assert 300 < canvas <= 400
    assert page.js("document.querySelector('.viewer canvas').width") == pytest.approx(2 * canvas, abs=1)


def test_other_forms_of_the_file_are_read_as_well(any_browser, other_form):
    """Last of those that share the browser, since it opens another page."""
    any_browser.open(other_form.with_name("report.html"))
    any_browser.wait("document.querySelector('.viewer').matches('.ready, .still')")
    model = read_glb(other_form)
    seen = see_asset(model, portrait_camera(model)[0], supersample=4)
    expected = srgb_from_linear(np.clip(light_asset(seen, own_light(model)).radiance, 0, 1))
    found = psnr(snapshot(any_browser, shaded=False)[..., :3], expected, smooth(seen))
    print(f"integer vertices, factor form, JPEG: {found:.1f} dB")
    assert found > 55
    assert any_browser.js(f"{VIEW}.canShade")


def test_without_webgl_the_page_says_so_in_one_line(any_browser, report_page, tmp_path):
    with Browser(tmp_path / "other", "--disable-3d-apis") as browser:
        browser.open(report_page)
        browser.wait("document.querySelector('.viewer').matches('.ready, .still')")
        assert browser.console == []
        said = browser.js("document.querySelector('.viewer').innerText.trim()")
        assert said.startswith("No 3D view: ")
        assert "\n" not in said
        assert browser.js("document.querySelectorAll('.compare img').length") == 2  # the stills are there
