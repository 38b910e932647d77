"""report.html: one self-contained page of a run; pictures as data, curves as SVG, no network.

Notation: a section is a heading and its HTML; sections without content are left out.
"""

import base64
import html
import io
import math
import string
from importlib.resources import files
from pathlib import Path

import numpy as np

from sira_assets.atomic import write_text
from sira_assets.measure.curve_svg import curve_svg, short
from sira_assets.measure.report import Metric, Picture, Report
from sira_assets.viewer.page import viewer_html

# A page shows pictures at most this wide; the full maps lie beside it as files.
MAX_PICTURE_PIXELS = 1024
# By which the 3D view finds the photo that lies over it.
PHOTO_ID = "photo"


def write_report_html(report: Report, path: str | Path) -> None:
    """Write the page, whole or not at all. It loads nothing: every picture, style and script is inside."""
    write_text(path, report_html(report))


def report_html(report: Report) -> str:
    """The page's text."""
    template = (files("sira_assets.measure") / "report_page.html").read_text(encoding="utf-8")
    sections = (
        ("3D view", _viewer(report)),
        ("Maps and renders", _gallery(report.maps)),
        ("Measurements", _metrics(report.metrics)),
        ("Decisions, and what they were made from", _decisions(report)),
        ("Convergence", _curves(report)),
        ("Time", _times(report)),
        ("Run", _run(report)),
    )
    return string.Template(template).substitute(
        title=_text(report.title),
        subtitle=_text(report.subtitle),
        top=_top(report),
        sections="\n".join(f"<section><h2>{_text(name)}</h2>{body}</section>" for name, body in sections if body),
        footer=_text(f"Made with sira_assets {report.version}. Use a person's likeness only with their consent."),
    )


def _text(value: object) -> str:
    return html.escape(str(value))


def _cards(report: Report) -> str:
    cards = [(f"{_figure(m)}<small>{_text(m.unit)}</small>", m.label) for m in report.metrics if m.headline]
    if report.seconds:
        cards.append((_duration(report.total_seconds), "total time"))
    if report.peak_memory_bytes:
        cards.append((f"{report.peak_memory_bytes / 2**30:.1f}<small>GiB</small>", "peak memory"))
    body = "".join(f'<div class="card"><b>{value}</b><span>{_text(label)}</span></div>' for value, label in cards)
    return f'<div class="cards">{body}</div>' if cards else ""


def _warnings(report: Report) -> str:
    items = "".join(f"<li>{_text(line)}</li>" for line in report.warnings)
    return f'<ul class="warnings" aria-label="Warnings">{items}</ul>' if items else ""


def _top(report: Report) -> str:
    """The comparison with the headline figures and warnings beside it."""
    hidden, compared = "", ""
    if report.photo and report.viewer and report.render is None:
        # The 3D view shows it.
        hidden = f'<img id="{PHOTO_ID}" src="{data_uri(report.photo)}" alt="" hidden>'
    else:
        compared = _compare(report.photo, report.render)
    columns = (compared, _cards(report) + _warnings(report))
    body = "\n".join(f"<div>{column}</div>" for column in columns if column)
    return hidden + (f'<div class="stage">{body}</div>' if body else "")


def _compare(before: Picture | None, after: Picture | None) -> str:
    """Photo and render under one slider; with one of the two missing, the other alone."""
    if before is None or after is None:
        alone = before or after
        return _figure_html(alone, PHOTO_ID if before else "") if alone else ""
    left, right = _text(before.name), _text(after.name)
    return f"""<div class="compare"><div class="inner"><img id="{PHOTO_ID}" src="{data_uri(before)}" alt="{left}">
<img class="after" src="{data_uri(after)}" alt="{right}"></div>
<div class="bar"></div><span class="tag left">{left}</span><span class="tag right">{right}</span>
<input type="range" min="0" max="100" step="0.5" value="50" aria-label="Where the two pictures meet"></div>
<div class="under"><span>{_text(after.caption or before.caption)}</span>
<button data-difference aria-pressed="false">Difference × 3</button></div>"""


def _viewer(report: Report) -> str:
    return "" if report.viewer is None else viewer_html(report.viewer, photo_id=PHOTO_ID if report.photo else None)


