"""Render an exported asset: its triangles and textures, ray cast, under spherical gaussian light, with cast shadows.

Notation: pictures are (H, W, ...), row 0 on top; a pixel is the mean of k x k samples on a grid; radiance is linear and
premultiplied by alpha, the share of a pixel's samples that meet the asset. What glTF shades differently from SIRA's
own model stands in `gltf_shading`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.mesh.raycast import Raycaster
from sira_assets.relight.glb_model import GlbModel, unit
from sira_assets.relight.gltf_shading import shade_surface
from sira_assets.relight.surface import Surface, mesh_of, surface_at
from sira_assets.render.visibility import lobe_visibility
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight

MAX_SUPERSAMPLE = 8
# Rays cast at once: about 0.2 GB with their hits. A picture of 4096 x 4096 with 3 x 3 samples has 150 times as many.
_RAYS_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class SeenAsset:
    """An asset as one camera meets it; light and shadow come later, so that a turning light costs no tracing.

    Parameters
    ----------
    camera : of the finished picture
    supersample : k, samples are k x k to a pixel
    index : (N,) samples that hit, into the grid (H k, W k)
    surface : at the hits
    normals : (N, 3) mapped normals turned to the camera's side
    view : (N, 3) unit, towards the camera
    raycaster : the asset's triangles
    """

    camera: Camera
    supersample: int
    index: np.ndarray
    surface: Surface
    normals: np.ndarray
    view: np.ndarray
    raycaster: Raycaster

    def picture(self, values: np.ndarray) -> np.ndarray:
        """(H, W, ...) float32 pixel means of values (N, ...) at the hits; samples that miss count as 0."""
        k, height, width = self.supersample, self.camera.height, self.camera.width
        out = np.zeros((height * k * width * k, *values.shape[1:]), np.float32)
        out[self.index] = values
        return out.reshape(height, k, width, k, *values.shape[1:]).mean((1, 3), dtype=np.float32)


@dataclass(frozen=True)
class AssetRender:
    """A picture of an asset and its parts.

    Parameters
    ----------
    radiance : (H, W, 3) float32, linear, premultiplied: black behind
    alpha : (H, W) float32 in [0, 1]
    diffuse, specular : (H, W, 3), whose sum is `radiance`
    visibility : (H, W) the share of the light's specular and diffuse radiance that shadows leave, premultiplied
    """

    radiance: np.ndarray
    alpha: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    visibility: np.ndarray


def see_asset(model: GlbModel, camera: Camera, *, supersample: int = 2) -> SeenAsset:
    """Trace a camera's rays to an asset in the asset's own world.

    A triangle seen from behind is shaded on that side. A smooth normal that turns away although its triangle faces the
    camera, as happens along silhouettes, is lit as seen edge-on.

    Raises
    ------
    InputError : supersample outside 1 to 8, or no ray meets the asset.
    """
    if not 1 <= supersample <= MAX_SUPERSAMPLE:
        raise InputError(
            expected=f"1 to {MAX_SUPERSAMPLE} samples a side", received=f"{supersample}", remedy="choose 2"
        )
    mesh = mesh_of(model)
    raycaster = Raycaster(mesh)
    fine = camera.resized(camera.width * supersample, camera.height * supersample)
    index, face, barycentric, view = _first_hits(raycaster, fine)
    if not len(index):
        behind = (camera.project(mesh.vertices)[1] <= 0).all()
        raise InputError(
            expected="a camera that sees the avatar",
            received="one with the whole avatar behind it" if behind else "one that looks past it",
            remedy="give the camera in the avatar's own world, or leave --camera out",
        )
    surface = surface_at(model, mesh, face, barycentric)
    a, b, c = (mesh.vertices[mesh.faces[face, k]] for k in range(3))
    away = (np.cross(b - a, c - a) * view).sum(1, keepdims=True) < 0.0
    normals = np.where(away, -surface.mapped_normal, surface.mapped_normal)
    normals = unit(normals - np.minimum((normals * view).sum(1, keepdims=True), 0.0) * view)
    return SeenAsset(camera, supersample, index, surface, normals, view, raycaster)


def _first_hits(raycaster: Raycaster, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the pixels that hit: their number, row by row, face, barycentric weights, and direction to the camera.

    Rays are cast in bands of rows, of which only the hits are kept.
    """
    rows = max(1, _RAYS_AT_ONCE // camera.width)
    found = []
    for first in range(0, camera.height, rows):
        last = min(first + rows, camera.height)
        x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(first, last) + 0.5)
        origins, directions = camera.rays_world(np.stack([x, y], -1).reshape(-1, 2))
        hits = raycaster.cast(origins, directions)
        hit = np.flatnonzero(hits.hit)
        found.append((first * camera.width + hit, hits.face[hit], hits.barycentric[hit], -directions[hit]))
    index, face, barycentric, view = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return index, face, barycentric, view


