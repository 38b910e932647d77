"""Train the prior (SA-SM and AF-SM) on a folder of scenes.

python tools/make_scenes.py --count 240 --truth train --out scenes
python tools/train_prior.py --scenes scenes --out prior.safetensors --run runs/prior

Two processes, sharing every step: torchrun --nproc-per-node=2 -- tools/train_prior.py ...
"""

import argparse
import sys
from pathlib import Path

import _cli


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenes", type=Path, nargs="+", default=[], metavar="DIR", help="folders of generated scenes")
    p.add_argument(
        "--scans",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="folders of your own scans' scenes (make_scenes.py --from-scan), beside --scenes or alone",
    )
    p.add_argument("--out", type=Path, required=True, help="the prior, a .safetensors file")
    p.add_argument("--run", type=Path, default=Path("runs/prior"), help="checkpoints and loss curves")
    p.add_argument("--steps", type=int, default=None, help="steps of SA-SM")
    p.add_argument("--appearance-steps", type=int, default=None, help="steps of AF-SM")
    p.add_argument(
        "--supervision",
        type=float,
        default=None,
        help="weight of the scenes' exact albedo in AF-SM (0: self-supervised)",
    )
    p.add_argument(
        "--bfloat16", type=float, default=None, metavar="SHARE", help="share of SA-SM's steps in bfloat16 (default 0)"
    )
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    p.add_argument("--workers", type=int, default=2, help="processes that draw samples")
    p.add_argument("--resume", action="store_true", help="go on from --run exactly")
    p.add_argument("--quiet", action="store_true")
    return p


def body(args: argparse.Namespace) -> int:
    """Train."""
    import contextlib
    from dataclasses import replace

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from sira_assets.train.prior import PriorConfig, train_prior

    base = PriorConfig()
    shape = replace(base.shape, seed=args.seed, steps=args.steps or base.shape.steps)
    if args.bfloat16 is not None:
        shape = replace(shape, bfloat16=args.bfloat16)
    appearance = replace(base.appearance, seed=args.seed, steps=args.appearance_steps or base.appearance.steps)
    if args.supervision is not None:
        appearance = replace(appearance, supervision=args.supervision)
    device = _cli.device(args.device)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with contextlib.nullcontext() if args.quiet else Progress(*columns, console=Console(stderr=True)) as progress:
        train_prior(
            [*args.scenes, *args.scans],
            args.out,
            args.run,
            config=replace(base, shape=shape, appearance=appearance),
            device=device,
            resume=args.resume,
            workers=args.workers,
            progress=progress,
        )
    return 0


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0, 2 usage, 3 bad input, 130 interrupted (go on with --resume)."""
    p = parser()
    args = p.parse_args(argv)
    if not args.scenes and not args.scans:
        p.error("give --scenes, --scans, or both")
    counts = (args.workers, args.steps, args.appearance_steps)
    if args.seed < 0 or any(count is not None and count < 1 for count in counts):
        p.error("--steps, --appearance-steps and --workers must be at least 1, --seed at least 0")
    return _cli.run(lambda: body(args))


if __name__ == "__main__":
    sys.exit(main())
