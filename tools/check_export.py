"""Read an exported avatar back with every other program at hand and compare what they understood.

    python tools/check_export.py DIR
    python tools/check_export.py DIR --blender BLENDER --picture sheet.png     # pictures by Blender's Cycles, too
    python tools/check_export.py DIR --validator node_modules                  # Khronos's validator

trimesh and Open3D are always at hand; usd-core comes with the extra `usd`; BLENDER is Blender's program or a Python
with the module bpy (which wants another NumPy than this project, hence a virtual environment of its own); the validator
is npm's gltf-validator. SIRA_BLENDER and SIRA_GLTF_VALIDATOR name them as well.

Exit status: 0 all agree, 3 unusable input, 4 some program disagrees.
"""

import argparse
import os
import sys
from pathlib import Path

import _cli

# A half step of 16-bit positions, the coarsest form that is written, is 7.6e-6 of the head; float32 adds little.
MAX_BOX_ERROR = 1e-5
# Codes; JPEG's quality 90 leaves 2 on average.
MAX_COLOUR_ERROR = 3.0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("folder", type=Path, help="what export_avatar.py wrote")
    p.add_argument("--blender", default=os.environ.get("SIRA_BLENDER"), help="Blender, or a Python with bpy")
    p.add_argument("--validator", type=Path, default=os.environ.get("SIRA_GLTF_VALIDATOR"), metavar="NODE_MODULES")
    p.add_argument("--picture", type=Path, metavar="PNG", help="contact sheet; needs Blender")
    p.add_argument("--size", type=int, default=256, help="its pictures' longest side (default: 256)")
    p.add_argument("--samples", type=int, default=32, help="Cycles' samples a pixel (default: 32)")
    p.add_argument("--threads", type=int, default=1, help="Cycles' threads (default: 1)")
    p.add_argument("--json", action="store_true", help="print the figures as JSON")
    return p


def figures(reading, reference) -> dict:
    """How far a reading is from the reference: box and foremost point by the box's largest side, volume, colour."""
    import numpy as np

    def box(corners):
        return np.stack([corners.min((0, 1)), corners.max((0, 1))])

    def volume(corners):
        # About the reference's middle, so that an open mesh's figure does not depend on the origin.
        a, b, c = np.moveaxis(corners - box(reference.corners).mean(0), 1, 0)
        return float((a * np.cross(b, c)).sum() / 6)

    side = np.ptp(box(reference.corners), axis=0).max()
    out = {
        "program": reading.program,
        "file": reading.file,
        "triangles": len(reading.corners),
        "box_error": float(np.abs(box(reading.corners) - box(reference.corners)).max() / side),
        "volume_ratio": volume(reading.corners) / volume(reference.corners),
        "colour_error": colour_error(reading, reference),
        "pictures": list(reading.pictures),
    }
    agrees = out["box_error"] <= MAX_BOX_ERROR and abs(out["volume_ratio"] - 1) < 1e-3
    agrees &= len(reading.corners) == len(reference.corners)
    agrees &= (out["colour_error"] is None) == (reference.base is None)
    out["agrees"] = bool(agrees and (out["colour_error"] or 0.0) <= MAX_COLOUR_ERROR)
    return out


def colour_error(reading, reference) -> float | None:
    """Mean difference in codes of the base colour at the middle of each triangle and of its nearest one; None without.

    A picture that is flipped, turned or on another part of the surface shows here.
    """
    from scipy.spatial import cKDTree

    if reading.base is None or reference.base is None:
        return None
    import numpy as np

    nearest = cKDTree(reading.corners.mean(1)).query(reference.corners.mean(1))[1]
    ours, theirs = looked_up(reference), looked_up(reading)[nearest]
    return float(np.abs(ours.astype(float) - theirs).mean())


def looked_up(reading):
    """(F, 3) codes at the triangles' middles; the nearest texel."""
    import numpy as np

    height, width = reading.base.shape[:2]
    u, v = reading.uv.mean(1).T
    row = np.clip(((1 - v) * height).astype(int), 0, height - 1)
    return reading.base[row, np.clip((u * width).astype(int), 0, width - 1)]


def readings(folder: Path, required: list[str]) -> list:
    """What the programs inside this Python read; those not installed, and files not there, are left out."""
    import importlib.util

    import _readers

    out = []
    # What a file requires, trimesh and Open3D do not look at: they would take codes for positions.
    names = ("avatar.obj",) if required else ("avatar.glb", "avatar.obj")
    with _readers.quiet():
        for path in (folder / name for name in names if (folder / name).is_file()):
            out += [_readers.by_trimesh(path), _readers.by_open3d(path)]
        if importlib.util.find_spec("pxr"):
            out += [_readers.by_usd(p) for p in (folder / "avatar.usdc", folder / "avatar.usdz") if p.is_file()]
    return out


