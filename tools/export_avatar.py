"""Turn one portrait into a relightable avatar: GLB, OBJ, textures, lights, renders and a report.

With no argument the bundled real portrait is used. A scene is a folder with transforms.json (or cameras.npz); a bare
photo needs --landmarks and --mask.

    python tools/export_avatar.py
    python tools/export_avatar.py SCENE_DIR --out avatar --quality draft
    python tools/export_avatar.py photo.jpg --mask mask.png --landmarks landmarks.json
    python tools/export_avatar.py SCENE_DIR --budget 60s
"""

import argparse
import re
import sys
import time
from pathlib import Path

import _cli

# Those every avatar has are not listed. Written out here since --help imports nothing.
FURTHER_MAPS = ("occlusion", "position", "visibility", "radiance")


def _size(text: str) -> int | None:
    return None if text == "auto" else int(text)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("scene", nargs="?", type=Path, help="scene folder or photo (default: the bundled portrait)")
    p.add_argument("--out", type=Path, default=Path("avatar"), help="folder to write (default: avatar)")
    how = p.add_mutually_exclusive_group()
    how.add_argument("--quality", choices=["draft", "standard", "high"], default="standard")
    how.add_argument(
        "--budget",
        type=duration,
        metavar="TIME",
        help="be done within this time (60s, 5min) with as much accuracy as it buys on this machine",
    )
    p.add_argument("--figures", type=Path, metavar="FILE", help="curves to plan with, of measure_tradeoff.py")
    p.add_argument("--dry-run", action="store_true", help="print what would be done, its seconds and memory, and stop")
    p.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--mask", type=Path, help="white on the head; overrides the scene's")
    p.add_argument("--landmarks", type=Path, help="JSON with landmarks_2d or landmarks_m; overrides the scene's")
    focal = p.add_mutually_exclusive_group()
    focal.add_argument("--focal-px", type=float, help="focal length in pixels; overrides the scene's")
    focal.add_argument("--fov", type=float, dest="fov_deg", metavar="DEG", help="horizontal field of view instead")
    p.add_argument(
        "--texture-size",
        type=_size,
        default=None,
        metavar="N",
        help="texels a side, 64 to 8192; auto, the default: what the photo fills",
    )
    p.add_argument("--maps", type=_names, default=(), metavar="A,B", help="further maps: " + ", ".join(FURTHER_MAPS))
    fineness = p.add_mutually_exclusive_group()
    fineness.add_argument("--max-triangles", type=int, help="at least 100")
    fineness.add_argument(
        "--tolerance",
        type=millimetres,
        dest="tolerance_mm",
        metavar="MM",
        help="as many triangles as keep the mesh this near the fitted surface (0.5mm), 0.05 to 5 (eyes 63 mm apart)",
    )
    p.add_argument("--levels-of-detail", type=int, default=0, metavar="N", help="N coarser avatars too, 0 to 4")
    p.add_argument("--open-bust", action="store_true", help="no caps where the head's box cuts the shoulders")
    p.add_argument("--no-shadows", dest="shadows", action="store_false", help="light without the head's cast shadows")
    p.add_argument(
        "--everything",
        action="store_true",
        help="keep lobes, highlights, shadows that the photo can do without; 1024 texels a side unless asked",
    )
    p.add_argument(
        "--reproducible",
        action="store_true",
        help="the same bytes each time: charts by xatlas, which cuts more of them (UVAtlas draws its own seed)",
    )
    p.add_argument("--specular-form", choices=["color", "factor"], default="color", help="where the GLB keeps F0")
    p.add_argument("--quantize", action="store_true", help="GLB geometry as integers: half the size, 0.01 mm steps")
    p.add_argument("--jpeg", type=int, metavar="QUALITY", help="GLB colours as JPEG, 1 to 100 (default: PNG)")
    p.add_argument("--usd", action="store_true", help="write avatar.usdc and .usdz too (extra usd)")
    p.add_argument("--prior", type=Path, help="trained models (default: the ones that ship with the package)")
    p.add_argument("--resume", action="store_true", help="go on where a stopped run was, inside a fit too")
    p.add_argument("--overwrite", action="store_true", help="replace what --out holds")
    p.add_argument("--json", action="store_true", help="print report.json")
    p.add_argument("--quiet", action="store_true", help="no progress bar")
    return p


def millimetres(text: str) -> float:
    """Of 0.5, 0.5mm or 0.0005m."""
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(mm|m)?", text.strip())
    if not found:
        raise argparse.ArgumentTypeError(f"a length such as 0.5mm, not {text!r}")
    return float(found[1]) * (1000.0 if found[2] == "m" else 1.0)


def duration(text: str) -> float:
    """Seconds of 90, 90s, 1.5min or 0.1h."""
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(s|sec|m|min|h)?", text.strip())
    seconds = float(found[1]) * {"m": 60.0, "min": 60.0, "h": 3600.0}.get(found[2], 1.0) if found else 0.0
    if not 0.0 < seconds < 1e6:
        raise argparse.ArgumentTypeError(f"a time such as 60s or 5min, not {text!r}")
    return seconds


