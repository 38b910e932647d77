#!/usr/bin/env python3
"""Write synthetic head scenes with exact truth: pictures, masks, cameras, lights, geometry and materials.

A scene depends only on the kind, the seed, its index and the settings, so a run may be stopped (Ctrl-C), resumed by
the same command, split over machines with --start, or spread over any number of workers: the bytes stay the same.
"""

import argparse
import sys
from pathlib import Path

from _cli import run


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(prog="make_scenes.py", description=__doc__.split("\n\n")[0])
    out.add_argument("--count", type=int, required=True, metavar="N", help="scenes to have, from --start on")
    out.add_argument("--out", type=Path, default=Path("scenes"), metavar="DIR", help="folder of scenes; made if absent")
    out.add_argument("--start", type=int, default=0, metavar="INDEX", help="index of the first scene (default 0)")
    out.add_argument("--kind", choices=("train", "eval"), default="train", help="eval heads are never train heads")
    out.add_argument("--seed", type=int, default=0, help="default 0")
    out.add_argument("--views", type=int, default=8, help="pictures a scene, the first a portrait (default 8)")
    out.add_argument("--size", type=int, default=256, help="width and height in pixels (default 256)")
    out.add_argument("--samples", type=int, default=64, help="light directions a sample point (default 64)")
    out.add_argument("--supersample", type=int, default=1, help="sample points a pixel: 1, 4, 9, 16 (default 1)")
    out.add_argument("--truth", choices=("full", "train"), default="full", help="train: only what training reads")
    out.add_argument("--workers", type=int, default=2, help="processes, one thread each (default 2)")
    out.add_argument("--preview", action="store_true", help="also write DIR/preview.png, a contact sheet")
    out.add_argument("--quiet", action="store_true", help="no progress bar and no summary")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: make_scenes(arguments))


def make_scenes(arguments: argparse.Namespace) -> int:
    """Write the scenes that are missing, with a progress bar on stderr."""
    from data_synth.dataset import claim_folder, write_dataset
    from data_synth.scene_settings import SceneSettings, scene_name
    from sira_assets.errors import InputError

    if arguments.count < 1 or arguments.start < 0 or arguments.workers < 1:
        raise InputError(
            expected="--count and --workers of at least 1 and --start of at least 0",
            received=f"--count {arguments.count} --workers {arguments.workers} --start {arguments.start}",
            remedy="give such numbers",
        )
    settings = SceneSettings(
        kind=arguments.kind,
        seed=arguments.seed,
        views=arguments.views,
        size=arguments.size,
        samples=arguments.samples,
        supersample=arguments.supersample,
        truth=arguments.truth,
    )
    indices = range(arguments.start, arguments.start + arguments.count)
    claim_folder(arguments.out, settings)  # here, so that a refusal is not printed into the progress bar

    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True, quiet=arguments.quiet)
    columns = (
        TextColumn("scenes"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(elapsed_when_finished=False),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("scenes", total=len(indices))
        written = write_dataset(
            arguments.out,
            settings,
            indices,
            workers=arguments.workers,
            on_scene=lambda name, seconds: progress.advance(task),
        )
    if arguments.preview:
        from data_synth.dataset_preview import write_contact_sheet

        folders = [arguments.out / scene_name(settings, index) for index in indices]
        write_contact_sheet(folders, arguments.out / "preview.png")
    console.print(f"{written} scenes written, {len(indices) - written} were there: {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
