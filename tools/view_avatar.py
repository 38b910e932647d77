"""Write the 3D view of an exported avatar as one page that opens by double click, offline.

AVATAR is a folder that export_avatar.py wrote, or a .glb with its light in `scene.extras`. Where the folder has
renders/input.png, the photo can be slid over the view.

    python tools/view_avatar.py avatar --out view.html
"""

import argparse
import sys
from pathlib import Path

import _cli


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(
        prog="view_avatar.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("avatar", type=Path, metavar="AVATAR", help="exported folder or .glb")
    p.add_argument("--out", type=Path, required=True, metavar="FILE", help="the page, .html")
    p.add_argument("--overwrite", action="store_true", help="replace what --out holds")
    p.add_argument("--shadows", action=argparse.BooleanOptionalAction, default=True, help="cast shadows")
    p.add_argument("--title", help="default: the folder's name")
    p.add_argument("--json", action="store_true", help="print what was done as JSON")
    return p


def body(args: argparse.Namespace) -> int:
    """Read, write."""
    import json

    import numpy as np

    from sira_assets import __version__
    from sira_assets.atomic import check_file
    from sira_assets.measure.report import Picture, Report
    from sira_assets.measure.report_page import write_report_html
    from sira_assets.numerics.colour import srgb_from_linear
    from sira_assets.scene.image import read_image
    from sira_assets.viewer.scene import viewer_scene

    check_file(args.out, overwrite=args.overwrite)
    folder = args.avatar if args.avatar.is_dir() else args.avatar.parent
    scene = viewer_scene(args.avatar / "avatar.glb" if args.avatar.is_dir() else args.avatar, shadows=args.shadows)
    photo = None
    input_png = folder / "renders" / "input.png"
    if args.avatar.is_dir() and input_png.is_file():
        encoded = srgb_from_linear(read_image(input_png).linear)
        photo = Picture("photo", "the input", np.round(255 * encoded).astype(np.uint8))
    title = args.title or (folder.resolve().name if args.avatar.is_dir() else args.avatar.stem)
    write_report_html(Report(title=title, photo=photo, viewer=scene, version=__version__), args.out)
    done = {"page": str(args.out), "bytes": args.out.stat().st_size, "shadows": scene.shadows is not None}
    print(json.dumps(done) if args.json else f"{args.out}: {done['bytes'] / 1e6:.1f} MB")
    return 0


def main(argv: list[str] | None = None) -> int:
    """Exit status; see `_cli`."""
    args = parser().parse_args(argv)
    return _cli.run(lambda: body(args))


if __name__ == "__main__":
    sys.exit(main())