def body(args: argparse.Namespace) -> int:
    """Read, fit, export."""
    began = time.monotonic()
    import contextlib
    import json
    import shutil
    from dataclasses import replace

    from sira_assets.scene.bundled import bundled_portrait
    from sira_assets.scene.read_scene import read_scene

    options = {n: getattr(args, n) for n in ("mask", "landmarks", "focal_px", "fov_deg")}
    if args.scene is None:
        portrait = bundled_portrait(**options)
    else:
        portrait = read_scene(args.scene, **options)

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from sira_assets.asset.export_config import ExportConfig
    from sira_assets.asset.usd import check_usd
    from sira_assets.delivery import check_target, deliver
    from sira_assets.fields.prior import load_prior
    from sira_assets.measure.report import report_dict
    from sira_assets.pipeline import run, settings_for

    device = _cli.device(args.device)
    settings = settings_for(
        args.quality,
        texture_size=args.texture_size,
        maps=args.maps,
        max_triangles=args.max_triangles,
        tolerance_mm=args.tolerance_mm,
        levels_of_detail=args.levels_of_detail,
        open_bust=args.open_bust,
        shadows=args.shadows,
        everything=args.everything,
        reproducible=args.reproducible,
        seed=args.seed,
    )
    export = ExportConfig(args.specular_form, quantise=args.quantize, jpeg_quality=args.jpeg, usd=args.usd)
    settings = replace(settings, export=export)
    if args.usd:
        check_usd()
    check_target(args.out, overwrite=args.overwrite)
    prior = load_prior(args.prior)
    plan, timetable, keeping = None, None, None
    if args.budget or args.dry_run:
        from _export_plan import asked_plan, print_plan

        plan, timetable, keeping = asked_plan(args, settings, prior, began, device=device)
        settings = plan.settings
        if args.dry_run or not (args.quiet or args.json):
            print_plan(plan, as_json=args.json and args.dry_run)
        if args.dry_run:
            return 0
    args.out = args.out.resolve()
    work = args.out.parent / f".{args.out.name}-work"
    if not args.resume:
        shutil.rmtree(work, ignore_errors=True)
    if timetable is None:
        work.mkdir(parents=True, exist_ok=True)
    columns = (TextColumn("{task.description:16}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    tasks: dict[str, object] = {}
    with Progress(*columns, console=Console(stderr=True), disable=args.quiet or args.json) as progress:

        def report(stage: str, done: int, steps: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=steps)
            progress.update(tasks[stage], completed=done, total=steps)

        try:
            kept = work if timetable is None else None
            journey = run(portrait, settings, prior=prior, work=kept, device=device, timetable=timetable, report=report)
        except KeyboardInterrupt:
            if kept:
                print(f"stopped; the same command with --resume goes on ({work})", file=sys.stderr)
            raise
        finally:
            # A portrait that the fit refuses leaves nothing to go on with.
            with contextlib.suppress(OSError):
                work.rmdir()
    decisions = ()
    if plan is not None:
        from sira_assets.plan.present import plan_decisions

        decisions = plan_decisions(plan, keeping, time.monotonic() - began)
    made = deliver(journey, journey.settings, args.out, decisions=decisions)
    shutil.rmtree(work, ignore_errors=True)
    if args.json:
        print(json.dumps(report_dict(made), indent=1))
    elif not args.quiet:
        headline = ", ".join(f"{m.label} {m.value:.{m.digits}f} {m.unit}".strip() for m in made.metrics if m.headline)
        seconds = time.monotonic() - began
        print(f"{args.out / 'avatar.glb'}  ({headline}; {seconds:.0f} s)  see {args.out / 'report.html'}")
    for line in made.warnings if not (args.quiet or args.json) else ():
        print(f"note: {line}", file=sys.stderr)
    return 0


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0, 2 usage, 3 bad input, 130 interrupted (go on with --resume)."""
    p = parser()
    args = p.parse_args(argv)
    if args.texture_size is not None and not 64 <= args.texture_size <= 8192:
        p.error("--texture-size must be 64 to 8192")
    if args.max_triangles is not None and args.max_triangles < 100:
        p.error("--max-triangles must be at least 100")
    if args.tolerance_mm is not None and not 0.05 <= args.tolerance_mm <= 5.0:
        p.error("--tolerance must be 0.05 to 5")
    if not 0 <= args.levels_of_detail <= 4:
        p.error("--levels-of-detail must be 0 to 4")
    if args.seed < 0:
        p.error("--seed must be at least 0")
    if args.budget and args.resume:
        p.error("--resume: steps within a --budget depend on the clock, so such a run cannot be gone on with")
    for given in ("texture_size", "max_triangles", "tolerance_mm"):
        if args.budget and getattr(args, given) is not None:
            p.error(f"--{given.removesuffix('_mm').replace('_', '-')}: a --budget chooses it")
    return _cli.run(lambda: body(args))


if __name__ == "__main__":
    sys.exit(main())
