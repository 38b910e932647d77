"""Relight an exported avatar: stills and turntables under other light, with its material edited.

AVATAR is a folder that export_avatar.py wrote, or a .glb. Light is a lights.json or a panorama (.exr, .hdr), in the
avatar's world; without --lights, the light that was found in its photo. --out names a picture (.png, .exr), a movie
(.webp, .mp4) or a folder for all of them.

    python tools/relight.py avatar --lights studio.hdr --out relit.png
    python tools/relight.py avatar --lights lights.json --rotate 36 --out turntable.webp
    python tools/relight.py avatar --orbit 48 --roughness 0.3 --albedo-tint 1,0.9,0.8 --out relit
"""

import argparse
import sys
from pathlib import Path

import _cli

STILLS, MOVIES = (".png", ".exr"), (".webp", ".mp4")
MARKER = "relight.json"


def tint(text: str) -> tuple[float, ...]:
    """Three factors "r,g,b"."""
    values = tuple(float(v) for v in text.split(","))
    if len(values) != 3:
        raise argparse.ArgumentTypeError("three numbers r,g,b")
    return values


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(
        prog="relight.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", type=Path, metavar="AVATAR", help="exported folder or .glb")
    p.add_argument("--out", type=Path, required=True, help="picture, movie or folder to write")
    p.add_argument("--overwrite", action="store_true", help="replace what --out holds")
    light = p.add_argument_group("light")
    light.add_argument("--lights", type=Path, metavar="FILE", help="lights.json, or a lat-long panorama .exr or .hdr")
    light.add_argument("--azimuth", type=float, default=0.0, metavar="DEG", help="turn the light first")
    light.add_argument("--light-gain", type=float, default=1.0, metavar="G", help="factor on the light")
    light.add_argument("--shadows", action=argparse.BooleanOptionalAction, default=True, help="cast shadows")
    moves = p.add_argument_group("turntable").add_mutually_exclusive_group()
    moves.add_argument("--rotate", type=int, metavar="N", help="N frames; the light goes once round the head")
    moves.add_argument("--orbit", type=int, metavar="N", help="N frames; the camera goes once round the head")
    p.add_argument("--fps", type=float, default=18.0, help="frames a second (default: 18)")
    camera = p.add_argument_group("camera")
    chosen = camera.add_mutually_exclusive_group()
    chosen.add_argument("--camera", type=Path, metavar="transforms.json", help="default: the portrait's own")
    chosen.add_argument("--framed", action="store_true", help="the whole avatar from the front, instead")
    camera.add_argument("--frame", type=int, default=0, metavar="I", help="which of its frames (default: 0)")
    camera.add_argument("--size", type=int, metavar="PX", help="longest side, 16 to 4096 (default: the camera's)")
    material = p.add_argument_group("material")
    material.add_argument("--specular-scale", type=float, default=1.0, metavar="S", help="0 for none")
    material.add_argument("--roughness", type=float, metavar="R", help="0.05 to 1, in place of the avatar's")
    material.add_argument("--albedo-gain", type=float, default=1.0, metavar="G")
    material.add_argument("--albedo-tint", type=tint, default=(1.0, 1.0, 1.0), metavar="R,G,B", help="linear factors")
    look = p.add_argument_group("picture")
    look.add_argument("--background", choices=["none", "black", "grey", "panorama"], default="black")
    look.add_argument("--exposure", type=float, default=0.0, metavar="EV", help="stops, on PNG, WebP and MP4")
    look.add_argument("--quality", choices=["draft", "standard", "high"], default="standard")
    look.add_argument("--samples", type=int, metavar="K", help="K x K samples a pixel, 1 to 8; overrides --quality's")
    look.add_argument("--shadow-rays", type=int, metavar="N", help="for every pixel; overrides --quality's")
    look.add_argument("--sira-diffuse", action="store_true", help="leave out glTF's 1 - F on the diffuse lobe")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--json", action="store_true", help="print what was done as JSON")
    p.add_argument("--quiet", action="store_true", help="no progress bar")
    return p


