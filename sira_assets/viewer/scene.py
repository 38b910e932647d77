"""What a page needs to show an avatar in three dimensions: the exported file, where it is seen from, light, shadows.

Notation: the world is the file's own; V_pk = 1 where vertex p of the file sees direction w_k past the avatar itself,
one bit each. From these bits the page works out every lobe's shadow anew when the light turns, as
render.visibility_table does.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.mesh.raycast import Raycaster
from sira_assets.relight.cameras import orbit_centre, portrait_camera, up_axis
from sira_assets.relight.glb_model import GlbModel, read_glb
from sira_assets.relight.gltf_shading import ROUGHNESS_RANGE
from sira_assets.relight.light_source import own_light
from sira_assets.relight.surface import mesh_of
from sira_assets.render.visibility_table import even_directions, visibility_table
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight

# Resolves lobes up to a sharpness of 256 / pi = 81, three times the sharpest that portraits have asked for; 32 bytes a
# vertex. Beside rays cast for every pixel and lobe it costs what docs/report.md measures.
SHADOW_DIRECTIONS = 256
# Shares travel from vertex to pixel four to a varying; WebGL 2 promises 15, of which the surface takes 5.
MAX_SHADED_LOBES = 40


@dataclass(frozen=True)
class ShadowBits:
    """What the file's vertices see of K even directions.

    Parameters
    ----------
    directions : (K, 3) unit, world
    sharpest : lobes sharper than this are widened to it
    packed : (V, K / 8) uint8, the highest bit first, vertices in the file's order
    """

    directions: np.ndarray
    sharpest: float
    packed: np.ndarray


@dataclass(frozen=True)
class ViewerScene:
    """An avatar to be looked at.

    Parameters
    ----------
    name : one line
    glb : the exported file
    camera : where it is seen from first, world
    is_photos : whether that is the portrait's own camera
    light : world
    up, pivot, radius : the turns' axis and centre, and the radius about the centre that holds all of the avatar; world
    roughness : of the materials, each once, as they are shaded
    brightest : the irradiance, without shadows, that the map of the light shows as white
    shadows : None leaves them out
    """

    name: str
    glb: bytes
    camera: Camera
    is_photos: bool
    light: SGLight
    up: np.ndarray
    pivot: np.ndarray
    radius: float
    roughness: tuple[float, ...]
    brightest: float
    shadows: ShadowBits | None


def viewer_scene(path: str | Path, *, shadows: bool = True, directions: int = SHADOW_DIRECTIONS) -> ViewerScene:
    """Ready an exported GLB for the page.

    Parameters
    ----------
    shadows : cast them; without them too where the light has more than `MAX_SHADED_LOBES` lobes

    Raises
    ------
    InputError : no GLB, or one without its light.
    """
    path = Path(path)
    model = read_glb(path)
    light = own_light(model)
    camera, is_photos = portrait_camera(model)
    pivot = orbit_centre(model)
    used = np.unique(model.faces)
    made_of = {float(np.clip(model.materials[i].roughness, *ROUGHNESS_RANGE)) for i in np.unique(model.material)}
    shaded = shadows and 0 < len(light) <= MAX_SHADED_LOBES
    return ViewerScene(
        path.stem,
        path.read_bytes(),
        camera,
        is_photos,
        light,
        up_axis(model),
        pivot,
        float(np.linalg.norm(model.vertices[used] - pivot, axis=1).max()),
        tuple(sorted(made_of)),
        _brightest(model, light),
        _shadow_bits(model, directions) if shaded else None,
    )


def _brightest(model: GlbModel, light: SGLight) -> float:
    """The 99.5th percentile over the vertices of the brightest channel, as for irradiance.png; 1 in the dark."""
    import torch

    from sira_assets.numerics.sg import irradiance

    parts = (mesh_of(model).normals, light.axis, light.sharpness, light.amplitude)
    received = irradiance(*(torch.as_tensor(np.array(a), dtype=torch.float32) for a in parts)).numpy()
    white = float(np.quantile(received.max(-1), 0.995))
    return white if white > 0 else 1.0


def _shadow_bits(model: GlbModel, count: int) -> ShadowBits:
    import torch

    mesh, shared = mesh_of(model), even_directions(count)
    normals = torch.as_tensor(np.array(mesh.normals), dtype=torch.float32)
    table = visibility_table(Raycaster(mesh), mesh.vertices, normals, shared)
    return ShadowBits(shared.directions.numpy(), shared.sharpest, table.packed.numpy())
