#!/usr/bin/env python3
"""Measure how well behaved a trained prior is: does every code decode to one closed head, how steep is its distance.

Codes are drawn within two standard deviations; heads between neighbouring draws are measured as well.
"""

import argparse
import json
import sys
from pathlib import Path

import _cli


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(prog="measure_prior.py", description=__doc__.split("\n\n")[0])
    out.add_argument("prior", type=Path, nargs="?", help="a .safetensors prior (default: the shipped one)")
    out.add_argument("--draws", type=int, default=40, metavar="N", help="codes drawn (default 40)")
    out.add_argument("--between", type=int, default=3, metavar="M", help="heads between two draws (default 3)")
    out.add_argument("--cell", type=float, default=4.0, metavar="MM", help="cell of the extraction (default 4)")
    out.add_argument("--seed", type=int, default=0)
    out.add_argument("--json", action="store_true", help="print JSON instead of the table")
    return out


def body(arguments: argparse.Namespace) -> int:
    """Decode, measure, print."""
    from dataclasses import asdict

    from sira_assets.fields.prior import load_prior
    from sira_assets.train.latent_space import LatentConfig, decode_head, draw_coefficients, interpolated

    config = LatentConfig(arguments.draws, arguments.between, 1e-3 * arguments.cell, seed=arguments.seed)
    prior = load_prior(arguments.prior)
    drawn = draw_coefficients(prior, config)
    sets = {"drawn": drawn, "between": interpolated(drawn, config.between)}
    heads = {name: [decode_head(prior, row, config) for row in rows] for name, rows in sets.items()}
    if arguments.json:
        print(json.dumps({name: [asdict(head) for head in row] for name, row in heads.items()}, indent=1))
        return 0
    for name, found in heads.items():
        if found:
            print_summary(name, found)
    return 0


def print_summary(name: str, heads: list) -> None:
    """Counts and extremes of one set of heads."""
    one = sum(head.pieces == 1 and head.closed for head in heads)
    near, spread = [head.slope_mean for head in heads], max(head.slope_spread for head in heads)
    litres = [head.volume_l for head in heads]
    print(f"{name}: {len(heads)} heads")
    print(f"  one closed piece             {one} of {len(heads)}")
    print(f"  area in floaters, most       {100 * max(head.floaters for head in heads):.3f} %")
    print(f"  |grad f| near the surface    {min(near):.3f} to {max(near):.3f}, spread at most {spread:.3f}")
    print(f"  |grad f| anywhere, greatest  {max(head.slope_greatest for head in heads):.2f}")
    print(f"  volume, litres               {min(litres):.2f} to {max(litres):.2f}")


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    arguments = parser().parse_args(argv)
    return _cli.run(lambda: body(arguments))


if __name__ == "__main__":
    sys.exit(main())
