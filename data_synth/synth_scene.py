"""The noun between drawing a scene and writing it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.render import Rendering
from data_synth.truth import FullTruth
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.envmap import EnvironmentMap
from sira_assets.scene.sg_light import SGLight


@dataclass(frozen=True)
class Frame:
    """What every frame is kept of: image (H, W, 3) float32 linear, mask (H, W) bool. Its maps are ten times as much."""

    image: np.ndarray
    mask: np.ndarray


@dataclass(frozen=True)
class SynthScene:
    """All of a synthetic scene, in its world.

    Parameters
    ----------
    mesh : world metres; vertex_albedo (V, 3) linear
    closed : watertight, its first faces those of `mesh`; `mesh` itself where that is closed
    cameras, frames : one of each a frame; all cameras have the same intrinsics
    portrait : frame 0 with all its maps
    light, roughness : what the frames were rendered with; under a panorama, the gaussians that stand for it
    envmap : the panorama, exactly as rendered, or None where `light` is exact
    canonical_from_world : (4, 4) similarity
    landmarks_world : the nine names of the canonical frame -> (3,)
    landmarks68_world : (68, 3) iBUG, or None; anchors_world (A, 3) dense correspondences, none for a scan
    relight : frame 0 under a second light, or None
    full : what `--truth full` adds, or None
    provenance : how it was drawn; kept in gt/provenance.json
    """

    mesh: TriangleMesh
    closed: TriangleMesh
    vertex_albedo: np.ndarray
    cameras: list[Camera]
    frames: list[Frame]
    portrait: Rendering
    light: SGLight
    envmap: EnvironmentMap | None
    roughness: float
    canonical_from_world: np.ndarray
    landmarks_world: Mapping[str, np.ndarray]
    landmarks68_world: np.ndarray | None
    anchors_world: np.ndarray
    relight: tuple[SGLight, Rendering] | None
    full: FullTruth | None
    provenance: Mapping[str, object]
