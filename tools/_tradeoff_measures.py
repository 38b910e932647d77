"""How accurate a finished run is: the measures of `plan.figures`, against a scene's truth and the fitted field.

Notation: lengths in mm in the truth's world, or of the canonical head for the asset beside its field; a measure that
the scene has no truth for is left out.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

# Points each figure is taken over: the noise of a face's mean is then below 0.01 mm.
SAMPLES = 20_000


@dataclass(frozen=True)
class MeasuredScene:
    """A portrait with what is known of it: the true outer surface and the true albedo, or None."""

    name: str
    portrait: object
    truth: object | None
    albedo: np.ndarray | None


def read_measured(folder: Path) -> MeasuredScene:
    """Read a scene and its truth.

    Raises
    ------
    InputError : it cannot be read.
    """
    from sira_assets.measure.outer_surface import outer_surface
    from sira_assets.measure.truth import camera_in_metres, read_truth
    from sira_assets.scene.image import read_image
    from sira_assets.scene.read_scene import read_scene

    portrait, truth, albedo = read_scene(folder), None, None
    if (folder / "gt" / "mesh.ply").is_file():
        truth = read_truth(folder, assumed_unit=portrait.metres_per_unit)
        camera = camera_in_metres(portrait.camera, portrait.metres_per_unit)
        truth = replace(truth, mesh=outer_surface(truth.mesh), camera=camera)
    if (folder / "gt" / "albedo.exr").is_file():
        albedo = read_image(folder / "gt" / "albedo.exr").linear
        albedo = albedo if albedo.shape[:2] == portrait.mask.shape else None
    return MeasuredScene(folder.name, portrait, truth, albedo)


def shape_accuracy(surface, canonical_from_world: np.ndarray, scene: MeasuredScene) -> dict[str, float]:
    """bare_percent of the fitted surface (canonical metres), and face_mm where the scene has a truth."""
    world = surface.transformed(np.linalg.inv(canonical_from_world))
    face = None if scene.truth is None else face_mm(world, scene)
    out = {"bare_percent": bare_percent(world, scene.portrait.camera, scene.portrait.mask)}
    return out if face is None else out | {"face_mm": float(face)}


def bare_percent(mesh_world, camera, mask: np.ndarray) -> float:
    """Share of a mask's pixels through whose centres no surface is seen."""
    from sira_assets.mesh.raycast import Raycaster

    rows, columns = np.nonzero(mask)
    return 100.0 * float(
        (~Raycaster(mesh_world).cast(*camera.rays_world(np.stack([columns, rows], 1) + 0.5)).hit).mean()
    )


def picture_accuracy(journey, scene: MeasuredScene) -> dict[str, float]:
    """final_db and diffuse_db."""
    from sira_assets.measure.image_metrics import score_image

    mask, out = scene.portrait.mask, {}
    out["final_db"] = score_image(journey.view.final, scene.portrait.image_linear, mask).psnr_db
    if scene.albedo is not None:
        score = score_image(journey.view.diffuse, scene.albedo, mask, encoding="linear", scale_invariant=True)
        out["diffuse_db"] = score.psnr_db
    return {name: float(value) for name, value in out.items()}


def face_mm(mesh_world, scene: MeasuredScene, *, samples: int = SAMPLES, seed: int = 0) -> float | None:
    """Mean distance of the true face to a mesh in the scene's world; None without a nose tip."""
    from sira_assets.measure.protocols import ProtocolConfig, measure_prepared

    unit = scene.portrait.metres_per_unit
    pred = mesh_world.transformed(np.diag([unit, unit, unit, 1.0]))
    found = measure_prepared(pred, scene.truth, ProtocolConfig(samples=samples, seed=seed)).distances("face")
    return None if found is None else found.mean_mm


def asset_accuracy(journey) -> dict[str, float]:
    """asset_mm, asset_max_mm and bake_rms of the exported mesh and maps against the fitted field."""
    from sira_assets.fields.head_field import query
    from sira_assets.mesh.extract import bounds_sdf
    from sira_assets.mesh.project import ProjectConfig, project_points
    from sira_assets.mesh.raycast import Raycaster
    from sira_assets.numerics.colour import srgb_from_linear
    from sira_assets.texture.reading import bilinear

    avatar, head = journey.avatar, journey.appearance.head
    mesh = avatar.mesh.transformed(avatar.canonical_from_world)
    points, face, weights = _random_points(mesh, SAMPLES)
    # The box cuts the bust: there the field goes on and the mesh does not.
    inside = bounds_sdf(points) < -0.004
    points, face, weights = points[inside], face[inside], weights[inside]
    moved = project_points(head, points, ProjectConfig(0.005, iterations=8))
    arrived = np.abs(moved.residual_m) <= 2e-5  # ten times the projection's tolerance
    there = np.linalg.norm(moved.points - points, axis=1) + np.abs(moved.residual_m)
    back = Raycaster(mesh).closest(moved.points[arrived]).distance
    uv = (avatar.atlas.uv[avatar.atlas.faces_uv[face[arrived]]] * weights[arrived][..., None]).sum(1)
    baked = bilinear(avatar.textures.diffuse, uv)
    true = query(head, moved.points[arrived], material=True).diffuse
    off = 255.0 * (srgb_from_linear(np.clip(baked, 0, 1)) - srgb_from_linear(np.clip(true, 0, 1)))
    return {
        "asset_mm": 1e3 * float(max(there.mean(), back.mean())),
        "asset_max_mm": 1e3 * float(max(there.max(), back.max())),
        "bake_rms": float(np.sqrt((off**2).mean())),
    }


def _random_points(mesh, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points even in area, their faces and barycentric weights."""
    from sira_assets.measure.surface import sample_surface
    from sira_assets.mesh.simplify import barycentric

    samples = sample_surface(mesh, count, seed=0)
    return samples.points, samples.face, barycentric(samples.points, mesh.vertices[mesh.faces[samples.face]])
