"""Scenes on disk to training samples.

Notation: everything in the canonical frame and network units (UNIT_M metres); n outward unit normals; v unit
directions from the surface to the camera; rgb linear radiance of the photo; d signed distance, negative inside.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from sira_assets.atomic import replacing
from sira_assets.errors import InputError
from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.signed_distance import signed_distance
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, transform_points
from sira_assets.scene.image import read_image
from sira_assets.scene.landmarks import landmarks_from_json, read_json
from sira_assets.scene.read_scene import read_frame, read_frames
from sira_assets.scene.transforms_json import read_transforms

# Anchors that every scan has: the canonical landmarks.
LANDMARKS = len(CANONICAL_LANDMARKS_M)
# Counts up whenever samples on disk change their meaning.
SAMPLES_VERSION = 2


@dataclass(frozen=True)
class SceneSamples:
    """One scene, ready to be drawn from. Lengths: S surface, V volume, P pixels, A anchors."""

    surface: np.ndarray  # (S, 3)
    surface_normals: np.ndarray  # (S, 3)
    volume: np.ndarray  # (V, 3)
    volume_sdf: np.ndarray  # (V,)
    anchors: np.ndarray  # (9 + A, 3), the nine canonical landmarks, then the same A points of every head; NaN unknown
    pixels: np.ndarray  # (P, 3) surface points seen by the views
    pixel_normals: np.ndarray  # (P, 3)
    pixel_view: np.ndarray  # (P, 3)
    pixel_rgb: np.ndarray  # (P, 3)
    pixel_diffuse: np.ndarray  # (P, 3) exact linear albedo; NaN where the scene has none
    pixel_specular: np.ndarray  # (P,) exact F0; NaN where the scene has none


@dataclass(frozen=True)
class SampleConfig:
    """How many samples a scene keeps. Near-surface volume points have a gaussian offset of these two widths."""

    surface: int = 12000
    near: int = 8000
    far: int = 4000
    pixels_per_view: int = 1500
    near_sigma_m: tuple[float, float] = (0.003, 0.015)


def list_scenes(folders: Sequence[Path]) -> list[Path]:
    """Complete scenes below each of `folders`, sorted by name, one folder after the other.

    Raises
    ------
    InputError : none in one of them.
    """
    every = []
    for folder in folders:
        found = sorted(path.parent for path in Path(folder).glob("*/transforms.json"))
        if not found:
            raise InputError(
                expected=f"a folder of scenes (each with transforms.json) at {folder}",
                received="none",
                remedy="make some: python tools/make_scenes.py --count 240 --out DIR",
            )
        every += found
    return every


def sample_scene(scene: Path, config: SampleConfig, seed: int) -> SceneSamples:
    """Draw a scene's samples from its true mesh and its views; the same seed gives the same samples.

    Raises
    ------
    InputError : the scene has no gt/mesh.ply, no canonical frame, no 3D landmarks, or a view without a mask.
    """
    import trimesh

    path = scene / "gt" / "mesh.ply"
    description = read_transforms(scene / "transforms.json")
    if not path.exists() or description.canonical_from_world is None:
        raise InputError(
            expected="a scan to train on: gt/mesh.ply and canonical_from_world",
            received=f"{scene} without them",
            remedy="use scenes written by tools/make_scenes.py",
        )
    rng = np.random.default_rng([seed, int.from_bytes(hashlib.sha256(scene.name.encode()).digest()[:4], "big")])
    to_canonical = description.canonical_from_world
    loaded = trimesh.load(path, process=False)
    mesh = TriangleMesh(np.asarray(loaded.vertices), np.asarray(loaded.faces)).transformed(to_canonical)
    caster = Raycaster(mesh)

    surface, normals = _on_surface(mesh, config.surface, rng)
    near, _ = _on_surface(mesh, config.near, rng)
    sigma = np.where(rng.random(config.near) < 0.6, *config.near_sigma_m)[:, None]
    volume = np.concatenate([near + sigma * rng.normal(size=near.shape), rng.uniform(*BOUNDS_M, (config.far, 3))])
    volume, volume_sdf = _distances(scene, mesh, caster, to_canonical, volume)
    anchors = _anchors(scene / "gt" / "landmarks.json")
    unit = 1.0 / UNIT_M
    pixels = [
        _seen_pixels(frame, scene if i == 0 else None, to_canonical, mesh, caster, config.pixels_per_view, rng)
        for i, frame in enumerate(description.frames)
    ]
    position, normal, view, rgb, diffuse, specular = (
        np.concatenate(c).astype(np.float32) for c in zip(*pixels, strict=True)
    )
    return SceneSamples(
        surface=(surface * unit).astype(np.float32),
        surface_normals=normals.astype(np.float32),
        volume=(volume * unit).astype(np.float32),
        volume_sdf=(volume_sdf * unit).astype(np.float32),
        anchors=(transform_points(to_canonical, anchors) * unit).astype(np.float32),
        pixels=position * np.float32(unit),
        pixel_normals=normal,
        pixel_view=view,
        pixel_rgb=rgb,
        pixel_diffuse=diffuse,
        pixel_specular=specular,
    )


def _distances(scene, mesh, caster, to_canonical, points):
    """Of `points`, those whose signed distance is known, and it. A scan that is open has a closed mesh beside it, the
    scan's faces first; what lies nearest to one of the caps behind them tells nothing."""
    import trimesh

    path = scene / "gt" / "mesh_closed.ply"
    if not path.exists():
        return points, caster.signed_distance(points)
    loaded = trimesh.load(path, process=False)
    closed = TriangleMesh(np.asarray(loaded.vertices), np.asarray(loaded.faces)).transformed(to_canonical)
    distance, face = signed_distance(closed, points)
    known = face < len(mesh.faces)
    return points[known], distance[known]


