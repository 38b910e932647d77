import base64
import io
import json
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from sira_assets.measure.curve_svg import curve_svg, nice_ticks, running_median
from sira_assets.measure.report import Curve, Decision, Metric, Picture, Report, json_value, report_dict
from sira_assets.measure.report_page import MAX_PICTURE_PIXELS, data_uri, report_html, write_report_html

VOID = {"meta", "img", "input", "br", "link", "hr"}
SVG_VOID = {"line", "polyline", "circle"}


class Balanced(HTMLParser):
    """Checks that every element that opens also closes, in order, and collects what the page would load."""

    def __init__(self):
        super().__init__()
        self.open, self.sources, self.tags = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.sources += [value for name, value in attributes if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def picture(name="photo", size=(6, 9)):
    return Picture(name, "as <seen>", np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8))


@pytest.fixture
def report():
    return Report(
        title="A & B <head>",
        subtitle="standard",
        photo=picture(),
        render=picture("avatar"),
        maps=(picture("Normals"), Picture("Specular", "ks", np.zeros((4, 4), np.uint8))),
        curves=(Curve("loss", tuple((float(k), math.exp(-k / 20)) for k in range(200))),),
        metrics=(
            Metric("psnr", "final", 31.256, "dB", headline=True),
            Metric("none", "no truth", None),
            Metric("same", "equal", math.inf, "dB"),
            Metric("triangles", "triangles", 24812.0, digits=0),
        ),
        decisions=(Decision("lobes", "4", "a fifth gains <1 %"),),
        warnings=("focal length assumed",),
        settings=(("quality", "standard"), ("size", np.int64(1024))),
        seconds=(("fit", 100.0), ("bake", 25.0)),
        peak_memory_bytes=3 << 30,
        version="0.1.0",
        seed=0,
    )


def parse(page: str) -> Balanced:
    parser = Balanced()
    parser.feed(page)
    parser.close()
    assert not parser.open
    return parser


def test_the_page_is_well_formed_and_loads_nothing(report, tmp_path):
    write_report_html(report, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    parser = parse(page)
    assert parser.tags.count("img") == 5  # four pictures and the enlarged one
    assert all(source == "#" or source.startswith("data:image/png;base64,") for source in parser.sources)
    assert not re.search(r"https?://|@import|url\(", page)


def test_what_the_user_named_is_text_not_markup(report):
    page = report_html(report)
    assert "A &amp; B &lt;head&gt;" in page
    assert "<head>" in page  # the page's own
    assert "<seen>" not in page
    assert "gains &lt;1 %" in page


def test_figures_are_shown_as_measured(report):
    page = report_html(report)
    assert ">31.26<small>dB</small>" in page
    assert "∞ dB" in page
    assert "24\u202f812" in page
    assert "2<small>min</small> 5<small>s</small>" in page
    assert "3.0<small>GiB</small>" in page


def test_an_empty_report_is_still_a_page():
    page = report_html(Report(title="empty"))
    parse(page)
    assert "Measurements" not in page
    assert "Convergence" not in page


def test_a_photo_without_a_render_is_shown_alone(report):
    page = report_html(Report(title="x", photo=picture()))
    assert parse(page).tags.count("img") == 2
    assert 'type="range"' not in page


def test_pictures_survive_and_large_ones_are_reduced():
    small = picture(size=(5, 7))
    data = base64.b64decode(data_uri(small).split(",")[1])
    assert (np.array(Image.open(io.BytesIO(data))) == small.pixels).all()
    large = Picture("large", "", np.full((10, MAX_PICTURE_PIXELS * 2), 77, np.uint8))
    pixels = np.array(Image.open(io.BytesIO(base64.b64decode(data_uri(large).split(",")[1]))))
    assert pixels.shape == (5, MAX_PICTURE_PIXELS)
    assert (pixels == 77).all()


@pytest.mark.parametrize("bad", [np.zeros((4, 4, 3)), np.zeros((4, 4, 4), np.uint8), np.zeros((0, 4), np.uint8)])
def test_pictures_of_another_kind_are_refused(bad):
    with pytest.raises(ValueError, match="expected uint8"):
        Picture("x", "", bad)


def test_report_json_has_the_promised_keys_and_no_nan(report):
    text = json.dumps(report_dict(report), allow_nan=False)
    data = json.loads(text)
    promised = {"seconds", "peak_memory", "metrics", "decisions", "settings", "version", "seed", "metres_per_unit"}
    assert promised <= set(data)
    assert data["seconds"] == {"fit": 100.0, "bake": 25.0}
    assert data["metrics"] == {"psnr": 31.256, "none": None, "same": "inf", "triangles": 24812.0}
    assert data["decisions"] == [{"what": "lobes", "chosen": "4", "evidence": "a fifth gains <1 %"}]
    assert data["settings"] == {"quality": "standard", "size": 1024}


def test_values_become_what_json_can_say():
    assert json_value(float("nan")) is None
    assert json_value(-math.inf) == "-inf"
    assert json_value(np.float32(0.5)) == 0.5
    assert json_value((np.bool_(True), np.arange(2))) == [True, [0, 1]]


@pytest.mark.parametrize(
    "values",
    [[1.0], [0.0, 0.0], [5.0, 5.0, 5.0], [1e-12, 1e12], [-3.0, 4.0], [1.0, math.nan, 2.0], [1e-320, 1.0]],
)
def test_any_curve_can_be_drawn_inside_its_frame(values):
    svg = curve_svg(Curve("c", tuple(enumerate(map(float, values)))))
    assert "nan" not in svg
    points = [tuple(map(float, p.split(","))) for p in re.search(r'class="line" points="([^"]*)"', svg)[1].split()]
    assert all(0 <= x <= 400 and 0 <= y <= 210 for x, y in points)
    parse(re.sub(rf"<({'|'.join(SVG_VOID)})([^>]*)/>", "", svg))


def test_a_curve_without_values_says_so():
    assert "no finite value" in curve_svg(Curve("c", ((0.0, math.nan),)))


def test_a_log_axis_is_used_where_a_curve_spans_much():
    assert "log scale" in curve_svg(Curve("c", ((0.0, 1.0), (1.0, 1e-3))))
    assert "log scale" not in curve_svg(Curve("c", ((0.0, 1.0), (1.0, 0.5))))
    assert "log scale" not in curve_svg(Curve("c", ((0.0, 1.0), (1.0, 0.0))))


@pytest.mark.parametrize(("low", "high"), [(0, 1), (0, 599), (-3.2, 7.9), (0.013, 0.048), (1e-9, 3e-9), (2, 2)])
def test_ticks_are_round_inside_and_few(low, high):
    ticks = nice_ticks(low, high, 5)
    assert 1 <= len(ticks) <= 8
    step = ticks[1] - ticks[0] if len(ticks) > 1 else 1.0
    # A step of 1, 2 or 5 times a power of ten; ticks within rounding of the range.
    assert round(step / 10 ** math.floor(math.log10(step) + 1e-9), 6) in (1, 2, 5) or low == high
    assert min(ticks) >= low - 1e-9 * step
    assert max(ticks) <= high + 1e-9 * step


def test_the_running_median_ignores_single_spikes_and_keeps_the_length():
    y = np.full(400, 2.0)
    y[[7, 200, 399]] = 1e6
    assert (running_median(y) == 2.0).all()
    assert len(running_median(y)) == 400
