#!/usr/bin/env python3
"""Measure the generator's population: landmarks against people, the mean face, the surface between the landmarks.

Landmarks: --heads random heads in the canonical frame, without expression (the population's figures are of neutral
faces), against the statistics that ship with the generator or against --population FILE of the same form. With
--real HEAD ... (folders with mesh.ply and landmarks.json) the surface statistics of --surfaces random heads stand
beside theirs, with how many of the generator's standard deviations a real head is off. With --mean HEAD the mean
generated face is compared with that head's outer surface within 95 mm of the nose tip.

Exit status: 0 within the bounds below, 3 unusable input, 4 outside: 68-landmark mean within 2.0 mm, each landmark's
spread and the first ten principal deviations within 30 %, the mean face within 1.2 mm.
"""

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from _cli import run

MEAN_MM, SPREAD, MEAN_FACE_MM = 2.0, 0.30, 1.2
DIRECTIONS = 10


@dataclass(frozen=True)
class LandmarkFigures:
    """Random heads' 68 landmarks against the population's.

    Parameters
    ----------
    mean_rms_mm : distance of the mean landmarks, root mean square over the 68
    spread_low, spread_high : smallest and largest ratio of a landmark's spread to the population's
    deviations : ratio of the standard deviation along each of the population's first directions
    own_deviations : ratio of the heads' own principal deviations to the population's
    overlap : mean squared cosine between the heads' and the population's leading subspaces (1: the same)
    """

    heads: int
    mean_rms_mm: float
    spread_low: float
    spread_high: float
    deviations: list[float]
    own_deviations: list[float]
    overlap: float

    def within(self) -> bool:
        """Whether the bounds hold."""
        ratios = [self.spread_low, self.spread_high, *self.deviations, *self.own_deviations]
        return self.mean_rms_mm <= MEAN_MM and all(abs(r - 1.0) <= SPREAD for r in ratios)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="measure_generator.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("--heads", type=int, default=500, metavar="N", help="random heads for the landmarks (default 500)")
    out.add_argument("--surfaces", type=int, default=60, metavar="N", help="random heads for the surface (default 60)")
    out.add_argument("--seed", type=int, default=0)
    out.add_argument("--population", type=Path, metavar="FILE", help="landmark statistics to compare with")
    out.add_argument("--mean", type=Path, metavar="HEAD", help="folder of a population's mean head")
    out.add_argument("--real", type=Path, nargs="+", default=[], metavar="HEAD", help="folders of real heads")
    out.add_argument("--json", action="store_true", help="print JSON instead of tables")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    if arguments.heads < 20 or arguments.surfaces < 2 or arguments.seed < 0:
        parser().error("--heads must be at least 20, --surfaces at least 2 and --seed at least 0")
    return run(lambda: measure(arguments))


def measure(arguments: argparse.Namespace) -> int:
    """Print what was asked for."""
    neutral, drawn = (
        measure_landmarks(arguments.heads, arguments.seed, arguments.population, expression=e) for e in (False, True)
    )
    report = {"neutral": asdict(neutral), "with_expression": asdict(drawn)}
    good = neutral.within()
    if not arguments.json:
        print_landmarks(neutral, drawn)
    if arguments.mean:
        mean_mm = mean_face_mm(arguments.mean)
        report["mean_face_mm"] = mean_mm
        good = good and mean_mm <= MEAN_FACE_MM
        if not arguments.json:
            print(f"mean face to {arguments.mean.name}: {mean_mm:.3f} mm")
    if arguments.real:
        table = surface_table(arguments.surfaces, arguments.seed, arguments.real)
        report["surface"] = table
        if not arguments.json:
            print_surface(table, [p.resolve().name for p in arguments.real])
    if arguments.json:
        print(json.dumps(report, indent=1))
    return 0 if good else 4


def random_landmarks(count: int, seed: int, *, expression: bool):
    """Landmarks (count, 68, 3) of random heads in the canonical frame, metres."""
    from dataclasses import replace

    import numpy as np
    from _generator_fit import place

    from data_synth.head.params import sample_params
    from data_synth.head.shape_params import neutral

    rng = np.random.default_rng(seed)
    out = np.empty((count, 68, 3))
    for i in range(count):
        params = sample_params(rng)
        if not expression:
            params = replace(params, shape=neutral(params.shape))
        out[i] = place(params, np.empty((0, 3)))[1]
    return out


def read_population(path: Path | None):
    """Mean (68, 3), std (68, 3), principal std (K,) and directions (K, 204), metres.

    Raises
    ------
    InputError : the file does not have them.
    """
    import numpy as np

    from data_synth.head.population import load_population
    from sira_assets.errors import InputError
    from sira_assets.scene.landmarks import read_json

    if path is None:
        p = load_population()
        return p.mean_m, p.std_m, p.principal_std_m, p.directions.reshape(len(p.directions), -1)
    data = read_json(path)
    try:
        mean, std = (np.array(data[k], float).reshape(68, 3) for k in ("mean_m", "std_m"))
        deviation = np.array(data["principal_std_m"], float)
        return mean, std, deviation, np.array(data["principal_directions"], float).reshape(len(deviation), -1)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            expected=f"mean_m, std_m, principal_std_m and principal_directions of 68 landmarks in {path}",
            received=f"{type(error).__name__}: {error}",
            remedy="name a file of the form of data_synth/data/population.json",
        ) from None