def render_figures(blender: list, glb: Path, camera) -> tuple[list, object]:
    """Blender's pictures against the project's own render of the GLB, dB in the mask, sRGB-encoded; and that render."""
    from sira_assets.measure.image_metrics import score_image
    from sira_assets.relight.glb_model import read_glb
    from sira_assets.relight.light_source import own_light
    from sira_assets.relight.render import render_asset

    model = read_glb(glb)
    made = render_asset(model, camera, own_light(model), shadows=True)
    both = [(made.alpha == 1) & (r.render[..., 3] > 0.999) for r in blender]
    scores = [score_image(r.render[..., :3], made.radiance, m).psnr_db for r, m in zip(blender, both, strict=True)]
    return scores, made.radiance


def body(args: argparse.Namespace) -> int:
    """Read, compare, print."""
    import json

    import _readers

    from sira_assets.errors import InputError
    from sira_assets.relight.cameras import portrait_camera
    from sira_assets.relight.glb_model import read_avatar

    folder = args.folder
    model = read_avatar(folder)
    if args.picture and not args.blender:
        raise InputError(
            expected="Blender, to draw by", received="--picture alone", remedy="give --blender or SIRA_BLENDER"
        )
    reference = _readers.by_us(folder / "avatar.glb")
    required = _readers.required_extensions(folder / "avatar.glb")
    found, sheet, scores = readings(folder, required), None, []
    if args.blender:
        names = ("avatar.glb", "avatar.obj", "avatar.usdc", "avatar.usdz")
        files = [folder / n for n in names if (folder / n).is_file()]
        camera = portrait_camera(model, size=args.size)[0]
        said = {
            "intrinsics": camera.intrinsics.tolist(),
            "world_from_camera": camera.world_from_camera.tolist(),
            "width": camera.width,
            "height": camera.height,
        }
        blender = _readers.by_blender(
            files,
            args.blender,
            camera=said if args.picture else None,
            envmap=folder / "envmap.exr" if args.picture else None,
            samples=args.samples,
            threads=args.threads,
        )
        found += blender
        if args.picture:
            scores, own = render_figures(blender, folder / "avatar.glb", camera)
            sheet = [own, *(r.render[..., :3] for r in blender)]
    rows = [figures(r, reference) for r in found]
    for row, score in zip(rows[len(rows) - len(scores) :], scores, strict=True):
        row["render_psnr_db"] = score
    made = {"reference": f"{len(reference.corners)} triangles", "extensions_required": required, "readings": rows}
    if args.validator:
        made["validator"] = _readers.by_khronos(folder / "avatar.glb", args.validator)
    if sheet:
        import numpy as np

        from sira_assets.numerics.colour import srgb_from_linear
        from sira_assets.scene.image import write_png

        write_png(args.picture, srgb_from_linear(np.clip(np.concatenate(sheet, 1), 0, 1)))
    if args.json:
        print(json.dumps(made, indent=1))
    else:
        show(made)
    good = all(row["agrees"] for row in rows) and made.get("validator", (0, 0))[:2] in ((0, 0), [0, 0])
    return 0 if good else 4


def show(made: dict) -> None:
    """The figures as lines."""
    print(f"avatar.glb, by the project's own reader: {made['reference']}")
    if made["extensions_required"]:
        print(f"requires {', '.join(made['extensions_required'])}, which trimesh and Open3D do not know: not asked")
    for row in made["readings"]:
        colour = "no picture" if row["colour_error"] is None else f"colour {row['colour_error']:.2f} codes"
        drawn = f", render {row['render_psnr_db']:.1f} dB" if "render_psnr_db" in row else ""
        print(
            f"{row['program']:14} {row['file']:12} {row['triangles']:7} triangles, box {row['box_error']:.1e}, "
            f"volume x {row['volume_ratio']:.6f}, {colour}{drawn}  {'agrees' if row['agrees'] else 'DISAGREES'}"
        )
        for line in row["pictures"]:
            print(f"{'':28}{line}")
    if "validator" in made:
        errors, warnings, codes = made["validator"]
        print(f"Khronos validator: {errors} errors, {warnings} warnings{'; says ' if codes else ''}{', '.join(codes)}")


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 all agree, 2 usage, 3 bad input, 4 some program disagrees."""
    p = parser()
    args = p.parse_args(argv)
    if min(args.size, args.samples, args.threads) < 1:
        p.error("--size, --samples and --threads must be at least 1")
    return _cli.run(lambda: body(args))


if __name__ == "__main__":
    sys.exit(main())