def _anchors(path: Path) -> np.ndarray:
    """The nine canonical landmarks, NaN where a scan lacks one, and the dense correspondences if it has any."""
    data = read_json(path)
    known = landmarks_from_json(data, str(path)).points_world
    if not known:
        raise InputError(
            expected=f"3D landmarks in {path}",
            received="none",
            remedy='write {"landmarks_m": {"nose_tip": [x, y, z], ...}} with the nine canonical names',
        )
    nine = [known.get(name, [np.nan] * 3) for name in CANONICAL_LANDMARKS_M]
    return np.array([*nine, *data.get("anchors_m", [])], np.float64)


def _on_surface(mesh, count, rng):
    """`count` points and normals of a mesh: half by area, half on the face, a tenth of the area where mm count."""
    area = 0.5 * np.linalg.norm(face_cross_products(mesh.vertices, mesh.faces), axis=1)
    centre = mesh.vertices[mesh.faces].mean(1)
    face = np.linalg.norm(centre - np.array(CANONICAL_LANDMARKS_M["nose_tip"]), axis=1) < 0.1
    weight = area / area.sum() + np.where(face, area, 0.0) / max(area[face].sum(), 1e-12)
    chosen = rng.choice(len(area), count, p=weight / weight.sum())
    barycentric = rng.dirichlet(np.ones(3), count)
    return _mix(mesh.vertices, mesh.faces[chosen], barycentric), _unit(
        _mix(mesh.normals, mesh.faces[chosen], barycentric)
    )


def _mix(values, corners, barycentric):
    return (values[corners] * barycentric[..., None]).sum(1)


def _unit(x):
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)