def body(args: argparse.Namespace) -> int:
    """Read, render, write."""
    import json
    from dataclasses import replace

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from sira_assets.relight.cameras import framing_camera, portrait_camera, with_longest_side
    from sira_assets.relight.frame import GREY, Backdrop, encode_frame
    from sira_assets.relight.glb_model import read_avatar
    from sira_assets.relight.light_source import LightSource, own_light, read_light_source
    from sira_assets.relight.material_edit import MaterialEdit, edit_material
    from sira_assets.relight.movie import check_movie
    from sira_assets.relight.turntable import QUALITIES, Turn, render_turn
    from sira_assets.scene.transforms_json import read_camera

    check_out(args)
    if args.out.suffix.lower() in MOVIES:
        check_movie(args.out)
    edit = MaterialEdit(args.specular_scale, args.roughness, args.albedo_gain, args.albedo_tint)
    model = edit_material(read_avatar(args.avatar), edit)
    if args.framed:
        camera, looked = framing_camera(model, args.size or 512), "framing the head"
    elif args.camera is None:
        camera, own = portrait_camera(model, size=args.size)
        looked = "the portrait's" if own else "framing the head"
    else:
        camera = with_longest_side(read_camera(args.camera, frame=args.frame), args.size)
        looked = f"{args.camera.name}, frame {args.frame}"
    source = read_light_source(args.lights) if args.lights else LightSource(own_light(model), None, "the avatar's own")
    if args.background == "panorama" and source.panorama is None:
        from sira_assets.scene.envmap import envmap_from_sg

        source = replace(source, panorama=envmap_from_sg(source.light, 256))
    source = source.scaled(args.light_gain)
    quality = QUALITIES[args.quality]
    quality = replace(quality, supersample=args.samples or quality.supersample, rays=args.shadow_rays or quality.rays)
    turn = Turn(args.rotate or args.orbit or 1, "camera" if args.orbit else "light", args.azimuth)
    backdrop = {"black": Backdrop(0.0), "grey": Backdrop(GREY), "panorama": Backdrop(None, source.panorama)}
    backdrop = backdrop.get(args.background, Backdrop())

    columns = (TextColumn("{task.description:16}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    frames, pictures = [], []
    with Progress(*columns, console=Console(stderr=True), disable=args.quiet or args.json) as progress:
        task = progress.add_task("frames" if turn.frames > 1 else "render", total=turn.frames)
        rendered = render_turn(
            model,
            camera,
            source.light,
            turn,
            quality,
            shadows=args.shadows,
            gltf_weighting=not args.sira_diffuse,
            seed=args.seed,
            report=lambda done: progress.update(task, completed=done),
        )
        for frame in rendered:
            pictures.append(encode_frame(frame, backdrop, exposure=args.exposure))
            frames = frames or [frame]  # the linear picture is kept of the first only
    said = {
        "avatar": args.avatar.name,
        "light": source.note,
        "camera": looked,
        "size": [camera.width, camera.height],
        "frames": turn.frames,
        "moves": turn.moves if turn.frames > 1 else "nothing",
        "azimuth_deg": args.azimuth,
        "light_gain": args.light_gain,
        "shadows": args.shadows,
        "supersample": quality.supersample,
        "shadow_rays": quality.rays,
        "gltf_weighting": not args.sira_diffuse,
        "specular_scale": edit.specular_scale,
        "roughness": edit.roughness,
        "albedo_gain": edit.albedo_gain,
        "albedo_tint": list(edit.albedo_tint),
        "exposure_ev": args.exposure,
        "seed": args.seed,
    }
    text = json.dumps(said, indent=1)
    write_out(args.out, frames[0], pictures, text, args.fps)
    if args.json:
        print(text)
    elif not args.quiet:
        print(f"{args.out}  ({source.note}; camera {looked})")
    return 0


def check_out(args: argparse.Namespace) -> None:
    """Refuse to write over anything that was not said to go, before any work is done."""
    if args.out.suffix.lower() in (*STILLS, *MOVIES):
        from sira_assets.atomic import check_file

        check_file(args.out, overwrite=args.overwrite)
    else:
        from sira_assets.delivery import check_target

        check_target(args.out, overwrite=args.overwrite, marker=MARKER, holds="relit pictures")


def write_out(out: Path, first, pictures: list, text: str, fps: float) -> None:
    """One file, or a folder of all: whole or not at all."""
    from sira_assets.atomic import replacing_folder, write_text
    from sira_assets.relight.frame import linear_rgba
    from sira_assets.relight.movie import write_movie
    from sira_assets.scene.image import write_exr, write_png

    suffix = out.suffix.lower()
    if suffix == ".exr":
        write_exr(out, linear_rgba(first.render))
    elif suffix == ".png":
        write_png(out, pictures[0])
    elif suffix in MOVIES:
        write_movie(out, pictures, fps=fps)
    else:
        with replacing_folder(out) as fresh:
            if len(pictures) == 1:
                write_png(fresh / "relit.png", pictures[0])
                write_exr(fresh / "relit.exr", linear_rgba(first.render))
            else:
                for i, picture in enumerate(pictures):
                    write_png(fresh / "frames" / f"{i:03d}.png", picture)
                write_movie(fresh / "turntable.webp", pictures, fps=fps)
                write_mp4_beside(fresh / "turntable.mp4", pictures, fps)
            write_text(fresh / MARKER, text + "\n")


def write_mp4_beside(path: Path, pictures: list, fps: float) -> None:
    """A folder's MP4, which is an extra: without an ffmpeg that can make it, frames and WebP are kept all the same."""
    from sira_assets.errors import InputError
    from sira_assets.relight.movie import ffmpeg, write_movie

    if ffmpeg() is None:
        return
    try:
        write_movie(path, pictures, fps=fps)
    except InputError as error:
        print(f"note: no {path.name}: {error}", file=sys.stderr)


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0, 2 usage, 3 bad input, 130 interrupted."""
    p = parser()
    args = p.parse_args(argv)
    turning = args.rotate is not None or args.orbit is not None
    if turning and (args.rotate or args.orbit or 0) < 2:
        p.error("--rotate and --orbit want at least 2 frames")
    if turning and args.out.suffix.lower() in STILLS:
        p.error("a turntable is written as .webp, .mp4 or a folder")
    if not turning and args.out.suffix.lower() in MOVIES:
        p.error("a movie wants --rotate N or --orbit N")
    if args.background == "none" and args.out.suffix.lower() == ".mp4":
        p.error("--background none: MP4 has no transparency; name the file .webp, or a folder")
    if args.size is not None and not 16 <= args.size <= 4096:
        p.error("--size must be 16 to 4096")
    if args.samples is not None and not 1 <= args.samples <= 8:
        p.error("--samples must be 1 to 8")
    if args.shadow_rays is not None and not 1 <= args.shadow_rays <= 65536:
        p.error("--shadow-rays must be 1 to 65536")
    if not (args.light_gain >= 0 and 0.1 <= args.fps <= 120 and abs(args.exposure) <= 40 and args.seed >= 0):
        p.error("--light-gain and --seed must be 0 or more, --fps 0.1 to 120, --exposure -40 to 40")
    return _cli.run(lambda: body(args))


if __name__ == "__main__":
    sys.exit(main())
