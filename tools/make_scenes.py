#!/usr/bin/env python3
"""Write synthetic head scenes with exact truth: pictures, masks, cameras, lights, geometry and materials.

A scene depends only on the kind, the seed, its index and the settings, so a run may be stopped (Ctrl-C, or killed),
resumed by the same command, split over machines with --start, or spread over any number of workers, here or by Dask:
the bytes stay the same. DIR/datasheet.html describes all scenes in DIR.

--from-scan renders a head of your own instead: --count scenes of it, each with its own pose, cameras and light. It
needs landmarks: the nine canonical names in a JSON file, 68 in iBUG's order, or MeshLab's picked points (.pp).
"""

import argparse
import sys
from pathlib import Path

from _cli import run


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="make_scenes.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("--count", type=int, required=True, metavar="N", help="scenes to have, from --start on")
    out.add_argument("--out", type=Path, default=Path("scenes"), metavar="DIR", help="folder of scenes; made if absent")
    out.add_argument("--start", type=int, default=0, metavar="INDEX", help="index of the first scene (default 0)")
    out.add_argument(
        "--kind", choices=("train", "eval"), help="eval heads are never train heads (default train; none of a scan)"
    )
    out.add_argument("--seed", type=int, default=0, help="default 0")
    out.add_argument("--views", type=int, default=8, help="pictures a scene, the first a portrait (default 8)")
    out.add_argument("--size", type=int, default=256, help="width and height in pixels (default 256)")
    out.add_argument("--samples", type=int, default=64, help="light directions a sample point (default 64)")
    out.add_argument("--supersample", type=int, default=1, help="sample points a pixel: 1, 4, 9, 16 (default 1)")
    out.add_argument(
        "--panorama",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="light every scene by one of these .exr or .hdr lat-long panoramas, turned about the vertical at random",
    )
    out.add_argument(
        "--plain",
        action="store_true",
        help="pass over heads with hats, scarves, beards, afros, and hair that hangs, is tied or hides the forehead; "
        "--count is of those left, so that runs with different --start may overlap, which costs time alone",
    )
    out.add_argument(
        "--crops", type=float, default=0.0, metavar="SHARE", help="of scenes that cut the head (default 0)"
    )
    out.add_argument(
        "--occluders", type=float, default=0.0, metavar="SHARE", help="of scenes with a hand or thing before the face"
    )
    out.add_argument("--truth", choices=("full", "train"), default="full", help="train: only what training reads")
    out.add_argument("--workers", type=int, default=2, help="processes, one thread each (default 2)")
    out.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run on this Dask cluster instead, such as tcp://10.0.0.1:8786; its workers must see DIR (and a scan's "
        "files) under the same path",
    )
    out.add_argument("--preview", action="store_true", help="also write DIR/preview.png, a contact sheet")
    out.add_argument("--quiet", action="store_true", help="no progress bar and no summary")
    scan = out.add_argument_group("a scan of your own")
    scan.add_argument("--from-scan", type=Path, metavar="MESH", help="PLY, OBJ, GLB or whatever trimesh reads")
    scan.add_argument("--scan-landmarks", type=Path, metavar="FILE", help="default: landmarks.json beside MESH")
    scan.add_argument("--scan-texture", type=Path, metavar="PICTURE", help="default: what MESH names, or its colours")
    scan.add_argument("--scan-name", metavar="NAME", help="scenes' name (default: MESH's, or its folder's)")
    scan.add_argument("--scan-pieces", choices=("all", "largest"), help="default: all but dust")
    scan.add_argument(
        "--metres-per-unit", type=float, metavar="M", help="length of MESH's unit (default: the mean head's size)"
    )
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: make_scenes(arguments))


