"""What a run has to say for itself: one noun for report.json and report.html.

Notation: seconds are wall-clock; memory is bytes; a metric without a value (nothing to measure against) is None.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sira_assets.atomic import write_text
from sira_assets.viewer.scene import ViewerScene


@dataclass(frozen=True)
class Picture:
    """A picture of the report: pixels (H, W, 3) or (H, W) uint8, sRGB encoded; name and caption in plain words."""

    name: str
    caption: str
    pixels: np.ndarray

    def __post_init__(self):
        p = self.pixels
        if p.dtype != np.uint8 or not (p.ndim == 2 or (p.ndim == 3 and p.shape[2] == 3)) or p.size == 0:
            raise ValueError(f"picture {self.name!r}: expected uint8 (H, W, 3) or (H, W), not {p.dtype} {p.shape}")


@dataclass(frozen=True)
class Curve:
    """A quantity over the steps of a stage: points of (step, value)."""

    name: str
    points: tuple[tuple[float, float], ...]
    x_label: str = "step"


@dataclass(frozen=True)
class Metric:
    """One measured figure.

    Parameters
    ----------
    key : its name in report.json
    label : its name on the page
    unit : "dB", "mm", "s", "" ...
    meaning : how it was measured, one line
    headline : also shown large at the top of the page
    digits : decimals on the page; report.json has them all
    """

    key: str
    label: str
    value: float | None
    unit: str = ""
    meaning: str = ""
    headline: bool = False
    digits: int = 2


@dataclass(frozen=True)
class Decision:
    """A choice the run made by itself, with the measurement it was made from."""

    what: str
    chosen: str
    evidence: str


@dataclass(frozen=True)
class Report:
    """A whole run.

    Parameters
    ----------
    title, subtitle : the subject and the settings in a few words
    photo, render : the input and the avatar seen by the same camera, of one size
    maps : further pictures, in the order they are shown
    viewer : the avatar to be turned by hand; `photo` lies over it where it has the photo's camera
    seconds : (stage, wall-clock seconds) in the order they ran
    settings : (name, value) as given or defaulted
    files : (relative path, what it is) of what was written
    """

    title: str
    subtitle: str = ""
    photo: Picture | None = None
    render: Picture | None = None
    maps: tuple[Picture, ...] = ()
    curves: tuple[Curve, ...] = ()
    metrics: tuple[Metric, ...] = ()
    decisions: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()
    settings: tuple[tuple[str, Any], ...] = ()
    seconds: tuple[tuple[str, float], ...] = ()
    peak_memory_bytes: int | None = None
    version: str = ""
    seed: int | None = None
    metres_per_unit: float = 1.0
    files: tuple[tuple[str, str], ...] = ()
    viewer: ViewerScene | None = None

    @property
    def total_seconds(self) -> float:
        """Sum over the stages."""
        return float(sum(s for _, s in self.seconds))


def report_dict(report: Report) -> dict:
    """The content of report.json, in types JSON has; pictures and curves stay on the page."""
    return {
        "title": report.title,
        "version": report.version,
        "seed": report.seed,
        "metres_per_unit": float(report.metres_per_unit),
        "seconds": {stage: round(float(s), 3) for stage, s in report.seconds},
        "peak_memory": report.peak_memory_bytes,
        "metrics": {m.key: json_value(m.value) for m in report.metrics},
        "decisions": [{"what": d.what, "chosen": d.chosen, "evidence": d.evidence} for d in report.decisions],
        "warnings": list(report.warnings),
        "settings": {name: json_value(value) for name, value in report.settings},
    }


def write_report_json(report: Report, path: str | Path) -> None:
    """Write report.json, whole or not at all."""
    write_text(path, json.dumps(report_dict(report), indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def json_value(value: Any) -> Any:
    """`value` in a type JSON has: NaN becomes null, infinities "inf" and "-inf", NumPy's scalars plain ones."""
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, np.generic):
        return json_value(value.item())
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return value if math.isfinite(value) else ("inf" if value > 0 else "-inf")
    if isinstance(value, list | tuple):
        return [json_value(v) for v in value]
    if isinstance(value, np.ndarray):
        return json_value(value.tolist())
    return str(value)
