"""From a folder of scenes to a prior: samples, SA-SM, AF-SM, the statistics of their codes, a record of it all."""

import hashlib
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from sira_assets import __version__
from sira_assets.atomic import write_text
from sira_assets.fields.af_sm import AppearanceConfig
from sira_assets.fields.prior import CodeStatistics, Prior, save_prior
from sira_assets.fields.sa_sm import ShapeConfig
from sira_assets.train.appearance import AppearanceTrainConfig, train_appearance
from sira_assets.train.batches import stack
from sira_assets.train.scenes import SampleConfig, list_scenes, load_samples
from sira_assets.train.shape import ShapeTrainConfig, train_shape


@dataclass(frozen=True)
class PriorConfig:
    """Everything that decides a prior, given the scenes."""

    samples: SampleConfig = SampleConfig()
    shape_model: ShapeConfig = ShapeConfig()
    shape: ShapeTrainConfig = ShapeTrainConfig()
    appearance_model: AppearanceConfig = AppearanceConfig()
    appearance: AppearanceTrainConfig = AppearanceTrainConfig()


class TrainingLog:
    """Loss curves on disk, one JSON line a report, and a progress bar on a terminal."""

    def __init__(self, path: Path, progress=None):
        self.path, self.progress = path, progress
        path.parent.mkdir(parents=True, exist_ok=True)

    def reporter(self, stage: str, steps: int):
        """The callback of one stage."""
        started = time.monotonic()
        task = self.progress.add_task(stage, total=steps) if self.progress is not None else None

        def report(step: int, losses: dict[str, float]) -> None:
            row = {"stage": stage, "step": step, "seconds": round(time.monotonic() - started, 1)}
            with self.path.open("a") as file:
                file.write(json.dumps(row | {k: round(v, 6) for k, v in losses.items()}) + "\n")
            if task is not None:
                self.progress.update(task, completed=step)

        return report


def train_prior(
    scenes: Path,
    out: Path,
    run: Path,
    *,
    config: PriorConfig = PriorConfig(),
    device: str | torch.device = "cpu",
    resume: bool = False,
    workers: int = 2,
    progress=None,
) -> Prior:
    """Train both models on the scenes below a folder and write the prior to `out`.

    Parameters
    ----------
    scenes : folder of scenes with gt/mesh.ply and gt/landmarks.json
    run : folder of checkpoints and loss curves; `resume` goes on from it exactly
    progress : a rich Progress, or None

    Raises
    ------
    InputError : no scenes, or scenes without truth.
    """
    started = time.monotonic()
    names = [path.name for path in list_scenes(scenes)]
    task = progress.add_task("samples", total=len(names)) if progress is not None else None
    data = stack(
        load_samples(
            scenes,
            config=config.samples,
            seed=config.shape.seed,
            workers=workers,
            progress=(lambda: progress.advance(task)) if progress is not None else None,
        ),
        device=device,
    )
    log = TrainingLog(Path(run) / "curves.jsonl", progress)
    shape, codes = train_shape(
        data,
        run,
        model_config=config.shape_model,
        config=config.shape,
        device=device,
        resume=resume,
        report=log.reporter("shape", config.shape.steps),
    )
    appearance, appearance_codes = train_appearance(
        data,
        shape,
        codes,
        run,
        model_config=config.appearance_model,
        config=config.appearance,
        device=device,
        resume=resume,
        report=log.reporter("appearance", config.appearance.steps),
    )
    tables = (codes.z_sdf, codes.z_r, appearance_codes.z_a, appearance_codes.z_s, appearance_codes.z_l)
    prior = Prior(shape.cpu(), appearance.cpu(), *(CodeStatistics.of(table.detach().cpu()) for table in tables))
    description = {
        "scenes": len(names),
        "scenes_sha256": hashlib.sha256("\n".join(names).encode()).hexdigest(),
        "config": asdict(config),
        "seconds": round(time.monotonic() - started),
        "threads": torch.get_num_threads(),
        "device": str(device),
        "version": __version__,
    }
    save_prior(prior, out, description)
    write_text(Path(run) / "description.json", json.dumps(description, indent=1))
    return prior
