"""The runs of a sweep: which there are, each measured once and kept as one JSON file.

Notation: as in _tradeoff_figures.py; a run's file is named by a digest of its portrait, prior and settings.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from _tradeoff_figures import REFERENCE, Record
from _tradeoff_keep import FarEnough, StageKeeper, digest, measured
from _tradeoff_measures import asset_accuracy, face_mm, picture_accuracy, read_measured, shape_accuracy

import sira_assets

# Quick runs see that all works: one more value of two knobs, one far from the files and one near.
QUICK_KNOBS = {"geometry steps": 0.01, "texture size": 128}
# What every run does before its first stage.
START_WORK = """
import sys
import sira_assets.delivery
from sira_assets.fields.prior import load_prior
from sira_assets.plan.machine import benchmark
from sira_assets.scene.read_scene import read_scene
read_scene(sys.argv[1])
benchmark(load_prior())
"""
# Points a surface may be measured with, and how often, to see what fewer cost.
CHAMFER_SAMPLES, CHAMFER_SEEDS = (250, 1000, 4000, 16000, 60000), 4


@dataclass(frozen=True)
class Sweep:
    """What is measured.

    Parameters
    ----------
    knobs : names, all if none
    knob_scenes : how many scenes the knobs are turned on; the reference and the presets are run on all
    """

    base: str = "standard"
    seeds: int = 2
    knobs: tuple[str, ...] = ()
    knob_scenes: int | None = None
    presets: bool = True
    quick: bool = False


@dataclass(frozen=True)
class Job:
    """One run to be made."""

    scene: Path
    seed: int
    knob: str
    value: object
    settings: object
    prior: str


def jobs(sweep: Sweep, scenes: Sequence[Path], priors: Sequence[str]) -> list[Job]:
    """All runs, scene by scene, so that what is kept in memory is of use.

    Raises
    ------
    InputError : a knob that there is not.
    """
    from sira_assets.errors import InputError
    from sira_assets.pipeline import settings_for
    from sira_assets.plan.knobs import KNOBS, knob

    unknown = set(sweep.knobs) - {k.name for k in KNOBS} - {"network"}
    if unknown:
        raise InputError(
            expected=f"knobs of: {', '.join(k.name for k in KNOBS)}, network",
            received=", ".join(sorted(unknown)),
            remedy="say one of them",
        )
    # Of one texture size, whatever the photo would ask for: that is a knob here.
    fixed = lambda settings: knob("texture size").put(settings, knob("texture size").read(settings))  # noqa: E731
    base = fixed(tiny() if sweep.quick else settings_for(sweep.base))
    out = []
    for number, scene in enumerate(scenes):
        out += [Job(scene, s, REFERENCE, sweep.base, seeded(base, s), priors[0]) for s in range(sweep.seeds)]
        if sweep.knob_scenes is None or number < sweep.knob_scenes:
            for k in reversed(KNOBS):  # late stages first: the fits they stand on are still in memory
                if (sweep.knobs and k.name not in sweep.knobs) or (sweep.quick and k.name not in QUICK_KNOBS):
                    continue
                for value in (QUICK_KNOBS[k.name],) if sweep.quick else k.values:
                    if value != k.read(base):
                        out.append(Job(scene, 0, k.name, value, k.put(seeded(base, 0), value), priors[0]))
            if not sweep.knobs or "network" in sweep.knobs:
                out += [Job(scene, 0, "network", name, seeded(base, 0), name) for name in priors[1:]]
        if sweep.presets and not sweep.quick:
            names = [n for n in ("draft", "standard", "high") if n != sweep.base]
            out += [Job(scene, 0, "preset", n, fixed(settings_for(n)), priors[0]) for n in names]
    return out


def seeded(settings, seed: int):
    """The settings with another seed everywhere."""
    geometry, appearance = replace(settings.geometry, seed=seed), replace(settings.appearance, seed=seed)
    return replace(settings, geometry=geometry, appearance=appearance, seed=seed)


def tiny():
    """Settings of seconds."""
    from sira_assets.pipeline import settings_for

    s = settings_for("draft", texture_size=64, max_triangles=2000)
    few = {"steps_appearance": 2, "steps_codes": 4, "steps_networks": 2, "steps_cover": 1, "rays": 64, "band_rays": 32}
    g = replace(s.geometry, **few, pool=200, band_pool=100)
    few = {"steps_light": 2, "steps_albedo": 2, "steps_specular": 2, "steps_refinement": 2}
    rays = replace(s.appearance.rays, early=64, aimed=64)
    a = replace(s.appearance, **few, pixels=200, rays=rays)
    return replace(s, geometry=g, appearance=a, extract=replace(s.extract, cell_m=0.006))


def sweep_runs(
    sweep: Sweep, scenes: Sequence[Path], priors: Mapping[str, object], out: Path
) -> Iterator[tuple[Record, bool]]:
    """Every run's record, and whether it was found instead of made."""
    from sira_assets.atomic import write_text

    folder = out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    keeper, scene = StageKeeper(out / "stages"), None
    prior_digests = {name: digest(prior) for name, prior in priors.items()}
    for job in jobs(sweep, scenes, list(priors)):
        if scene is None or scene.name != job.scene.name:
            scene = read_measured(job.scene)
        stands_on = (sira_assets.__version__, scene.portrait, prior_digests[job.prior])
        key = digest((*stands_on, repr(job.settings), job.knob, job.value))
        path = folder / f"{key}.json"
        if path.is_file():
            yield read_record(path), True
            continue
        record = made(job, scene, priors[job.prior], keeper, whole=not sweep.quick)
        write_text(path, json.dumps(asdict(record), indent=1) + "\n")
        yield record, False


