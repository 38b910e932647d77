"""What `tools/measure_tradeoff.py` measured, as the planner reads it: a reference, and each knob's curve about it.

Notation: a run's losses are how much worse than the reference it is, in steps that are just worth seeing (`WORTH`); its
ratios are its stages' processor seconds over the reference's, both beside a benchmark of the same moment.
"""

import json
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from sira_assets.atomic import write_text
from sira_assets.errors import InputError
from sira_assets.plan.front import monotone
from sira_assets.plan.knobs import Value


@dataclass(frozen=True)
class Measure:
    """One way to be accurate.

    Parameters
    ----------
    worth : a difference of this much is one step of loss; negative where more is better
    meaning : how it is measured, one line
    """

    name: str
    unit: str
    worth: float
    meaning: str


# Steps of one size to the eye, as near as one figure can say: seeds differ by 0.1 mm in the face; half a decibel is
# 6 % in amplitude; 0.1 mm between asset and field is a third of a texel; two steps of 8 bits show as bands on skin;
# 0.05 % of a mask as holes takes half a decibel from a render of 30 dB.
MEASURES = (
    Measure("face_mm", "mm", 0.1, "true face to the fitted surface, mean, within 95 mm of the nose tip, as placed"),
    Measure("bare_percent", "%", 0.05, "pixels of the mask that show no surface"),
    Measure("asset_mm", "mm", 0.1, "exported mesh to the fitted field and back, the greater of the two means"),
    Measure("asset_max_mm", "mm", 2.0, "the same, greatest: ears and nostrils"),
    Measure("final_db", "dB", -0.5, "render against photo, PSNR in the mask, sRGB-encoded"),
    Measure("diffuse_db", "dB", -0.5, "diffuse albedo against the truth, linear, after one gain, PSNR in the mask"),
    Measure(
        "bake_rms", "of 255", 2.0, "baked diffuse map against the field's albedo on the surface, sRGB-encoded, RMS"
    ),
)
WORTH = {m.name: m.worth for m in MEASURES}


@dataclass(frozen=True)
class Benchmark:
    """Seconds of three fixed pieces of work, wall-clock: network forward and backward, rays, plain arrays."""

    network_s: float
    rays_s: float
    arrays_s: float


@dataclass(frozen=True)
class StageCost:
    """Processor seconds of a stage of the reference and the memory it had resident at its peak."""

    name: str
    seconds: float
    memory_bytes: int


@dataclass(frozen=True)
class Point:
    """One value of a knob, everything else as in the reference.

    Parameters
    ----------
    ratios : (stage, its seconds over the reference's)
    losses : (measure, how much worse than the reference, in that measure's own unit; negative is better)
    spread : (measure, standard deviation of that over scenes and seeds)
    memory_bytes : greatest of all stages
    """

    value: Value
    ratios: tuple[tuple[str, float], ...]
    losses: tuple[tuple[str, float], ...]
    spread: tuple[tuple[str, float], ...]
    memory_bytes: int

    def ratio(self, stage: str) -> float:
        """1 for a stage that the knob leaves alone."""
        return dict(self.ratios).get(stage, 1.0)

    @property
    def loss(self) -> float:
        """All measures in steps worth seeing, together."""
        return sum(delta / abs(WORTH[name]) for name, delta in self.losses)


@dataclass(frozen=True)
class KnobCurve:
    """A knob's points, cheapest value first."""

    name: str
    points: tuple[Point, ...]

    def losses(self) -> np.ndarray:
        """(N,) monotone: what costs more is never worse."""
        return monotone([p.loss for p in self.points])


@dataclass(frozen=True)
class Figures:
    """One sweep.

    Parameters
    ----------
    made_by : the command that measured
    scenes, seeds, threads : what it measured, with how many threads
    benchmark : of the measuring machine, beside the reference runs
    reference : its stages in order
    accuracy : (measure, the reference's mean)
    spread : (measure, standard deviation over seeds)
    """

    made_by: str
    scenes: int
    seeds: int
    threads: int
    benchmark: Benchmark
    reference: tuple[StageCost, ...]
    accuracy: tuple[tuple[str, float], ...]
    spread: tuple[tuple[str, float], ...]
    curves: tuple[KnobCurve, ...]

    def curve(self, name: str) -> KnobCurve | None:
        """A knob's curve, if it was measured."""
        return next((c for c in self.curves if c.name == name), None)


def write_figures(figures: Figures, path: Path) -> None:
    """Write as JSON, numbers to six digits."""
    write_text(path, json.dumps(_rounded(asdict(figures)), indent=1) + "\n")


def read_figures(path: Path | None = None) -> Figures:
    """Read a sweep; without a path, the one that ships with the package.

    Raises
    ------
    InputError : no such file, or one that holds something else.
    """
    source = files("sira_assets.plan") / "figures.json" if path is None else Path(path)
    try:
        data = json.loads(source.read_text(encoding="utf-8"))
        pairs = lambda rows: tuple((str(name), float(value)) for name, value in rows)  # noqa: E731
        curves = tuple(
            KnobCurve(
                c["name"],
                tuple(
                    Point(p["value"], *(pairs(p[n]) for n in ("ratios", "losses", "spread")), int(p["memory_bytes"]))
                    for p in c["points"]
                ),
            )
            for c in data["curves"]
        )
        return Figures(
            made_by=str(data["made_by"]),
            scenes=int(data["scenes"]),
            seeds=int(data["seeds"]),
            threads=int(data["threads"]),
            benchmark=Benchmark(**data["benchmark"]),
            reference=tuple(StageCost(**stage) for stage in data["reference"]),
            accuracy=pairs(data["accuracy"]),
            spread=pairs(data["spread"]),
            curves=curves,
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            expected=f"figures of a sweep at {source}",
            received=f"{type(error).__name__}: {error}",
            remedy="measure them (python tools/measure_tradeoff.py --out OUT), then say --figures OUT/figures.json",
        ) from None


def _rounded(value):
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    return [_rounded(v) for v in value] if isinstance(value, list | tuple) else value
