"""Draw one scene: a subject, its pose, cameras and light, and the pictures of it.

Notation: a scene is a function of (settings, index) alone; each of its parts has its own random stream.
"""

import itertools
from dataclasses import replace

import numpy as np

from data_synth.cameras import CameraConfig, sample_cameras, sample_world_from_canonical
from data_synth.head.cover_params import is_plain
from data_synth.occluders import sample_occluder
from data_synth.one_thread import one_thread
from data_synth.render import Occluder, RayScene, RenderConfig, Rendering, Surface, render
from data_synth.scan_back import without_back
from data_synth.scene_light import sample_scene_light
from data_synth.scene_settings import SceneSettings
from data_synth.subject import SkinTone, Subject, procedural_subject
from data_synth.synth_scene import Frame, SynthScene
from data_synth.truth import full_truth
from sira_assets.errors import InputError
from sira_assets.mesh.raycast import Raycaster
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, similarity_scale, transform_points

# One value a scene, chosen to reach from oily to dry skin around the 0.4 to 0.5 that real heads are rendered with.
ROUGHNESS_RANGE = (0.32, 0.52)
FRAMED_ABOVE_M = -0.125  # canonical y: the head down to just below the chin is what cameras frame
FACE_RADIUS_M = 0.095  # around the nose tip, as measured regions have it


def plain_indices(settings: SceneSettings, start: int, count: int) -> list[int]:
    """The first `count` scenes from `start` on whose head is plain (`is_plain`).

    Hats, scarves, beards, and hair that stands off, hangs, is tied or covers the forehead are shapes of their own: a
    shape model with one reference learns heads better without them, and its mean is a face, not a face with a quarter
    of a beard.

    Raises
    ------
    InputError : the scenes show a scan.
    """
    from data_synth.head.params import sample_params

    if settings.scan is not None:
        raise InputError(expected="procedural heads", received="a scan", remedy="leave --plain away")
    found = []
    while len(found) < count:
        head = np.random.default_rng(settings.stream(start).spawn(5)[0])
        if is_plain(sample_params(head)):
            found.append(start)
        start += 1
    return found


@one_thread
def draw_scene(settings: SceneSettings, index: int, *, tone: SkinTone | None = None) -> SynthScene:
    """Draw and render scene `index`; a pure function of its arguments (and of a scan's files).

    Parameters
    ----------
    tone : other skin for a procedural head; pose, cameras and light stay what they are for every `tone.melanin`
    """
    streams = settings.stream(index).spawn(5)
    rng_head, rng_pose, rng_light, rng_render, rng_truth = (np.random.default_rng(child) for child in streams)
    if settings.scan is None:
        subject = procedural_subject(rng_head, tone)
    else:
        from data_synth.import_scan import scan_subject

        subject = scan_subject(settings.scan)
    world_from_canonical = _pose(rng_pose, subject)
    framed = subject.mesh.vertices[subject.mesh.vertices[:, 1] > FRAMED_ABOVE_M]
    camera_config = CameraConfig(width=settings.size, height=settings.size, crops=settings.crops)
    if subject.around_yaw_deg is not None:
        camera_config = replace(camera_config, around_yaw=min(subject.around_yaw_deg, camera_config.around_yaw))
    cameras = sample_cameras(rng_pose, framed, world_from_canonical, settings.views, camera_config)

    nose_tip = subject.landmarks.get("nose_tip", CANONICAL_LANDMARKS_M["nose_tip"])
    face = np.linalg.norm(subject.mesh.vertices - nose_tip, axis=1) < FACE_RADIUS_M
    rotation = world_from_canonical[:3, :3] / similarity_scale(world_from_canonical)
    roughness = float(rng_light.uniform(*ROUGHNESS_RANGE))
    mesh = subject.mesh.transformed(world_from_canonical)
    metered = subject.vertex_albedo if subject.metered_albedo is None else subject.metered_albedo
    lit = (mesh, metered, face, rotation)
    first, second = sample_scene_light(rng_light, *lit, settings.panoramas), sample_scene_light(rng_light, *lit)
    light = first.gaussians
    closed = mesh if subject.closed is subject.mesh else subject.closed.transformed(world_from_canonical)
    rendered = subject.rendered.transformed(world_from_canonical)
    occluder = None
    if rng_pose.random() < settings.occluders:
        occluder = _held_before(rng_pose, subject, cameras[0], world_from_canonical)
    rays = RayScene(Surface(rendered, subject.material_coordinates, subject.material, roughness, occluder))
    config = RenderConfig(settings.samples, settings.supersample)
    caster = None if closed is mesh else Raycaster(mesh)

    def seen_by(camera: Camera) -> Rendering:
        out = render(rays, camera, first.rendered, rng_render, config)
        return out if caster is None else without_back(out, camera, caster, mesh)

    portrait = seen_by(cameras[0])
    others = (seen_by(camera) for camera in cameras[1:])
    frames = [Frame(rendering.image, rendering.mask) for rendering in itertools.chain([portrait], others)]
    relight = None
    if settings.kind == "eval":
        relight = (second.gaussians, render(rays, cameras[0], second.rendered, rng_render, config))
    full = None
    if settings.truth == "full":
        names = subject.region_names
        full = full_truth(
            rays, cameras, light, mesh, closed, subject.regions, names, rng_truth, directions=settings.samples
        )
        full = replace(full, visibility=full.visibility * portrait.mask)
    return SynthScene(
        mesh=mesh,
        closed=closed,
        vertex_albedo=subject.vertex_albedo,
        cameras=cameras,
        frames=frames,
        portrait=portrait,
        light=light,
        envmap=first.envmap,
        roughness=roughness,
        canonical_from_world=np.linalg.inv(world_from_canonical),
        landmarks_world={n: transform_points(world_from_canonical, p) for n, p in subject.landmarks.items()},
        landmarks68_world=_moved(world_from_canonical, subject.landmarks68),
        anchors_world=_moved(world_from_canonical, subject.anchors),
        relight=relight,
        full=full,
        provenance={
            "settings": settings.described(),
            "index": index,
            "rig": first.name,
            "relight_rig": second.name if relight else None,
            "occluder": None if occluder is None else occluder.kind,
            **subject.provenance,
        },
    )


def _pose(rng: np.random.Generator, subject: Subject) -> np.ndarray:
    """`world_from_canonical`, with the subject's own size where it has one."""
    out = sample_world_from_canonical(rng)
    if subject.scale is not None:
        out[:3, :3] *= subject.scale / similarity_scale(out)
    return out


def _held_before(
    rng: np.random.Generator, subject: Subject, camera: Camera, world_from_canonical: np.ndarray
) -> Occluder:
    """Something between the face and `camera`, in the world."""
    centre = np.mean([subject.landmarks[name] for name in subject.landmarks], axis=0)
    eye = transform_points(np.linalg.inv(world_from_canonical), camera.centre_world[None])[0]
    towards = (eye - centre) / np.linalg.norm(eye - centre)
    held = sample_occluder(rng, subject.mesh.vertices, centre, towards)
    return replace(held, mesh=held.mesh.transformed(world_from_canonical))


def _moved(matrix: np.ndarray, points: np.ndarray | None) -> np.ndarray | None:
    return None if points is None else transform_points(matrix, points)