def read_record(path: Path) -> Record:
    """A record as it was written."""
    data = json.loads(path.read_text(encoding="utf-8"))
    stages = {name: tuple(figures) for name, figures in data.pop("stages").items()}
    return Record(**data | {"stages": stages, "as_reference": tuple(data["as_reference"])})


def kept_records(out: Path) -> list[Record]:
    """Every record of a folder, references first, so that it does not matter which command made which."""
    found = [read_record(path) for path in sorted((out / "runs").glob("*.json"))]
    return sorted(found, key=lambda r: (r.knob != REFERENCE, r.scene, r.seed, r.knob))


def made(job: Job, scene, prior, keeper: StageKeeper, *, whole: bool = True) -> Record:
    """Run, write into a folder that is thrown away, measure.

    Parameters
    ----------
    whole : also measure, beside the reference, what starting takes and how many points a measurement needs
    """
    from sira_assets.delivery import deliver
    from sira_assets.pipeline import run
    from sira_assets.plan.machine import benchmark

    speed = benchmark(prior, repeats=3, clock=time.process_time)
    last, left_out = reach(job)
    keeper.begin(last=last, left_out=left_out)
    journey = None
    try:
        journey = run(scene.portrait, job.settings, prior=prior, runner=keeper)
    except FarEnough:
        left_out = SHAPE_ALONE
    stages = {r.name: (r.cpu_s, r.wall_s, r.memory_bytes) for r in keeper.runs}
    pose = keeper.made["fit geometry"].canonical_from_world
    surface, _ = keeper.made["clean"]
    measures = shape_accuracy(surface, pose, scene)
    if journey is not None:
        measures |= picture_accuracy(journey, scene)
    if not left_out:
        with tempfile.TemporaryDirectory(prefix="sira-tradeoff-") as there:
            _, written = measured("write", deliver, journey, job.settings, Path(there) / "avatar")
        stages["write"] = (written.cpu_s, written.wall_s, written.memory_bytes)
        measures |= asset_accuracy(journey)
    if job.knob == REFERENCE and whole:
        stages = {"start": start_cost(job.scene), **stages}
        if job.seed == 0 and scene.truth is not None:
            measures |= chamfer_cost(journey, scene)
    return Record(scene.name, job.seed, job.knob, job.value, stages, asdict(speed), measures, left_out)


# Stages behind the extracted surface, and those behind the appearance fit that its pictures do not need.
SHAPE_ALONE = ("fit appearance", "shadows", "simplify", "measure", "unwrap", "bake", "render", "write")
PICTURES_ALONE = ("simplify", "measure", "unwrap", "bake", "write")


def reach(job: Job) -> tuple[str | None, tuple[str, ...]]:
    """How far a run has to go for what its knob changes: the last stage, and stages on the way that it does without."""
    from sira_assets.plan.knobs import KNOBS

    touched = next((k.stages for k in KNOBS if k.name == job.knob), ())
    if touched == ("fit geometry",):
        return "clean", ()
    return None, PICTURES_ALONE if "fit appearance" in touched and "extract" not in touched else ()


def start_cost(scene: Path) -> tuple[float, float, int]:
    """What a run takes before its first stage: imports, reading, this machine's benchmark."""
    command = [sys.executable, "-c", START_WORK, str(scene)]
    # The package's own parent first, so that the child finds it however this process did.
    package = str(Path(sira_assets.__file__).resolve().parents[1])
    path = os.pathsep.join(p for p in (package, os.environ.get("PYTHONPATH")) if p)
    _, run = measured("start", subprocess.run, command, check=True, env={**os.environ, "PYTHONPATH": path})
    return run.cpu_s, run.wall_s, run.memory_bytes


def chamfer_cost(journey, scene) -> dict[str, float]:
    """Spread over seeds and seconds of the face's error, by how many points it is measured with."""
    import numpy as np

    out = {}
    for samples in CHAMFER_SAMPLES:
        began = time.process_time()
        found = [face_mm(journey.avatar.mesh, scene, samples=samples, seed=seed) for seed in range(CHAMFER_SEEDS)]
        seconds = (time.process_time() - began) / CHAMFER_SEEDS
        if None in found:
            return {}
        out |= {f"chamfer_{samples}_sd_mm": float(np.std(found, ddof=1)), f"chamfer_{samples}_s": seconds}
        out[f"chamfer_{samples}_mm"] = float(np.mean(found))
    return out