def visibility_of(
    seen: SeenAsset, light: SGLight, *, rays: int, seed: int = 0, report: Callable[[int, int], None] = lambda d, n: None
) -> np.ndarray:
    """(N, M) share of each lobe's light that reaches each sample.

    Parameters
    ----------
    rays : for every pixel, divided among its samples and the lobes; at least one each
    report : called with (lobes done, lobes in all)
    """
    each = max(1, round(rays / (seen.supersample**2 * max(len(light), 1))))
    out = np.ones((len(seen.surface), len(light)), np.float32)
    points = seen.surface.points
    for i in range(len(light)):
        lobe = (light.axis[i : i + 1], light.sharpness[i : i + 1])
        out[:, i] = lobe_visibility(seen.raycaster, points, seen.normals, *lobe, rays=each, seed=seed + i)[:, 0]
        report(i + 1, len(light))
    return out


def light_asset(
    seen: SeenAsset, light: SGLight, *, visibility: np.ndarray | None = None, gltf_weighting: bool = True
) -> AssetRender:
    """Shade what a camera sees; `visibility` (N, M) from `visibility_of`, or None for no shadows."""
    options = {"gltf_weighting": gltf_weighting}
    shaded = shade_surface(seen.surface, seen.normals, seen.view, light, visibility=visibility, **options)
    alpha = seen.picture(np.ones(len(seen.surface), np.float32))
    share = alpha
    if visibility is not None:
        free = shade_surface(seen.surface, seen.normals, seen.view, light, **options)
        left, whole = (x.diffuse.sum(1) + x.specular.sum(1) for x in (shaded, free))
        share = seen.picture(np.where(whole > 0, left / np.maximum(whole, 1e-30), 1.0))
    diffuse, specular = seen.picture(shaded.diffuse), seen.picture(shaded.specular)
    return AssetRender(diffuse + specular, alpha, diffuse, specular, share)


def render_asset(
    model: GlbModel,
    camera: Camera,
    light: SGLight,
    *,
    shadows: bool,
    supersample: int = 2,
    rays: int = 512,
    seed: int = 0,
    gltf_weighting: bool = True,
) -> AssetRender:
    """Ray cast an exported asset and shade it by glTF's BRDF, in closed form.

    Parameters
    ----------
    camera : in the asset's own world
    light : lobes in that world
    shadows : cast shadows, by about `rays` rays for every pixel
    supersample : k x k samples a pixel
    gltf_weighting : diffuse weighed by 1 - max F, as glTF has it and SIRA has not (see `gltf_shading`)

    Raises
    ------
    InputError : the camera sees nothing of the asset, or supersample is out of range.
    """
    seen = see_asset(model, camera, supersample=supersample)
    visibility = visibility_of(seen, light, rays=rays, seed=seed) if shadows else None
    return light_asset(seen, light, visibility=visibility, gltf_weighting=gltf_weighting)
