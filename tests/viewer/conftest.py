"""A browser for all tests of this folder, and a page of two balls, of which the small one shades the large one."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, chromium

sys.path.append(str(Path(__file__).resolve().parents[1] / "asset"))

from sample_avatar import WORLD_FROM_CANONICAL, avatar_of, smooth_maps, sphere

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.gltf import write_glb
from sira_assets.measure.report import Picture, Report
from sira_assets.measure.report_page import write_report_html
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.texture.atlas import Atlas
from sira_assets.viewer.scene import viewer_scene

WIDTH, HEIGHT = 144, 112
# Low, and the view with it: a browser without a graphics card takes a second for a million pixels.
WINDOW = 900, 360


def two_balls() -> Avatar:
    """The sample head with a nose of 4 cm before it; both wear the same maps. Its camera has a shifted, oblong lens."""
    sample = avatar_of(smooth_maps(256))
    mesh, atlas = sphere(36, 64)
    small = 0.35 * mesh.vertices + np.array([0.02, 0.03, 0.125])
    both = TriangleMesh(
        np.vstack([mesh.vertices, small]),
        np.vstack([mesh.faces, mesh.faces + len(mesh.vertices)]),
        np.vstack([mesh.normals, mesh.normals]),
    )
    # From the side that the sharper lobe leaves in shadow, a little above, in the sample's turned world.
    eye = np.array([-0.3, 0.1, 0.6])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    pose[:3, 3] = eye
    pose = WORLD_FROM_CANONICAL @ pose
    pose[:3, :3] /= 1.3
    lens = np.array([[290.0, 0, 66.0], [0, 280.0, 60.0], [0, 0, 1]])
    return dataclasses.replace(
        sample,
        mesh=both.transformed(WORLD_FROM_CANONICAL),
        atlas=Atlas(
            np.vstack([atlas.uv, atlas.uv]), np.vstack([atlas.faces_uv, atlas.faces_uv + len(atlas.uv)]), atlas.report
        ),
        camera=Camera(lens, pose, WIDTH, HEIGHT),
    )


@pytest.fixture(scope="session")
def glb(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "avatar.glb"
    write_glb(two_balls(), path)
    return path


@pytest.fixture(scope="session")
def report_page(glb) -> Path:
    """report.html with a photo and the two balls."""
    photo = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    picture = Picture("photo", "the input", photo)
    page = glb.with_name("report.html")
    write_report_html(Report(title="two balls", photo=picture, render=picture, viewer=viewer_scene(glb)), page)
    return page


@pytest.fixture(scope="session")
def other_form(tmp_path_factory) -> Path:
    """The same avatar with integer vertices, specular as a factor and JPEG textures, and its page beside it."""
    path = tmp_path_factory.mktemp("other_form") / "avatar.glb"
    write_glb(two_balls(), path, ExportConfig(specular_form="factor", quantise=True, jpeg_quality=95))
    write_report_html(Report(title="two balls", viewer=viewer_scene(path)), path.with_name("report.html"))
    return path


@pytest.fixture(scope="session")
def any_browser(tmp_path_factory):
    if chromium() is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    with Browser(tmp_path_factory.mktemp("browser")) as browser:
        yield browser


@pytest.fixture(scope="session")
def opened(any_browser, report_page) -> tuple[Browser, list[str], list[str]]:
    """The page, ready; what the console said and what was loaded on the way."""
    any_browser.size(*WINDOW)
    any_browser.open(report_page)
    any_browser.wait("document.querySelector('.viewer').matches('.ready, .still')")
    return any_browser, list(any_browser.console), list(any_browser.requests)


@pytest.fixture
def page(opened) -> Browser:
    """The page in a window of its first size, seen from the photo's camera."""
    opened[0].size(*WINDOW)
    opened[0].js("document.querySelector('.viewer').view.orbit.reset()")
    return opened[0]
