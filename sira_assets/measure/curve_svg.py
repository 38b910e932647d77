"""A loss curve as an inline SVG, coloured by the page's own style.

Notation: data coordinates (x, y) are mapped to pixels of a fixed view box; y is logarithmic where the curve spans much.
"""

import html
import json
import math

import numpy as np

from sira_assets.measure.report import Curve

WIDTH, HEIGHT = 400.0, 210.0
LEFT, RIGHT, TOP, BOTTOM = 52.0, 12.0, 12.0, 34.0
# More points than pixels say nothing more.
MAX_POINTS = 400
# From this ratio on, a linear axis would press most of a curve onto its floor.
LOG_FROM_RATIO = 20.0


def curve_svg(curve: Curve) -> str:
    """SVG text of one curve: faint samples, a running median over them, ticks, and the points for the page's read-out.

    Points that are not finite are left out; a curve without a finite point says so.
    """
    points = np.array([p for p in curve.points if all(map(math.isfinite, p))], float).reshape(-1, 2)
    if not len(points):
        return '<p class="muted">no finite value was recorded</p>'
    x, y = points[np.argsort(points[:, 0], kind="stable")].T
    log = bool(y.min() > 0 and y.max() >= LOG_FROM_RATIO * y.min())
    y_ticks = _log_ticks(y.min(), y.max()) if log else nice_ticks(y.min(), y.max(), 4)
    x_ticks = nice_ticks(x.min(), x.max(), 5)
    x_low, x_high = _span(x.min(), x.max())
    # The axis follows the data; ticks outside it are not drawn.
    y_low, y_high = _span(*(np.log10([y.min(), y.max()]) if log else (y.min(), y.max())), pad=0.06)

    def to_x(v):
        return LEFT + (v - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)

    def to_y(v):
        v = np.log10(v) if log else v
        return TOP + (y_high - v) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM)

    parts = []
    for tick in y_ticks:
        level = to_y(tick)
        if TOP - 1 <= level <= HEIGHT - BOTTOM + 1:
            parts.append(f'<line class="grid" x1="{LEFT:g}" x2="{WIDTH - RIGHT:g}" y1="{level:.1f}" y2="{level:.1f}"/>')
            parts.append(
                f'<text class="tick" x="{LEFT - 6:g}" y="{level + 3.5:.1f}" text-anchor="end">{short(tick)}</text>'
            )
    for tick in x_ticks:
        if x_low <= tick <= x_high:
            place = f'x="{to_x(tick):.1f}" y="{HEIGHT - BOTTOM + 15:g}"'
            parts.append(f'<text class="tick" {place} text-anchor="middle">{short(tick)}</text>')
    floor = HEIGHT - BOTTOM
    parts.append(f'<line class="axis" x1="{LEFT:g}" x2="{WIDTH - RIGHT:g}" y1="{floor:g}" y2="{floor:g}"/>')
    label = html.escape(curve.x_label) + (" · log scale" if log else "")
    parts.append(f'<text class="tick" x="{WIDTH - RIGHT:g}" y="{HEIGHT - 4:g}" text-anchor="end">{label}</text>')

    smooth = running_median(y)
    keep = np.unique(np.linspace(0, len(x) - 1, min(len(x), MAX_POINTS)).round().astype(int))
    px, raw, mid = to_x(x[keep]), to_y(y[keep]), to_y(smooth[keep])
    if len(x) > 40:
        parts.append(f'<polyline class="raw" points="{_path(px, raw)}"/>')
    parts.append(f'<polyline class="line" points="{_path(px, mid)}"/>')
    if len(x) == 1:
        parts.append(f'<circle class="dot" cx="{px[0]:.1f}" cy="{mid[0]:.1f}" r="3"/>')
    parts.append('<g class="probe" visibility="hidden"><line class="axis"/><circle class="dot" r="3.5"/></g>')
    rows = zip(px, mid, x[keep], smooth[keep], strict=True)
    data = [[round(float(a), 1), round(float(b), 1), short(float(c)), short(float(d), 4)] for a, b, c, d in rows]
    title = html.escape(f"{curve.name}: from {short(y[0], 3)} to {short(y[-1], 3)}")
    return (
        f'<svg class="curve" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{title}" '
        f'data-points=\'{json.dumps(data)}\' data-top="{TOP:g}" data-bottom="{floor:g}">{"".join(parts)}</svg>'
    )


def running_median(y: np.ndarray) -> np.ndarray:
    """Median over a centred window of about a fortieth of the curve; short curves are left as they are."""
    half = len(y) // 80
    if half < 1:
        return y
    # Reflected, not repeated: repeating would make a majority of a spike at the very end.
    padded = np.pad(y, half, mode="reflect")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)


def nice_ticks(low: float, high: float, count: int) -> list[float]:
    """About `count` round numbers (1, 2 or 5 times a power of ten apart) within [low, high]."""
    if not high > low:
        return [float(low)]
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = power * min((m for m in (1, 2, 5, 10) if m * power >= raw * 0.999), default=10)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    stride = max(1, math.ceil((last - first) / 5))
    ticks = [10.0**k for k in range(first, last + 1, stride)]
    inside = [t for t in ticks if low <= t <= high]
    # Less than two decades: two and five help to read the level.
    return (
        ticks if len(inside) > 1 else sorted({*ticks, *(m * 10.0**k for k in range(first, last + 1) for m in (2, 5))})
    )


def _span(low: float, high: float, pad: float = 0.0) -> tuple[float, float]:
    room = (high - low) * pad if high > low else max(abs(low), 1.0) * 0.1
    return low - room, high + room


def short(value: float, digits: int = 3) -> str:
    """A number in few characters: 0.0012, 1.5k, 3e-7."""
    if value == 0:
        return "0"
    size = abs(value)
    if 1000 <= size < 1e6:
        return f"{value / 1000:.{digits}g}k"
    return f"{value:.{digits}g}"


def _path(x: np.ndarray, y: np.ndarray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
