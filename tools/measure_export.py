"""Measure that an export is whole or absent, whatever happens while it is written.

kills   a process that writes avatars over one another without end is killed (SIGKILL) at random moments; after each
        kill every file at a final name must hold, byte for byte, what one of the writes puts there. Twice: into a
        standing folder, file by file, and as export_avatar.py delivers, the folder as a whole.
full    the same write with a random number of bytes to spare. Without --folder no file may grow beyond that
        (RLIMIT_FSIZE); with --folder on a small file system (at most 64 MB) it is really filled:
        mount -t tmpfs -o size=4m tmpfs DIR

The avatars are an analytic ball, baked and unwrapped here, in two versions that differ in every file; USD is written
where usd-core is installed. Runs where processes can be forked (Linux, macOS).

Exit status: 0 done, 3 unusable input, 4 something was torn, mixed, missing or left over.
"""

import argparse
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import _cli

MAX_DISK = 64 << 20


@dataclass(frozen=True)
class Figures:
    """What was found after `trials` kills or full disks.

    torn: files at a final name that no write puts there; mixed: folders with files of both versions; missing: files
    that stood there before and are gone; hidden: temporary files and folders left, which a kill cannot avoid; writes:
    that came to their end; refused: that were told so by an OSError.
    """

    what: str
    trials: int
    torn: int
    mixed: int
    missing: int
    hidden: int
    writes: int
    refused: int

    @property
    def sound(self) -> bool:
        return not (self.torn or self.mixed or self.missing)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("what", choices=("kills", "full"))
    p.add_argument("--trials", type=int, default=50, help="default 50")
    p.add_argument("--size", type=int, default=64, help="texels a side (default 64)")
    p.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    p.add_argument("--folder", type=Path, help="where to work (default: a temporary folder)")
    p.add_argument("--json", action="store_true", help="print JSON")
    return p


def avatars(size: int) -> tuple:
    """Two avatars that differ in every file, and how they are written."""
    import importlib.util
    from dataclasses import replace

    import numpy as np

    from sira_assets.asset.avatar import Avatar
    from sira_assets.asset.export_config import ExportConfig
    from sira_assets.fields.analytic import SphereHead
    from sira_assets.mesh.extract import ExtractConfig, extract_mesh
    from sira_assets.scene.sg_light import SGLight
    from sira_assets.texture.bake import BakeConfig, bake
    from sira_assets.texture.unwrap import UnwrapConfig, unwrap

    made = []
    for radius, roughness in ((0.1, 0.4), (0.09, 0.5)):
        field = SphereHead(radius_m=radius)
        light = SGLight([[0.0, 0.0, 1.0]], [3.0], [[10 * radius] * 3])
        mesh = extract_mesh(field, ExtractConfig(cell_m=0.01))
        atlas = unwrap(mesh, UnwrapConfig(texture_size=size, methods=()))
        maps = bake(field, mesh, atlas, light, np.eye(4), BakeConfig(size=size))
        if made:
            tilt = np.array([0.1, 0.0, 1.0], np.float32) / np.float32(np.sqrt(1.01))
            maps = replace(
                maps,
                diffuse=0.5 * maps.diffuse,
                specular_f0=0.5 * maps.specular_f0,
                normal_tangent=np.broadcast_to(tilt, maps.normal_tangent.shape),
            )
        made.append(Avatar(mesh, atlas, maps, light, roughness, np.eye(4)))
    return tuple(made), ExportConfig(usd=importlib.util.find_spec("pxr") is not None)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file under `folder` by its name, hidden ones apart."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files if not hidden(p.relative_to(folder))}


def hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def leftovers(root: Path) -> int:
    """Remove what is hidden under `root` and count it."""
    import shutil

    found = [p for p in sorted(root.rglob(".*")) if p.exists() and not hidden(p.relative_to(root).parent)]
    for path in found:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return len(found)


@dataclass(frozen=True)
class Bench:
    """Two versions, what each one's files hold, and the folder that is written to."""

    versions: tuple
    config: object
    truth: tuple[dict, dict]
    root: Path

    @property
    def target(self) -> Path:
        return self.root / "avatar"

    def write(self, version: int, *, whole: bool) -> None:
        """Write one version file by file, or the folder as a whole."""
        from sira_assets.asset.write_avatar import write_avatar
        from sira_assets.atomic import replacing_folder

        if not whole:
            write_avatar(self.versions[version], self.target, self.config)
            return
        with replacing_folder(self.target) as fresh:
            write_avatar(self.versions[version], fresh, self.config)

    def faults(self, *, whole: bool) -> tuple[int, int, int]:
        """Torn, mixed (if the folder is one whole) and missing, as in `Figures`."""
        found = contents(self.target) if self.target.is_dir() else {}
        first, second = self.truth
        torn = sum(data not in (first.get(name), second.get(name)) for name, data in found.items())
        missing = len(set(first) - set(found))
        return torn, int(whole and not torn and not missing and found not in self.truth), missing


