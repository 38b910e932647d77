"""A browser for all tests of this folder, and the page of two balls."""

from pathlib import Path

import numpy as np
import pytest
from browser import Browser, chromium
from two_balls import HEIGHT, WIDTH, two_balls

from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.gltf import write_glb
from sira_assets.measure.report import Picture, Report
from sira_assets.measure.report_page import write_report_html
from sira_assets.viewer.scene import viewer_scene

# Low, and the view with it: a browser without a graphics card takes a second for a million pixels.
WINDOW = 900, 360


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
