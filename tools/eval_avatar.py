#!/usr/bin/env python3
"""An exported avatar against a scene's truth: surface, diffuse, specular, normals, silhouette and the final render.

Reads AVATAR/avatar.glb and AVATAR/renders/final.exr as any other program would, and SCENE with its gt/ maps. Exit
status: 0 measured, 3 unusable input.
"""

import argparse
import sys

from _cli import run


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="eval_avatar.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("avatar", metavar="AVATAR", help="folder that export_avatar.py wrote")
    out.add_argument("scene", metavar="SCENE", help="the scene it was made from")
    out.add_argument("--truth", metavar="SCENE", help="scene or head folder whose truth to use (default: SCENE)")
    out.add_argument("--samples", type=int, default=60_000, help="points per surface (default: 60000)")
    out.add_argument("--seed", type=int, default=0)
    out.add_argument("--json", action="store_true", help="print JSON instead of tables")
    return out


def main(argv: list[str] | None = None) -> int:
    """Parse, measure, print; gives the exit status."""
    arguments = parser().parse_args(argv)
    if arguments.samples < 1 or arguments.seed < 0:
        parser().error("--samples must be at least 1 and --seed at least 0")
    return run(lambda: _measure(arguments))


def _measure(a: argparse.Namespace) -> int:
    from sira_assets.measure.avatar_metrics import measure_avatar
    from sira_assets.measure.present import avatar_json, avatar_tables
    from sira_assets.measure.protocols import ProtocolConfig

    report = measure_avatar(a.avatar, a.scene, truth=a.truth, config=ProtocolConfig(samples=a.samples, seed=a.seed))
    if a.json:
        print(avatar_json(report))
        return 0
    from rich.console import Console

    console = Console()
    for table in avatar_tables(report):
        console.print(table)
    for note in report.notes:
        console.print(f"note: {note}", style="yellow", highlight=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
