#!/usr/bin/env python3
"""Measure the making of data sets: what a kill leaves behind, how fast scenes come, what noise costs beside Mitsuba.

kills   make_scenes.py is killed (SIGKILL: the process alone, or with its workers) at random moments and begun anew
        until all scenes are there; every byte is then compared with those of a run that nobody disturbed.
speed   scenes a minute and peak memory of a run, start-up apart; with --noise also the time Mitsuba 3 would need for
        the generator's noise: both render the diffuse light with shadows of one view twice, their variances over the
        head are taken from the differences, and Mitsuba's time is scaled by them (variance falls as 1 / samples). The
        generator's time includes its highlights and unshadowed twins; Mitsuba's is that of `scalar_rgb`, one thread.

What stands after -- is handed on to make_scenes.py, such as -- --truth train.

Exit status: 0 done, 3 unusable input or no Mitsuba, 4 the bytes differ or something was left over.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from _cli import run

MAKE = Path(__file__).resolve().with_name("make_scenes.py")
POLL_SECONDS = 0.02
NOISE_SCENES = 3  # with other lights; what noise costs depends on the light
MITSUBA_SAMPLES = 64  # a pixel; enough for its variance to be measured, the time for another is scaled


@dataclass(frozen=True)
class KillFigures:
    """kills made; scenes that were whole at each; names of files that differ, are missing or are too many; leftovers
    seen right after kills, and at the end."""

    kills: int
    scenes: int
    whole_at_kill: tuple[int, ...]
    partial_seen: int
    differing: tuple[str, ...]
    leftovers: tuple[str, ...]
    files: int


@dataclass(frozen=True)
class SpeedFigures:
    """scenes a minute once every worker draws, and with start-up; processor seconds a scene, start-up included, which
    tell on a machine that others use too; peak memory of the largest process."""

    scenes: int
    workers: int
    size: int
    views: int
    scenes_per_minute: float
    scenes_per_minute_with_start: float
    seconds: float
    processor_seconds_per_scene: float
    peak_process_mb: float


@dataclass(frozen=True)
class NoiseFigures:
    """One view, diffuse light of a white surface: standard deviations relative to the mean, seconds, and the ratio of
    Mitsuba's time at the generator's noise to the generator's."""

    scene: int
    rig: str
    pixels: int
    generator_seconds: float
    generator_noise: float
    mitsuba_seconds: float
    mitsuba_noise: float
    mitsuba_samples: int
    time_ratio: float