def scan_source(arguments: argparse.Namespace):
    """The scan that the command line names, or None.

    Raises
    ------
    InputError : options of a scan without one or of other heads with one, or a name that makes no folder.
    """
    from data_synth.scene_settings import ScanSource
    from sira_assets.errors import InputError

    mesh = arguments.from_scan
    if mesh is None:
        names = ("scan_landmarks", "scan_texture", "scan_name", "scan_pieces", "metres_per_unit")
        given = [name for name in names if getattr(arguments, name) is not None]
        if given:
            option = "--" + given[0].replace("_", "-")
            raise InputError(expected=f"--from-scan MESH with {option}", received="none", remedy="give the mesh")
        return None
    if arguments.kind is not None:
        raise InputError(
            expected="either --kind or --from-scan",
            received=f"--kind {arguments.kind} with a scan",
            remedy="leave one of them away",
        )
    mesh = mesh.resolve()
    name = arguments.scan_name or (mesh.parent.name if mesh.stem in ("mesh", "scan", "model") else mesh.stem)
    if not name.replace("-", "").replace("_", "").isalnum() or name in ("train", "eval", "datasheet"):
        raise InputError(
            expected="a name of letters, digits, - and _", received=repr(name), remedy="give one with --scan-name"
        )
    if arguments.metres_per_unit is not None and not 0 < arguments.metres_per_unit < float("inf"):
        raise InputError(
            expected="a positive --metres-per-unit",
            received=f"{arguments.metres_per_unit}",
            remedy="1 for metres, 0.001 for millimetres",
        )
    landmarks = arguments.scan_landmarks or mesh.parent / "landmarks.json"
    for path, option in (
        (mesh, "--from-scan"),
        (landmarks, "--scan-landmarks"),
        (arguments.scan_texture, "--scan-texture"),
    ):
        if path is not None and not path.is_file():
            raise InputError(expected=f"a file {path}", received="no such file", remedy=f"give it with {option}")
    return ScanSource(
        name=name,
        mesh=str(mesh),
        landmarks=str(landmarks.resolve()),
        texture=None if arguments.scan_texture is None else str(arguments.scan_texture.resolve()),
        metres_per_unit=arguments.metres_per_unit,
        pieces=arguments.scan_pieces or "all",
    )


def panorama_file(path: Path, quiet: bool):
    """A panorama, with the spherical gaussians that lights.json will hold for it.

    Raises
    ------
    InputError : it cannot be read, or is black.
    """
    import json

    from data_synth.one_thread import one_thread
    from data_synth.render_panorama import PanoramaSource
    from data_synth.scene_light import PanoramaFile, load_panorama
    from sira_assets.errors import InputError
    from sira_assets.fit.panorama import fit_panorama

    path = path.resolve()
    if not path.is_file():
        raise InputError(expected=f"a panorama {path}", received="no such file", remedy="give it with --panorama")
    envmap = load_panorama(str(path))
    PanoramaSource(envmap)
    found = one_thread(fit_panorama)(envmap)
    if not quiet:
        figures = f"{len(found.light)} gaussians, irradiance off by {100 * found.irradiance_residual:.1f} % RMS"
        print(f"{path.name}: {figures}", file=sys.stderr)
    return PanoramaFile(str(path), json.dumps(found.light.to_dict()))


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
        kind="scan" if arguments.from_scan is not None else arguments.kind or "train",
        seed=arguments.seed,
        views=arguments.views,
        size=arguments.size,
        samples=arguments.samples,
        supersample=arguments.supersample,
        truth=arguments.truth,
        scan=scan_source(arguments),
        crops=arguments.crops,
        occluders=arguments.occluders,
        panoramas=tuple(panorama_file(path, arguments.quiet) for path in arguments.panorama),
    )
    if settings.scan is not None:
        from data_synth.import_scan import scan_subject

        # Here too, so that a refusal is one line and what was done to the scan is said once.
        for note in scan_subject(settings.scan).provenance["scan"]["notes"]:
            if not arguments.quiet:
                print(f"{settings.scan.name}: {note}", file=sys.stderr)
    indices = range(arguments.start, arguments.start + arguments.count)
    if arguments.plain:
        from data_synth.draw_scene import plain_indices

        indices = plain_indices(settings, arguments.start, arguments.count)
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
            scheduler=arguments.scheduler,
            on_scene=lambda name, seconds: progress.advance(task),
        )
    from data_synth.datasheet import write_datasheet

    write_datasheet(arguments.out)
    if arguments.preview:
        from data_synth.dataset_preview import write_contact_sheet

        folders = [arguments.out / scene_name(settings, index) for index in indices]
        write_contact_sheet(folders, arguments.out / "preview.png")
    console.print(f"{written} scenes written, {len(indices) - written} were there: {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
