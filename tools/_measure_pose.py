"""Where the head stands: nine noisy 2D landmarks in place of the scene's own `canonical_from_world`.

Notation: errors are of the head in the camera's frame, at the canonical size: turn in degrees, aside in mm across the
line of sight, depth in per cent of the distance.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from _fit_measurement import Scene, face_errors, fit_shape


def measure_pose(scene: Scene, prior, settings, *, noise_px: float) -> dict[str, object]:
    """Pose error before and after the fit, and face errors (mm) beside those with the given pose."""
    estimated = with_estimated_pose(scene, noise_px=noise_px, seed=settings.seed)
    given = fit_shape(scene.portrait, prior, settings)
    found = fit_shape(estimated, prior, settings)
    true = scene.portrait.canonical_from_world
    out = {f"before_{n}": v for n, v in pose_error(estimated, true).items()}
    out |= {f"after_{n}": v for n, v in pose_error(found.portrait, true).items()}
    for name, shape in (("given", given), ("estimated", found)):
        errors = face_errors(shape, scene)
        out |= {f"{name}_{n}": errors[n] for n in ("placed", "after_icp", "after_similarity")}
    return out


def with_estimated_pose(scene: Scene, *, noise_px: float, seed: int):
    """The portrait as one whose landmarks alone are known: the true ones' pixels and gaussian noise."""
    from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M
    from sira_assets.scene.pose import camera_from_canonical

    rng = np.random.default_rng(seed)
    portrait, unit = scene.portrait, scene.portrait.metres_per_unit
    names = [name for name in CANONICAL_LANDMARKS_M if name in scene.truth.landmarks]
    pixels, _ = portrait.camera.project(np.array([scene.truth.landmarks[name] for name in names]) / unit)
    pixels = pixels + noise_px * rng.normal(size=pixels.shape)
    found = dict(zip(names, pixels, strict=True))
    canonical_from_camera = np.linalg.inv(camera_from_canonical(found, portrait.camera.intrinsics))
    placed = canonical_from_camera @ np.diag([unit, unit, unit, 1.0]) @ portrait.camera.camera_from_world
    return replace(portrait, canonical_from_world=placed, landmarks_px=found)


def pose_error(portrait, true_canonical_from_world: np.ndarray) -> dict[str, float]:
    """turn_deg, aside_mm and depth_percent of a portrait's pose."""
    poses = (portrait.canonical_from_world, true_canonical_from_world)
    ours, true = (_camera_from_canonical(portrait.camera, pose) for pose in poses)
    turn = ours[:3, :3] @ true[:3, :3].T
    cosine = np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)
    distance = np.linalg.norm(true[:3, 3])
    a, b = (pose[:3, 3] / np.linalg.norm(pose[:3, 3]) for pose in (ours, true))
    return {
        "turn_deg": float(np.degrees(np.arccos(cosine))),
        "aside_mm": float(1e3 * distance * np.linalg.norm(a - b)),
        "depth_percent": float(100.0 * (np.linalg.norm(ours[:3, 3]) / distance - 1.0)),
    }


def _camera_from_canonical(camera, canonical_from_world: np.ndarray) -> np.ndarray:
    """Rigid: the world is brought to canonical size first."""
    out = camera.camera_from_world @ np.linalg.inv(canonical_from_world)
    scale = np.cbrt(np.linalg.det(out[:3, :3]))
    return np.vstack([out[:3] / scale, out[3]])


def print_pose(rows: list[Mapping[str, object]]) -> None:
    """A line a scene, their mean, and how much worse the face is."""
    from _fit_measurement import mean_of, print_table

    poses = [f"{when}_{what}" for what in ("turn_deg", "aside_mm", "depth_percent") for when in ("before", "after")]
    faces = [f"{who}_{n}" for n in ("placed", "after_icp", "after_similarity") for who in ("given", "estimated")]
    lines = [[row["scene"], *(row[name] for name in (*poses, *faces))] for row in rows]
    print_table(["scene", *poses, *faces], [*lines, ["mean", *(mean_of(rows, n) for n in (*poses, *faces))]])
    for name in ("after_icp", "after_similarity"):
        worse = mean_of(rows, f"estimated_{name}") / mean_of(rows, f"given_{name}") - 1.0
        print(f"face {name.replace('_', ' ')}: {100 * worse:+.1f} % with the estimated pose")
