"""Whether budgets and tolerances are kept: `export_avatar.py` as a user runs it, timed from outside and measured.

Notation: a promise is "60s" or "0.5mm"; kept is what it came to, in the same unit; one that the tool refuses in words
is no promise, and counts as refused. s is the standard deviation of a measure over seeds, pooled over the scenes and
the two budgets that are compared; two means of n seeds differ by s sqrt(2 / n) by chance.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from _tradeoff_figures import Section
from _tradeoff_keep import digest
from _tradeoff_measures import face_mm, read_measured

import sira_assets

# A budget is kept within this share of it.
WITHIN = 0.2
# How often chance alone may make any longer budget look worse, of all that are looked at together.
FALSE_ALARM = 0.05
# What a budget buys, and its sign: 1 where less is better.
BOUGHT = {"face_mm": 1.0, "final_psnr_db": -1.0}


@dataclass(frozen=True)
class Kept:
    """One promise on one scene.

    Parameters
    ----------
    asked : seconds or mm
    kept : wall-clock seconds of the whole command, or the greatest distance of the mesh from the field in mm; None
        where it was refused
    planned_s : seconds the tool planned, where it planned any
    measures : name -> value
    """

    scene: str
    promise: str
    asked: float
    kept: float | None
    planned_s: float | None
    measures: dict[str, float]
    seed: int = 0

    @property
    def holds(self) -> bool:
        """Whether it was kept: a budget within a fifth of it, a tolerance altogether. A refusal breaks nothing."""
        if self.kept is None:
            return True
        return self.kept <= self.asked * (1.0 + WITHIN if self.promise.endswith("s") else 1.0)


def promise_runs(
    promises: Sequence[str], scenes: Sequence[Path], out: Path, seeds: int = 1
) -> Iterator[tuple[Kept, bool]]:
    """Every promise on every scene with every seed, and whether it was found instead of made."""
    from sira_assets.atomic import write_text

    folder = out / "promises"
    folder.mkdir(parents=True, exist_ok=True)
    for path in dict.fromkeys(scenes):
        scene = read_measured(path)
        for seed, promise in ((seed, promise) for seed in range(seeds) for promise in dict.fromkeys(promises)):
            file = folder / f"{digest((sira_assets.__version__, scene.portrait, promise, seed))}.json"
            if file.is_file():
                yield Kept(**json.loads(file.read_text(encoding="utf-8"))), True
                continue
            kept = promised(promise, path, scene, out / "figures.json", seed)
            write_text(file, json.dumps(asdict(kept), indent=1) + "\n")
            yield kept, False


def promised(promise: str, path: Path, scene, figures: Path, seed: int = 0) -> Kept:
    """Run the command, planned with these figures if they are there, and measure what it wrote."""
    from sira_assets.measure.truth import read_mesh

    tool = Path(__file__).with_name("export_avatar.py")
    asked = float(re.match(r"[\d.]+", promise)[0])
    option = "--tolerance" if promise.endswith("mm") else "--budget"
    with tempfile.TemporaryDirectory(prefix="sira-promise-") as there:
        target = Path(there) / "avatar"
        command = [sys.executable, str(tool), str(path), option, promise, "--out", str(target), "--json"]
        command += ["--seed", str(seed)]
        if option == "--budget" and figures.is_file():
            command += ["--figures", str(figures)]
        package = str(Path(sira_assets.__file__).resolve().parents[1])
        parts = os.pathsep.join(p for p in (package, os.environ.get("PYTHONPATH")) if p)
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": parts})
        seconds = time.monotonic() - began
        if done.returncode == 3:
            return Kept(scene.name, promise, asked, None, None, {}, seed)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)}\n{done.stderr[-2000:]}")
        report = json.loads((target / "report.json").read_text(encoding="utf-8"))
        measures = {n: v for n, v in report["metrics"].items() if isinstance(v, int | float)}
        if scene.truth is not None:
            mesh = read_mesh(target, metres_per_unit=scene.portrait.metres_per_unit)
            to_units = np.diag([1.0 / scene.portrait.metres_per_unit] * 3 + [1.0])
            face = face_mm(mesh.transformed(to_units), scene)
            measures |= {} if face is None else {"face_mm": face}
        said = [d["evidence"] for d in report["decisions"] if d["what"] == "plan"]
        planned = float(re.search(r"planned ([\d.]+) s", said[0])[1]) if said else None
        kept = seconds if option == "--budget" else measures["mesh_gap_max_mm"]
    return Kept(scene.name, promise, asked, kept, planned, measures, seed)


@dataclass(frozen=True)
class More:
    """One measure, a budget and the next longer one; changes are positive where the longer is worse.

    Parameters
    ----------
    change, chance : mean over scenes, and what chance does to it; nan where no scene has two seeds
    worst : the scene that loses most
    worst_change, worst_chance : the same of it
    limit, worst_limit : so many times the chance is beyond it
    """

    measure: str
    shorter: str
    longer: str
    change: float
    chance: float
    worst: str
    worst_change: float
    worst_chance: float
    limit: float
    worst_limit: float

    @property
    def worse(self) -> bool:
        """Whether more time made it worse, beyond chance."""
        one = self.worst_change > self.worst_limit * self.worst_chance > 0.0
        return one or self.change > self.limit * self.chance > 0.0


def bought(kept: Sequence[Kept]) -> list[More]:
    """What each longer budget does beside the next shorter one, on the scenes that have both.

    Limits are Student's t at `FALSE_ALARM` over the number of looks (Bonferroni): every measure and pair of budgets, on
    average and on each scene.
    """
    from scipy.stats import t

    budgets = sorted({(k.asked, k.promise) for k in kept if k.promise.endswith("s")})
    out = []
    for measure, sign in BOUGHT.items():
        groups: dict[tuple[str, str], list[float]] = {}
        for k in kept:
            if k.kept is not None and measure in k.measures:
                groups.setdefault((k.scene, k.promise), []).append(sign * k.measures[measure])
        for (_, shorter), (_, longer) in pairwise(budgets):
            scenes = [s for s in dict.fromkeys(k.scene for k in kept) if {(s, shorter), (s, longer)} <= set(groups)]
            if not scenes:
                continue
            pairs = [(groups[s, shorter], groups[s, longer]) for s in scenes]
            several = [g for pair in pairs for g in pair if len(g) > 1]
            freedom = sum(len(g) - 1 for g in several)
            squares = sum(np.var(g) * len(g) for g in several)
            deviation = float(np.sqrt(squares / freedom)) if freedom else float("nan")
            changes = [float(np.mean(b) - np.mean(a)) for a, b in pairs]
            chances = [deviation * float(np.sqrt(1 / len(a) + 1 / len(b))) for a, b in pairs]
            worst = int(np.argmax(changes))
            mean_chance = float(np.sqrt(np.square(chances).sum())) / len(pairs)
            whole = float(np.mean(changes)), mean_chance
            looks = 2 * len(BOUGHT) * (len(budgets) - 1)
            limits = [float(t.isf(FALSE_ALARM / n, freedom or 1)) for n in (looks, looks * len(pairs))]
            out.append(More(measure, shorter, longer, *whole, scenes[worst], changes[worst], chances[worst], *limits))
    return out


def bought_section(steps: Sequence[More]) -> Section:
    """The table of `bought`."""
    rows = tuple(
        (
            m.measure,
            f"{m.shorter} to {m.longer}",
            f"{m.change:+.3g}",
            f"{m.chance:.2g}, {m.limit:.1f}",
            m.worst,
            f"{m.worst_change:+.3g}",
            f"{m.worst_chance:.2g}, {m.worst_limit:.1f}",
            "worse" if m.worse else "",
        )
        for m in steps
    )
    say = (
        "What a longer budget does beside the next shorter one; above 0 it is worse. Chance is a standard deviation, "
        f"by seeds, and how many of them a change may be (one false alarm in {1 / FALSE_ALARM:.0f} pages)."
    )
    head = ("measure", "budget", "mean change", "chance", "worst scene", "its change", "chance", "")
    return Section("more time", say, None, head, rows)


def promise_section(kept: Sequence[Kept]) -> Section:
    """The table of all promises."""
    names = [n for n in ("face_mm", "final_psnr_db", "asset_vs_final_psnr_db") if any(n in k.measures for k in kept)]
    rows = tuple(
        (
            f"{k.scene}, seed {k.seed}" if k.seed else k.scene,
            k.promise,
            "refused" if k.kept is None else f"{k.kept:.3g}",
            "" if k.planned_s is None else f"{k.planned_s:.0f}",
            *(f"{k.measures[n]:.3g}" if n in k.measures else "" for n in names),
            "" if k.kept is None else "kept" if k.holds else "not kept",
        )
        for k in kept
    )
    say = f"Whole commands, timed from outside. A budget is kept within {100 * WITHIN:.0f} %, a tolerance altogether."
    return Section("promises", say, None, ("scene", "asked", "came to", "planned, s", *names, ""), rows)