def measure_landmarks(count: int, seed: int, population: Path | None, *, expression: bool) -> LandmarkFigures:
    """Statistics of random heads' landmarks against a population's."""
    import numpy as np

    mean, std, deviation, directions = read_population(population)
    x = random_landmarks(count, seed, expression=expression)
    spread = np.sqrt(x.var(0, ddof=1).sum(1)) / np.sqrt((std**2).sum(1))
    centred = (x - x.mean(0)).reshape(count, -1)
    _, size, own = np.linalg.svd(centred, full_matrices=False)
    k = min(DIRECTIONS, len(deviation))
    basis = np.linalg.qr(directions[:k].T)[0]
    return LandmarkFigures(
        heads=count,
        mean_rms_mm=float(1e3 * np.sqrt(((x.mean(0) - mean) ** 2).sum(1).mean())),
        spread_low=float(spread.min()),
        spread_high=float(spread.max()),
        deviations=((centred @ directions[:k].T).std(0, ddof=1) / deviation[:k]).round(3).tolist(),
        own_deviations=(size[:k] / np.sqrt(count - 1) / deviation[:k]).round(3).tolist(),
        overlap=float(((own[:k] @ basis) ** 2).sum() / k),
    )


def print_landmarks(neutral: LandmarkFigures, drawn: LandmarkFigures) -> None:
    """Two columns: neutral heads, and as drawn with expression."""
    print(f"{neutral.heads} random heads        neutral   with expression")
    rows = (
        ("68-landmark mean, mm", lambda f: f"{f.mean_rms_mm:.3f}"),
        ("spread, ratio", lambda f: f"{f.spread_low:.2f}-{f.spread_high:.2f}"),
        ("along directions", lambda f: f"{min(f.deviations):.2f}-{max(f.deviations):.2f}"),
        ("own directions", lambda f: f"{min(f.own_deviations):.2f}-{max(f.own_deviations):.2f}"),
        (f"overlap of {DIRECTIONS}", lambda f: f"{f.overlap:.3f}"),
    )
    for name, show in rows:
        print(f"{name:<24}{show(neutral):>10}{show(drawn):>16}")


def mean_face_mm(folder: Path) -> float:
    """Mean distance from a head's outer face to the generated mean face, millimetres of that head."""
    import numpy as np
    from _generator_fit import FACE_RADIUS_M, head_mesh, read_head

    from data_synth.head.params import mean_params
    from sira_assets.measure.outer_surface import outer_surface
    from sira_assets.measure.surface import Surface, sample_surface

    head = read_head(folder)
    points = sample_surface(outer_surface(head.mesh), 60_000, seed=0).points
    near = np.linalg.norm(points - head.nose_tip, axis=1) < 1e3 * FACE_RADIUS_M / head.mm
    return float(Surface(head_mesh(mean_params())).distance(points[near]).mean() * head.mm)


def surface_table(count: int, seed: int, real: list[Path]) -> dict[str, list[float]]:
    """By statistic: mean and standard deviation of random heads, then each real head's value."""
    from dataclasses import replace

    import numpy as np
    from _generator_fit import head_mesh, read_head
    from _surface_statistics import face_heights, statistics

    from data_synth.head.params import sample_params
    from data_synth.head.shape_params import neutral
    from sira_assets.measure.outer_surface import outer_surface

    rng = np.random.default_rng(seed)
    ours = []
    for _ in range(count):
        params = sample_params(rng)
        ours.append(statistics(face_heights(head_mesh(replace(params, shape=neutral(params.shape))))))
    # a mouth bag seen through parted lips is no surface of the face
    theirs = [statistics(face_heights(outer_surface(read_head(p).mesh))) for p in real]
    table = {}
    for name in ours[0]:
        values = [s[name] for s in ours]
        table[name] = [float(np.mean(values)), float(np.std(values, ddof=1)), *(s[name] for s in theirs)]
    return table


def print_surface(table: dict[str, list[float]], names: list[str]) -> None:
    """Random heads' mean and deviation, and the real heads with their distance in deviations."""
    print(f"\n{'surface':<26}{'random heads':>16}" + "".join(f"{name:>18}" for name in names))
    for name, (mean, deviation, *real) in table.items():
        row = "".join(f"{v:>10.2f} ({(v - mean) / max(deviation, 1e-9):+5.1f})" for v in real)
        print(f"{name:<26}{mean:>8.2f} +-{deviation:>5.2f}{row}")


if __name__ == "__main__":
    sys.exit(main())