def _seen_pixels(frame, truth, to_canonical, mesh, caster, count, rng):
    """Surface points behind `count` random pixels of a view, with radiance and, where `truth` has maps, material."""
    image, mask = read_frame(frame)
    if mask is None:
        raise InputError(
            expected=f"mask_path beside {frame.image_path} in its transforms.json",
            received="none",
            remedy="name a mask for every view, white on the head",
        )
    rows, cols = np.nonzero(mask)
    keep = rng.permutation(len(rows))[:count]
    rows, cols = rows[keep], cols[keep]
    origins, directions = frame.camera.rays_world(np.stack([cols + 0.5, rows + 0.5], 1))
    directions = _unit(directions @ to_canonical[:3, :3].T)
    hits = caster.cast(transform_points(to_canonical, origins), directions)
    ok = hits.hit
    rows, cols, corners, barycentric = rows[ok], cols[ok], mesh.faces[hits.face[ok]], hits.barycentric[ok]
    diffuse, specular = np.full((len(rows), 3), np.nan), np.full(len(rows), np.nan)
    if truth is not None and (truth / "gt" / "albedo.exr").exists():
        diffuse = read_image(truth / "gt" / "albedo.exr").linear[rows, cols]
        specular = 0.04 * read_image(truth / "gt" / "specular.exr").linear[rows, cols].mean(-1)
    return (
        _mix(mesh.vertices, corners, barycentric),
        _unit(_mix(mesh.normals, corners, barycentric)),
        -directions[ok],
        image.linear[rows, cols],
        diffuse,
        specular,
    )


class StoredSamples(Sequence[SceneSamples]):
    """Samples on disk, each scene's loaded when it is asked for."""

    def __init__(self, paths: list[Path]):
        self.paths = paths

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> SceneSamples:
        with np.load(self.paths[index], allow_pickle=False) as data:
            return SceneSamples(**{field.name: data[field.name] for field in fields(SceneSamples)})


def load_samples(
    folders: Sequence[Path],
    *,
    config: SampleConfig = SampleConfig(),
    seed: int = 0,
    workers: int = 2,
    progress: Callable[[], None] = lambda: None,
) -> StoredSamples:
    """Samples of every scene below `folders`, drawn once and kept beside the scenes in `.samples/`.

    Parameters
    ----------
    workers : processes that draw
    progress : called once a scene

    Returns
    -------
    In the order of `list_scenes`.
    """
    scenes, paths = list_scenes(folders), sample_files(folders, config, seed)
    missing = [(scene, path, config, seed) for scene, path in zip(scenes, paths, strict=True) if not path.exists()]
    for _ in range(len(scenes) - len(missing)):
        progress()
    if missing:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for _ in pool.map(_sample_to_file, missing):
                progress()
    return StoredSamples(paths)


def sample_files(folders: Sequence[Path], config: SampleConfig, seed: int) -> list[Path]:
    """Where the samples of every scene below `folders` are kept; names change whenever what they are drawn from does.

    Raises
    ------
    InputError : no scenes, or one that cannot be read.
    """
    scenes = list_scenes(folders)
    return [scene.parent / ".samples" / f"{scene.name}-{_sample_key(scene, config, seed)}.npz" for scene in scenes]


def scenes_digest(folders: Sequence[Path]) -> str:
    """Changes with the scenes below `folders`: names, cameras and poses, sizes of meshes, first pictures.

    Raises
    ------
    InputError : no scenes, or one that cannot be read.
    """
    summed = hashlib.sha256()
    for scene in list_scenes(folders):
        mesh, description = scene / "gt" / "mesh.ply", scene / "transforms.json"
        summed.update(f"{scene.name} {mesh.stat().st_size if mesh.exists() else 0}\n".encode())
        summed.update(description.read_bytes())
        summed.update(read_transforms(description, only_first=True).frames[0].image_path.read_bytes())
    return summed.hexdigest()


def _sample_key(scene: Path, config: SampleConfig, seed: int) -> str:
    """Changes with the configuration and whenever a file is written anew that `sample_scene` reads."""
    truth = ("mesh.ply", "mesh_closed.ply", "landmarks.json", "albedo.exr", "specular.exr")
    files = [scene / "transforms.json", *(scene / "gt" / name for name in truth)]
    files += [path for frame in read_frames(scene) for path in (frame.image_path, frame.mask_path) if path is not None]
    written = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in files if path.exists()]
    return hashlib.sha256(json.dumps([SAMPLES_VERSION, asdict(config), seed, written]).encode()).hexdigest()[:12]


def _sample_to_file(job):
    scene, path, config, seed = job
    samples = sample_scene(scene, config, seed)
    with replacing(path) as temporary:
        np.savez(temporary, **{field.name: getattr(samples, field.name) for field in fields(samples)})
