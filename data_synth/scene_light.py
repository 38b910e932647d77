"""A scene's light: a rig drawn by seed, or one of the user's panoramas, exposed for the face it falls on.

Notation: all in the scene's world, +Y up.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from data_synth.cameras import rotation_xyz
from data_synth.light_rigs import sample_rig
from data_synth.lights import face_luminance, sample_exposure
from data_synth.render_panorama import PanoramaSource
from data_synth.render_source import LUMINANCE, LightSource
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.envmap import EnvironmentMap, read_envmap
from sira_assets.scene.envmap_resample import envmap_resized, envmap_yawed
from sira_assets.scene.sg_light import SGLight

# Panoramas are rendered with at most so many rows: a pixel of 0.35 degrees, a sun of one or two pixels.
MOST_ROWS = 512


@dataclass(frozen=True)
class PanoramaFile:
    """A panorama of the user's and the spherical gaussians that stand for it.

    Parameters
    ----------
    path : .exr or .hdr, lat-long
    lights : of `SGLight.to_dict`, as JSON text, in the map's frame
    """

    path: str
    lights: str

    @lru_cache(maxsize=32)  # noqa: B019 - hashes by value, two strings
    def digest(self) -> str:
        """SHA-256 of the file and its gaussians, hexadecimal; read once a process."""
        return sha256(sha256(Path(self.path).read_bytes()).digest() + self.lights.encode()).hexdigest()

    def described(self) -> dict:
        """For a file: no paths of this machine."""
        return {"file": Path(self.path).name, "sha256": self.digest()}


@lru_cache(maxsize=4)
def load_panorama(path: str) -> EnvironmentMap:
    """The map as it is rendered, in its own frame and exposure."""
    envmap = read_envmap(path)
    envmap = EnvironmentMap(np.maximum(envmap.radiance, 0.0))
    return envmap_resized(envmap, MOST_ROWS) if envmap.radiance.shape[0] > MOST_ROWS else envmap


@dataclass(frozen=True)
class SceneLight:
    """What lights a scene.

    Parameters
    ----------
    name : of the rig, or the panorama's file
    gaussians : what lights.json holds: the light itself, or what stands for a panorama
    rendered : what the pictures are made with
    envmap : the exact map where `gaussians` are not exact, or None
    """

    name: str
    gaussians: SGLight
    rendered: SGLight | LightSource
    envmap: EnvironmentMap | None


def sample_scene_light(
    rng: np.random.Generator,
    mesh_world: TriangleMesh,
    diffuse: np.ndarray,
    face: np.ndarray,
    world_from_head: np.ndarray,
    panoramas: tuple[PanoramaFile, ...] = (),
) -> SceneLight:
    """Draw a light that exposes the face well.

    Parameters
    ----------
    diffuse : (V, 3) linear albedo of the mesh; face (V,) bool, the vertices to expose for
    world_from_head : (3, 3) rotation; rigs turn with the head, panoramas are turned about +Y by a random whole number
        of their columns
    panoramas : one of these, if there are any, in place of a rig
    """
    target = sample_exposure(rng, float((diffuse[face] @ LUMINANCE).mean()))

    def gain(light: SGLight | LightSource) -> float:
        return target / max(face_luminance(mesh_world, diffuse, light, face), 1e-6)

    if not panoramas:
        rig = sample_rig(rng)
        light = rig.light().rotated(world_from_head)
        light = light.scaled(gain(light))
        return SceneLight(rig.name, light, light, None)
    file = panoramas[rng.integers(len(panoramas))]
    envmap = load_panorama(file.path)
    degrees = 360.0 * float(rng.integers(envmap.radiance.shape[1])) / envmap.radiance.shape[1]
    envmap = envmap_yawed(envmap, degrees)
    by = gain(PanoramaSource(envmap))
    envmap = EnvironmentMap(envmap.radiance * np.float32(by))
    gaussians = SGLight.from_dict(json.loads(file.lights)).rotated(rotation_xyz(0.0, degrees, 0.0)).scaled(by)
    return SceneLight(Path(file.path).name, gaussians, PanoramaSource(envmap), envmap)