def parser() -> argparse.ArgumentParser:
    """The command line."""
    out = argparse.ArgumentParser(
        prog="measure_dataset.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    out.add_argument("what", choices=("kills", "speed"))
    out.add_argument("--kills", type=int, default=20, metavar="N", help="default 20")
    out.add_argument("--count", type=int, default=50, metavar="N", help="scenes (default 50)")
    out.add_argument("--size", type=int, default=48, help="pixels (default 48; speed is spoken of at 256)")
    out.add_argument("--views", type=int, default=2, help="default 2; speed is spoken of at 8")
    out.add_argument("--samples", type=int, default=None, help="light directions a sample point")
    out.add_argument("--workers", type=int, default=2, help="default 2")
    out.add_argument("--seed", type=int, default=0, help="of the moments (default 0)")
    out.add_argument("--noise", action="store_true", help="speed: also beside Mitsuba, at equal noise")
    out.add_argument("--folder", type=Path, help="where to work (default: a temporary folder)")
    out.add_argument("--json", action="store_true", help="print JSON")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the tool; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    cut = words.index("--") if "--" in words else len(words)
    arguments = parser().parse_args(words[:cut])
    arguments.rest = words[cut + 1 :]
    if min(arguments.kills, arguments.count, arguments.workers) < 1:
        parser().error("--kills, --count and --workers must be at least 1")
    return run(lambda: measure(arguments))


def measure(arguments: argparse.Namespace) -> int:
    """Print the figures of what was asked for."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        if arguments.what == "kills":
            figures = [measure_kills(arguments, folder)]
            status = 4 if figures[0].differing or figures[0].leftovers else 0
        else:
            figures, status = [measure_speed(arguments, folder)], 0
            if arguments.noise:
                figures += [measure_noise(arguments, index) for index in range(NOISE_SCENES)]
    if arguments.json:
        print(json.dumps([asdict(f) for f in figures], indent=1))
    else:
        for figure in figures:
            for name, value in asdict(figure).items():
                shown = " ".join(map(str, value)) if isinstance(value, tuple) else value
                print(f"{name.replace('_', ' '):<30}{f'{shown:.4g}' if isinstance(shown, float) else shown}")
    return status


def command(arguments: argparse.Namespace, out: Path) -> list[str]:
    """make_scenes.py with the settings of this measure."""
    line = [sys.executable, str(MAKE), "--quiet", "--out", str(out), "--count", str(arguments.count)]
    line += ["--size", str(arguments.size), "--views", str(arguments.views), "--workers", str(arguments.workers)]
    if arguments.samples is not None:
        line += ["--samples", str(arguments.samples)]
    return line + arguments.rest


def measure_kills(arguments: argparse.Namespace, folder: Path) -> KillFigures:
    """Run undisturbed, then killed over and over, and compare."""
    undisturbed, disturbed = folder / "undisturbed", folder / "killed"
    moments = watch(command(arguments, undisturbed), undisturbed)
    start, per_scene = moments[0], (moments[-1] - moments[0]) / max(len(moments) - 1, 1)
    chance, at_kill, partial = random.Random(arguments.seed), [], 0
    while len(at_kill) < arguments.kills:
        # Up to twice an even share of what is left, so that some kills come before the first scene and some late.
        left = arguments.count - len(scenes(disturbed))
        share = min(chance.uniform(0.0, 2.0) * left / (arguments.kills - len(at_kill) + 1), left - 1)
        if not killed_after(command(arguments, disturbed), disturbed, share, start, per_scene, chance):
            break  # it ended before its moment came: nothing is left to disturb
        at_kill.append(len(scenes(disturbed)))
        partial += len(hidden(disturbed)) > 0
    subprocess.run(command(arguments, disturbed), check=True)
    first, second = contents(undisturbed), contents(disturbed)
    differing = sorted(name for name in first.keys() | second.keys() if first.get(name) != second.get(name))
    return KillFigures(
        kills=len(at_kill),
        scenes=len(scenes(disturbed)),
        whole_at_kill=tuple(at_kill),
        partial_seen=partial,
        differing=tuple(differing),
        leftovers=tuple(hidden(disturbed)),
        files=len(first),
    )


def killed_after(
    line: list[str], out: Path, share: float, start: float, per_scene: float, chance: random.Random
) -> bool:
    """Start a run, kill it once `share` more scenes are there (the fraction in time); False if it ended before.

    start, per_scene : seconds until an undisturbed run has its first scene, and of each other; a share below one scene
        is a moment from the interpreter's start on
    """
    wanted = len(scenes(out)) + int(share)
    process = subprocess.Popen(line, start_new_session=True, stdout=subprocess.DEVNULL)
    try:
        if int(share) == 0:
            time.sleep(chance.uniform(0.0, start + per_scene))
        while process.poll() is None and len(scenes(out)) < wanted:
            time.sleep(POLL_SECONDS)
        if int(share):
            time.sleep((share % 1.0) * per_scene)
        if process.poll() is not None:
            return False
        if chance.random() < 0.5:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        return True
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def scenes(folder: Path) -> list[str]:
    """Names of the whole scenes."""
    return sorted(path.parent.name for path in folder.glob("[!.]*/transforms.json"))


def hidden(folder: Path) -> list[str]:
    """Names of what is being written, or was."""
    return sorted(path.name for path in folder.glob(".*"))


def contents(folder: Path) -> dict[str, bytes]:
    """SHA-256 of every file, hidden ones too."""
    from hashlib import sha256

    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): sha256(path.read_bytes()).digest() for path in files}


def watch(line: list[str], out: Path) -> list[float]:
    """Run to the end; seconds from its start at which each scene was there, and last its end.

    Raises
    ------
    InputError : it did not end well, or made no scene.
    """
    from sira_assets.errors import InputError

    before, begin, moments = len(scenes(out)), time.monotonic(), []
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL)
    while process.poll() is None:
        moments += [time.monotonic() - begin] * (len(scenes(out)) - before - len(moments))
        time.sleep(POLL_SECONDS)
    if process.returncode != 0 or not moments:
        raise InputError(
            expected="make_scenes.py to make scenes and end with 0",
            received=f"exit status {process.returncode}, {len(moments)} scenes",
            remedy="see its message, and give another --folder if this one has scenes",
        )
    return [*moments, time.monotonic() - begin]


def measure_speed(arguments: argparse.Namespace, folder: Path) -> SpeedFigures:
    """Make scenes and take the time from when each is there."""
    import resource

    from sira_assets.errors import InputError

    *seen, seconds = watch(command(arguments, folder / "speed"), folder / "speed")
    if len(seen) <= arguments.workers:
        raise InputError(
            expected="more scenes than workers", received=f"{len(seen)} scenes", remedy="give a larger --count"
        )
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    # From the first round of scenes on, every worker has its template and draws.
    after = seen[arguments.workers :]
    return SpeedFigures(
        scenes=len(seen),
        workers=arguments.workers,
        size=arguments.size,
        views=arguments.views,
        scenes_per_minute=60.0 * len(after) / (after[-1] - seen[arguments.workers - 1]),
        scenes_per_minute_with_start=60.0 * len(seen) / seconds,
        seconds=seconds,
        processor_seconds_per_scene=(used.ru_utime + used.ru_stime) / len(seen),
        peak_process_mb=used.ru_maxrss / 1024.0,
    )


def measure_noise(arguments: argparse.Namespace, index: int) -> NoiseFigures:
    """The generator and Mitsuba on the same head, camera and light, in one process; scene `index` of seed 0."""
    import numpy as np
    from measure_renderer import load_mitsuba

    from data_synth.draw_scene import draw_scene
    from data_synth.render import RayScene, RenderConfig, Surface, render
    from data_synth.scene_settings import SceneSettings

    mi = load_mitsuba(1)
    scene = draw_scene(SceneSettings(size=arguments.size, views=1, samples=8, truth="train"), index)
    camera, mask = scene.cameras[0], scene.portrait.mask

    def white(x):
        return np.ones_like(x), np.full(len(x), 0.03)

    rays = RayScene(Surface(scene.mesh, scene.mesh.vertices, white, scene.roughness))
    config = RenderConfig(arguments.samples or SceneSettings().samples)
    render(rays, camera, scene.light, np.random.default_rng(0), config)  # tables and buffers are made once
    generator, generator_seconds = twice(
        lambda seed: render(rays, camera, scene.light, np.random.default_rng(seed), config).diffuse_radiance
    )
    head = mitsuba_scene(mi, scene)
    twice(lambda seed: np.array(mi.render(head, seed=seed, spp=1)))
    mitsuba, mitsuba_seconds = twice(lambda seed: np.array(mi.render(head, seed=seed, spp=MITSUBA_SAMPLES))[..., :3])
    # A pixel's box also averages what an edge cuts: the rim of the head is left out for both.
    from scipy.ndimage import binary_erosion

    inner = binary_erosion(mask, iterations=2)
    generator_noise, mitsuba_noise = (relative_noise(pair, inner) for pair in (generator, mitsuba))
    return NoiseFigures(
        scene=index,
        rig=str(scene.provenance["rig"]),
        pixels=int(inner.sum()),
        generator_seconds=generator_seconds,
        generator_noise=generator_noise,
        mitsuba_seconds=mitsuba_seconds,
        mitsuba_noise=mitsuba_noise,
        mitsuba_samples=MITSUBA_SAMPLES,
        time_ratio=mitsuba_seconds * (mitsuba_noise / generator_noise) ** 2 / generator_seconds,
    )


def twice(picture) -> tuple[list, float]:
    """Two independent pictures and the mean seconds of one."""
    begin = time.perf_counter()
    pair = [picture(1), picture(2)]
    return pair, (time.perf_counter() - begin) / 2


def relative_noise(pair: list, mask) -> float:
    """Standard deviation of one picture over its mean, from the difference of two."""
    import numpy as np

    a, b = (np.asarray(p, np.float64)[mask] for p in pair)
    return float(np.sqrt(np.mean((a - b) ** 2) / 2.0) / np.mean(0.5 * (a + b)))


def mitsuba_scene(mi, scene):
    """The white head under the scene's light, seen by frame 0's camera, direct light only."""
    import numpy as np
    from measure_renderer import light_bitmap, map_height, mitsuba_mesh

    camera = scene.cameras[0]
    centre = 0.5 * (scene.mesh.vertices.min(0) + scene.mesh.vertices.max(0))
    pose = camera.world_from_camera
    origin = pose[:3, 3] - centre
    fov = float(np.degrees(2.0 * np.arctan(0.5 * camera.width / camera.intrinsics[0, 0])))
    look = mi.ScalarTransform4f().look_at(
        origin=origin.tolist(), target=(origin + pose[:3, 2]).tolist(), up=(-pose[:3, 1]).tolist()
    )
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"}}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
            "sensor": {"type": "perspective", "fov": fov, "fov_axis": "x", "to_world": look, "film": film},
            "light": {
                "type": "envmap",
                "bitmap": light_bitmap(mi, scene.light, map_height(float(scene.light.sharpness.max()))),
            },
            "head": mitsuba_mesh(mi, scene.mesh.vertices - centre, scene.mesh.normals, scene.mesh.faces),
        }
    )


if __name__ == "__main__":
    sys.exit(main())
