#!/usr/bin/env python3
"""Draw a contact sheet of random procedural heads, to be looked at.

Same seed, same heads. --views picks what is seen of each head, --first skips heads, --style keeps to one hair style.
"""

import argparse
import sys
from pathlib import Path

from _cli import run


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(prog="draw_heads.py", description=__doc__.split("\n\n")[0])
    out.add_argument("--count", type=int, default=48, metavar="N", help="heads (default 48)")
    out.add_argument("--seed", type=int, default=0, help="default 0")
    out.add_argument("--first", type=int, default=0, metavar="INDEX", help="index of the first head (default 0)")
    out.add_argument("--views", default="front", help="comma-separated: front, three_quarter, side, back, above, eyes, "
                     "mouth, hairline, ear, chin, collar (default front)")  # fmt: skip
    out.add_argument("--style", default=None, help="only this hair style (default: as drawn)")
    out.add_argument("--size", type=int, default=192, help="pixels of one picture (default 192)")
    out.add_argument("--columns", type=int, default=8, help="pictures in a row (default 8)")
    out.add_argument("--out", type=Path, default=Path("heads.png"), metavar="FILE", help="default heads.png")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    if min(arguments.seed, arguments.first) < 0:
        parser().error("--seed and --first must be at least 0")
    return run(lambda: draw(arguments))


def draw(arguments: argparse.Namespace) -> int:
    """Build, render and write."""
    from dataclasses import replace

    from data_synth.portraits import VIEWS, contact_sheet, random_params
    from sira_assets.errors import InputError
    from sira_assets.scene.image import write_png

    names = arguments.views.split(",")
    wrong = [name for name in names if name not in VIEWS]
    if wrong or min(arguments.count, arguments.size, arguments.columns) < 1:
        raise InputError(
            expected="views among " + ", ".join(VIEWS) + " and positive --count, --size and --columns",
            received=", ".join(wrong) or f"{arguments.count}, {arguments.size}, {arguments.columns}",
            remedy="choose such values",
        )
    heads = [random_params(arguments.seed, arguments.first + k) for k in range(arguments.count)]
    if arguments.style is not None:
        heads = [replace(p, hair_style=arguments.style) for p in heads]
    write_png(arguments.out, contact_sheet(heads, [VIEWS[n] for n in names], arguments.size, arguments.columns))
    print(f"{arguments.count} heads: {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
