"""An exported avatar against a scene's path-traced truth: relit without and with shadows, and a picture of both.

SCENE holds relight/image.exr and relight/lights.json. With --novel also from the views in SCENE/novel, under the
avatar's own light, and that light's irradiance against the true one's. With --presets the renderer's own presets are
measured too, against many more samples and rays.

    python tools/measure_relight.py AVATAR SCENE --picture relit.png
"""

import argparse
import sys
from pathlib import Path

import _cli


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(
        prog="measure_relight.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", type=Path, metavar="AVATAR", help="exported folder or .glb")
    p.add_argument("scene", type=Path, metavar="SCENE", help="the scene it was made from")
    p.add_argument(
        "--picture", type=Path, metavar="PNG", help="write without shadows, with shadows, truth, side by side"
    )
    p.add_argument("--novel", action="store_true", help="measure the views in SCENE/novel, and the light")
    p.add_argument("--presets", action="store_true", help="measure draft, standard and high")
    p.add_argument("--json", action="store_true", help="print JSON instead of lines")
    return p


def body(args: argparse.Namespace) -> int:
    """Measure, print, and write the picture."""
    import json

    import numpy as np

    from sira_assets.measure.novel_views import measure_light, measure_novel
    from sira_assets.measure.relit import measure_presets, measure_relit, relit_truth
    from sira_assets.numerics.colour import srgb_from_linear
    from sira_assets.relight.glb_model import read_avatar
    from sira_assets.relight.light_source import own_light
    from sira_assets.scene.image import write_png

    model = read_avatar(args.avatar)
    scores = measure_relit(model, args.scene)
    rows = [
        {
            "shadows": s.shadows,
            "psnr_db": round(s.psnr_db, 2),
            "scale_invariant_psnr_db": round(s.scale_invariant_psnr_db, 2),
            "gain": round(s.gain, 3),
        }
        for s in scores
    ]
    presets = measure_presets(model, args.scene) if args.presets else ()
    said = [
        {"preset": p.name, "psnr_db": round(p.psnr_db, 2), "share_of_time": round(p.share_of_time, 4)} for p in presets
    ]
    views, light = (), None
    if args.novel:
        views = [
            {
                "view": v.view,
                "psnr_db": round(v.psnr_db, 2),
                "psnr_both_db": round(v.psnr_both_db, 2),
                "overlap": round(v.overlap, 4),
                "depth_error": round(v.depth_error, 5),
            }
            for v in measure_novel(model, own_light(model), args.scene)
        ]
        found = measure_light(own_light(model), args.scene)
        light = {
            "error": round(found.error, 4),
            "error_after_gain": round(found.error_after_gain, 4),
            "facing_after_gain": round(found.facing_after_gain, 4),
            "gain": round(found.gain, 3),
        }
    if args.picture:
        pictures = [s.radiance for s in scores] + [relit_truth(args.scene)[2]]
        write_png(args.picture, srgb_from_linear(np.clip(np.concatenate(pictures, 1), 0, 1)))
    if args.json:
        print(json.dumps({"relit": rows, "novel": views, "light": light, "presets": said}, indent=1))
        return 0
    for row in rows:
        what = "with shadows" if row["shadows"] else "without shadows"
        print(f"relit {what}: {row['psnr_db']} dB, {row['scale_invariant_psnr_db']} dB after a gain of {row['gain']}")
    for row in views:
        print(
            f"novel view {row['view']}: {row['psnr_db']} dB, {row['psnr_both_db']} dB where both surfaces are; "
            f"silhouettes overlap {row['overlap']}, depth {1000 * row['depth_error']:.2f} thousandths of a unit off"
        )
    if light:
        print(
            f"irradiance {light['error']} off, {light['error_after_gain']} after a gain of {light['gain']}, "
            f"{light['facing_after_gain']} on normals that face the camera"
        )
    for row in said:
        print(f"{row['preset']}: {row['psnr_db']} dB against the reference, at {row['share_of_time']:.3f} of its time")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 measured, 3 unusable input."""
    args = parser().parse_args(argv)
    return _cli.run(lambda: body(args))


if __name__ == "__main__":
    sys.exit(main())