def bench(root: Path, size: int) -> Bench:
    """Both versions written once, in a folder of their own."""
    from sira_assets.asset.write_avatar import write_avatar
    from sira_assets.errors import InputError

    versions, config = avatars(size)
    truth = []
    for k, version in enumerate(versions):
        write_avatar(version, root / f"version{k}", config)
        truth.append(contents(root / f"version{k}"))
    same = [name for name in truth[0] if truth[0][name] == truth[1][name]]
    if same:
        raise InputError(expected="versions that differ in every file", received=", ".join(same), remedy="mend them")
    return Bench(versions, config, tuple(truth), root)


def measure_kills(made: Bench, trials: int, seed: int, *, whole: bool) -> Figures:
    """See the module's docstring."""
    import mmap
    import os
    import random
    import signal
    import time

    moments = random.Random(seed)
    made.write(0, whole=whole)
    start = time.perf_counter()
    made.write(1, whole=whole)
    lasts = time.perf_counter() - start
    counter = mmap.mmap(-1, 8)
    faults, seen, writes = [0, 0, 0], 0, 0
    for _ in range(trials):
        counter[:8] = bytes(8)
        child = os.fork()
        if child == 0:
            done = 0
            while True:
                made.write(done % 2, whole=whole)
                done += 1
                counter[:8] = done.to_bytes(8, "little")
        time.sleep(moments.uniform(0.0, 3.0 * lasts))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        faults = [a + b for a, b in zip(faults, made.faults(whole=whole), strict=True)]
        seen += leftovers(made.root)
        writes += int.from_bytes(counter[:8], "little")
    return Figures("kills, whole folder" if whole else "kills, file by file", trials, *faults, seen, writes, 0)


def measure_full(made: Bench, trials: int, seed: int, *, disk: bool) -> Figures:
    """See the module's docstring."""
    import os
    import random

    moments = random.Random(seed)
    sizes = [len(data) for data in made.truth[1].values()]
    most = 1.1 * sum(sizes) if disk else 1.1 * max(sizes)
    faults, seen, writes, refused = [0, 0, 0], 0, 0, 0
    for trial in range(trials):
        made.write(0, whole=True)
        whole = trial % 2 == 0
        spare = int(moments.uniform(0.0, most))
        ballast = _fill(made.root, spare) if disk else None
        child = os.fork()
        if child == 0:
            os._exit(_refused(made, None if disk else spare, whole=whole))
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if ballast is not None:
            ballast.unlink()
        if status not in (0, 1):
            raise RuntimeError(f"with {spare} bytes to spare the write ended with status {status}, no OSError")
        writes, refused = writes + (status == 0), refused + status
        faults = [a + b for a, b in zip(faults, made.faults(whole=whole), strict=True)]
        seen += leftovers(made.root)
    return Figures("full disk" if disk else "files limited in size", trials, *faults, seen, writes, refused)


def _refused(made: Bench, largest: int | None, *, whole: bool) -> int:
    """In the child: 0 the write came to its end, 1 it raised an OSError, 2 something else."""
    import resource
    import signal
    import traceback

    if largest is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # so that the write fails, as on a full disk
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
    try:
        made.write(1, whole=whole)
    except OSError:
        return 1
    except BaseException:
        traceback.print_exc()
        return 2
    return 0


def _fill(root: Path, spare: int) -> Path:
    """A file that leaves `spare` bytes on the disk, about."""
    import os

    ballast = root / "ballast"
    state = os.statvfs(root)
    with open(ballast, "wb") as file:
        file.write(bytes(max(0, state.f_bavail * state.f_frsize - spare)))
    return ballast


def body(args: argparse.Namespace) -> int:
    """Measure and print."""
    import json
    import shutil
    import tempfile

    from sira_assets.errors import InputError

    if args.folder is not None:
        args.folder.mkdir(parents=True, exist_ok=True)
        if args.what == "full" and shutil.disk_usage(args.folder).total > MAX_DISK:
            raise InputError(
                expected=f"a file system of at most {MAX_DISK >> 20} MB, since it is filled",
                received=f"{shutil.disk_usage(args.folder).total >> 20} MB at {args.folder}",
                remedy="mount a small tmpfs, or leave --folder out",
            )
    with tempfile.TemporaryDirectory(dir=args.folder) as root:
        made = bench(Path(root), args.size)
        if args.what == "kills":
            found = [measure_kills(made, args.trials, args.seed, whole=whole) for whole in (False, True)]
        else:
            found = [measure_full(made, args.trials, args.seed, disk=args.folder is not None)]
    if args.json:
        print(json.dumps([asdict(f) for f in found], indent=1))
    else:
        for f in found:
            print(
                f"{f.what}: {f.trials} trials, {f.writes} writes ended, {f.refused} refused; torn {f.torn}, mixed "
                f"{f.mixed}, missing {f.missing}; temporary names left {f.hidden}"
            )
    return 0 if all(f.sound for f in found) else 4


def main(argv: list[str] | None = None) -> int:
    """Exit status: 0 sound, 2 usage, 3 bad input, 4 something torn, mixed or missing."""
    p = parser()
    args = p.parse_args(argv)
    if args.trials < 1 or args.size < 16:
        p.error("--trials must be at least 1, --size at least 16")
    return _cli.run(lambda: body(args))


if __name__ == "__main__":
    sys.exit(main())