def _gallery(pictures: tuple[Picture, ...]) -> str:
    return f'<div class="gallery">{"".join(map(_figure_html, pictures))}</div>' if pictures else ""


def _figure_html(picture: Picture, named: str = "") -> str:
    uri, name, caption = data_uri(picture), _text(picture.name), _text(picture.caption)
    under = f"{name}: {caption}" if caption else name
    tag = f'id="{named}" ' if named else ""
    return (
        f'<figure><a href="#" data-caption="{under}"><img {tag}src="{uri}" alt="{name}"></a>'
        f"<figcaption><b>{name}</b>{caption}</figcaption></figure>"
    )


def _metrics(metrics: tuple[Metric, ...]) -> str:
    rows = [(m.label, f"{_figure(m)} {_text(m.unit)}", m.meaning) for m in metrics]
    return _table(("What", "Value", "How it was measured"), rows, ("name", "n", "say"), raw=(1,))


def _decisions(report: Report) -> str:
    rows = [(d.what, d.chosen, d.evidence) for d in report.decisions]
    return _table(("What", "Chosen", "Evidence"), rows, ("name", "", "say"))


def _curves(report: Report) -> str:
    plots = []
    for curve in report.curves:
        last = next((y for _, y in reversed(curve.points) if math.isfinite(y)), None)
        end = "" if last is None else f"ends at {short(last)}"
        plots.append(f'<div class="plot"><h3>{_text(curve.name)}<output>{end}</output></h3>{curve_svg(curve)}</div>')
    return f'<div class="curves">{"".join(plots)}</div>' if plots else ""


def _times(report: Report) -> str:
    longest = max((s for _, s in report.seconds), default=0.0) or 1.0
    rows = [
        (stage, f"{s:.1f} s" if s < 100 else f"{s:.0f} s", f'<i style="width:{100 * s / longest:.1f}%"></i>')
        for stage, s in report.seconds
    ]
    table = _table(("Stage", "Wall clock", ""), rows, ("name", "n", "bar"), raw=(2,))
    return table.replace("<table>", '<table class="times">') if rows else ""


def _run(report: Report) -> str:
    settings = [*report.settings, ("seed", report.seed), ("version", report.version)]
    settings += [("metres_per_unit", report.metres_per_unit)]
    settings = [(k, v) for k, v in settings if v not in (None, "")]
    body = f"<details><summary>Settings</summary>{_table(('Name', 'Value'), settings, ('name', ''))}</details>"
    if report.files:
        written = _table(("File", "What it is"), report.files, ("name", "say"))
        body += f"<details><summary>Files</summary>{written}</details>"
    return body


def _table(head, rows, classes: tuple[str, ...], raw: tuple[int, ...] = ()) -> str:
    """An HTML table; columns in `raw` hold HTML already. Empty without rows."""
    if not rows:
        return ""

    def cell(k: int, value: object) -> str:
        return f'<td class="{classes[k]}">{value if k in raw else _text(value)}</td>'

    top = "".join(f'<th class="{"n" if classes[k] == "n" else ""}">{_text(name)}</th>' for k, name in enumerate(head))
    body = "".join(f"<tr>{''.join(cell(k, value) for k, value in enumerate(row))}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _figure(metric: Metric) -> str:
    if metric.value is None or math.isnan(metric.value):
        return "–"
    if math.isinf(metric.value):
        return "∞" if metric.value > 0 else "-∞"
    # A narrow space between thousands, as SI asks.
    return f"{metric.value:,.{metric.digits}f}".replace(",", "\u202f")


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f}<small>s</small>"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}<small>min</small> {rest}<small>s</small>"


def data_uri(picture: Picture) -> str:
    """The picture as a PNG data URI, reduced by whole-pixel box averages to at most `MAX_PICTURE_PIXELS` a side."""
    from PIL import Image

    pixels = np.ascontiguousarray(picture.pixels)
    image = Image.fromarray(pixels)
    factor = -(-max(pixels.shape[:2]) // MAX_PICTURE_PIXELS)
    if factor > 1:
        image = image.reduce(factor)
    buffer = io.BytesIO()
    image.save(buffer, format="PNG", compress_level=6)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
