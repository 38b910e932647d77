"""Draw synthetic scenes and write many of them, in parallel, resumably.

Notation: a scene is a function of (kind, seed, index) and the settings alone, so that worker counts, order and
interruptions leave every byte as it is. `train` and `eval` are disjoint spaces of random streams.
"""

import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from data_synth.cameras import CameraConfig, sample_cameras, sample_world_from_canonical
from data_synth.lights import Rig, face_luminance, sample_exposure, sample_rig
from data_synth.render import RayScene, RenderConfig, Surface, render
from data_synth.render_light import LUMINANCE
from data_synth.write_scene import SynthScene, write_scene
from sira_assets.atomic import write_text
from sira_assets.errors import InputError
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.canonical import transform_points
from sira_assets.scene.sg_light import SGLight

KINDS = ("train", "eval")
# One value a scene, chosen to reach from oily to dry skin around the 0.4 to 0.5 that real heads are rendered with.
ROUGHNESS_RANGE = (0.32, 0.52)
FRAMED_ABOVE_M = -0.125  # canonical y: the head down to just below the chin is what cameras frame
FACE_RADIUS_M = 0.095  # around the nose tip, as measured regions have it
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class SceneSettings:
    """What a data set's scenes have in common: views, size in pixels, light samples and sub-pixel samples."""

    kind: str = "train"
    seed: int = 0
    views: int = 8
    size: int = 256
    samples: int = 64
    supersample: int = 1

    def __post_init__(self):
        RenderConfig(self.samples, self.supersample)
        if self.kind not in KINDS or self.views < 1 or self.size < 16 or self.seed < 0:
            raise InputError(
                expected=f"kind among {', '.join(KINDS)}, views >= 1, size >= 16, seed >= 0",
                received=f"kind {self.kind}, views {self.views}, size {self.size}, seed {self.seed}",
                remedy="choose such values",
            )


def scene_name(settings: SceneSettings, index: int) -> str:
    """The folder of a scene."""
    return f"{settings.kind}_{index:06d}"


def draw_scene(settings: SceneSettings, index: int) -> SynthScene:
    """Draw and render scene `index`; a pure function of its arguments."""
    from data_synth.head.build import build_head
    from data_synth.head.params import sample_params

    root = np.random.SeedSequence(settings.seed, spawn_key=(KINDS.index(settings.kind), index))
    rng_head, rng_pose, rng_light, rng_render = (np.random.default_rng(child) for child in root.spawn(4))
    head = build_head(sample_params(rng_head))
    world_from_canonical = sample_world_from_canonical(rng_pose)
    mesh_canonical = TriangleMesh(head.vertices_m, head.faces)
    albedo, _ = head.material(head.template_positions_m)
    framed = head.vertices_m[head.vertices_m[:, 1] > FRAMED_ABOVE_M]
    camera_config = CameraConfig(width=settings.size, height=settings.size)
    cameras = sample_cameras(rng_pose, framed, world_from_canonical, settings.views, camera_config)

    face = np.linalg.norm(head.vertices_m - head.landmarks9["nose_tip"], axis=1) < FACE_RADIUS_M
    rotation = world_from_canonical[:3, :3] / np.cbrt(np.linalg.det(world_from_canonical[:3, :3]))
    roughness = float(rng_light.uniform(*ROUGHNESS_RANGE))
    rig, light = _exposed_light(rng_light, mesh_canonical, albedo, face, rotation)
    second_rig, second_light = _exposed_light(rng_light, mesh_canonical, albedo, face, rotation)

    mesh = mesh_canonical.transformed(world_from_canonical)
    rays = RayScene(Surface(mesh, head.template_positions_m, head.material, roughness))
    config = RenderConfig(settings.samples, settings.supersample)
    renderings = [render(rays, camera, light, rng_render, config) for camera in cameras]
    relight = None
    if settings.kind == "eval":
        relight = (second_light, render(rays, cameras[0], second_light, rng_render, config))
    return SynthScene(
        mesh=mesh,
        vertex_albedo=albedo,
        cameras=cameras,
        renderings=renderings,
        light=light,
        roughness=roughness,
        canonical_from_world=np.linalg.inv(world_from_canonical),
        landmarks_world={n: transform_points(world_from_canonical, p) for n, p in head.landmarks9.items()},
        landmarks68_world=transform_points(world_from_canonical, head.landmarks_m),
        anchors_world=transform_points(world_from_canonical, head.anchors_m),
        relight=relight,
        provenance={
            "settings": asdict(settings),
            "index": index,
            "rig": rig.name,
            "relight_rig": second_rig.name if relight else None,
            "head": _plain(asdict(head.params)),
        },
    )


def _exposed_light(rng, mesh_canonical, albedo, face, rotation) -> tuple[Rig, SGLight]:
    """A rig, and its light in the world, bright enough for the face to be well exposed."""
    rig = sample_rig(rng)
    light = rig.light()
    target = sample_exposure(rng, float((albedo[face] @ LUMINANCE).mean()))
    gain = target / max(face_luminance(mesh_canonical, albedo, light, face), 1e-6)
    return rig, light.scaled(gain).rotated(rotation)


def _plain(value: object) -> object:
    """Arrays and tuples as lists, for JSON."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value


def write_dataset(
    out: str | os.PathLike,
    settings: SceneSettings,
    indices: range,
    *,
    workers: int = 1,
    on_scene: Callable[[str, float], None] = lambda name, seconds: None,
) -> int:
    """Write the scenes of `indices` that `out` does not hold yet.

    Parameters
    ----------
    workers : processes, one thread each
    on_scene : called with each scene's name and seconds as it is done (0 seconds for those already there)

    Returns
    -------
    Number of scenes newly written.

    Raises
    ------
    InputError : `out` holds a data set made with other settings, or workers < 1.
    """
    out = Path(out)
    if workers < 1:
        raise InputError(expected="at least one worker", received=f"{workers}", remedy="use --workers 1 or more")
    claim_folder(out, settings)
    missing = []
    for index in indices:
        if (out / scene_name(settings, index)).is_dir():
            on_scene(scene_name(settings, index), 0.0)
        else:
            missing.append(index)
    if not missing:
        return 0
    with _pool(min(workers, len(missing))) as pool:
        pending, queue = set(), iter(missing)
        while True:
            for index in queue:
                pending.add(pool.submit(_write_one, out, settings, index))
                if len(pending) >= 2 * workers:
                    break
            if not pending:
                return len(missing)
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                on_scene(*future.result())


def claim_folder(out: Path, settings: SceneSettings) -> None:
    """Say in `out` how its scenes of this kind are made, or raise InputError if they are made in another way."""
    path = out / f"{settings.kind}.json"
    if not path.exists():
        write_text(path, json.dumps(asdict(settings), indent=1) + "\n")
        return
    held = json.loads(path.read_text())
    if held != asdict(settings):
        differing = ", ".join(f"{k} {held.get(k)}" for k, v in asdict(settings).items() if held.get(k) != v)
        raise InputError(
            expected=f"the settings that {out} was begun with ({differing})",
            received="others",
            remedy="give the same, or another --out",
        )


def _write_one(out: Path, settings: SceneSettings, index: int) -> tuple[str, float]:
    begin, name = time.perf_counter(), scene_name(settings, index)
    write_scene(draw_scene(settings, index), out / name)
    return name, time.perf_counter() - begin


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes with one thread each; on any error, Ctrl-C included, they are stopped at once."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    others = set(multiprocessing.active_children())
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_follow_parent)
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        pool.shutdown(wait=True, cancel_futures=True)
        raise
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end when the parent does, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
