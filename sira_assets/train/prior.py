"""From a folder of scenes to a prior: samples, SA-SM, AF-SM, the statistics of their codes, a record of it all."""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import torch

from sira_assets import __version__
from sira_assets.atomic import write_text
from sira_assets.fields.af_sm import AppearanceConfig
from sira_assets.fields.prior import CodeStatistics, Prior, save_prior
from sira_assets.fields.sa_sm import ShapeConfig
from sira_assets.train.appearance import AppearanceTrainConfig, train_appearance
from sira_assets.train.batches import SampleTensors, open_stack, write_stack
from sira_assets.train.loop import digest
from sira_assets.train.parallel import Share, joined_share
from sira_assets.train.scenes import SampleConfig, load_samples, sample_files, scenes_digest
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
    scenes: Sequence[Path],
    out: Path,
    run: Path,
    *,
    config: PriorConfig = PriorConfig(),
    device: str | torch.device = "cpu",
    resume: bool = False,
    workers: int = 2,
    stacks: Path | None = None,
    progress=None,
) -> Prior:
    """Train both models on the scenes below some folders and write the prior to `out`.

    Started by torchrun, the processes share every step.

    Parameters
    ----------
    scenes : folders of scenes with gt/mesh.ply and gt/landmarks.json: generated ones, imported scans, or both
    run : folder of checkpoints, loss curves and stacked samples; `resume` goes on from it exactly
    stacks : folder of stacked samples, where several runs share them; `run` if None
    progress : a rich Progress, or None

    Raises
    ------
    InputError : no scenes, or scenes without truth.
    """
    with joined_share(device) as share:
        progress = progress if share.leads else None
        data, scenes_are = _samples(scenes, Path(stacks or run), config, workers, progress, share)
        if torch.device(device).type == "cuda" and _bytes(data) < 0.5 * torch.cuda.mem_get_info()[0]:
            data = data.to(device)
        log = TrainingLog(Path(run) / "curves.jsonl", progress)
        shape, codes, shape_seconds = train_shape(
            data,
            run,
            model_config=config.shape_model,
            config=config.shape,
            device=device,
            resume=resume,
            scenes_digest=scenes_are,
            share=share,
            report=log.reporter("shape", config.shape.steps),
        )
        appearance, appearance_codes, appearance_seconds = train_appearance(
            data,
            shape,
            codes,
            run,
            model_config=config.appearance_model,
            config=config.appearance,
            device=device,
            resume=resume,
            scenes_digest=scenes_are,
            share=share,
            report=log.reporter("appearance", config.appearance.steps),
        )
        tables = (codes.z_sdf, codes.z_r, appearance_codes.z_a, appearance_codes.z_s, appearance_codes.z_l)
        prior = Prior(shape.cpu(), appearance.cpu(), *(CodeStatistics.of(table.detach().cpu()) for table in tables))
        if share.leads:
            description = {
                "scenes": len(data),
                "scenes_sha256": scenes_are,
                "config": asdict(config),
                "seconds_shape": round(shape_seconds),
                "seconds_appearance": round(appearance_seconds),
                "processes": share.size,
                "threads": torch.get_num_threads(),
                "device": str(device),
                "version": __version__,
            }
            save_prior(prior, out, description)
            write_text(Path(run) / "description.json", json.dumps(description, indent=1))
    return prior


def _samples(
    scenes: Sequence[Path], stacks: Path, config: PriorConfig, workers: int, progress, share: Share
) -> tuple[SampleTensors, str]:
    """All scenes' samples, memory-mapped, and the digest of the scenes; drawn by the first process only."""
    seed = config.shape.seed
    names = [path.name for path in sample_files(scenes, config.samples, seed)]
    stacked = stacks / f"samples-{digest(names)}"
    if share.leads:
        task = progress.add_task("samples", total=len(names)) if progress is not None else None
        advance = (lambda: progress.advance(task)) if progress is not None else (lambda: None)
        stored = load_samples(scenes, config=config.samples, seed=seed, workers=workers, progress=advance)
        write_stack(stored, stacked)
    share.wait()
    return open_stack(stacked), scenes_digest(scenes)


def _bytes(data: SampleTensors) -> int:
    return sum(getattr(data, f.name).numel() * getattr(data, f.name).element_size() for f in fields(data))
