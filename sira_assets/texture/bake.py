"""From a field to maps over an atlas.

Notation: a texel's mean point on the mesh is moved onto the field's zero set (at most a few millimetres) and its normal
taken there; the same move carries the texel's k x k surface samples, whose albedos are averaged. So the maps carry the
field's detail and not the triangles'. Normals are not supersampled: it costs four times the network gradients, and a
field's normals hardly turn within a texel of half a millimetre, while albedos have edges.
Irradiance E(n) = integral of L(w) V(w) max(0, n.w) over the sphere, of the SG light alone; V, the head's own cast
shadows, is 1 where none are given.
Everything is in the canonical frame.
"""

from dataclasses import dataclass, field

import numpy as np

from sira_assets.errors import InputError
from sira_assets.fields.head_field import HeadField, query
from sira_assets.mesh.project import ProjectConfig, project_points
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.render.visibility import SurfaceVisibility
from sira_assets.scene.sg_light import SGLight
from sira_assets.texture.atlas import Atlas, vertex_of_uv
from sira_assets.texture.raster import AtlasSamples, rasterise
from sira_assets.texture.tangents import tangents, to_tangent_space
from sira_assets.texture.texture_set import TextureSet


@dataclass(frozen=True)
class BakeConfig:
    """Size and quality of the maps.

    Parameters
    ----------
    size : texels a side
    samples : k; each texel averages the albedos of k x k samples
    rows_per_chunk : texel rows baked at once; bounds the memory, changes nothing else
    project : how samples reach the zero set; 20 micrometres is far below a texel (about 0.3 mm at 1024)
    min_cosine : a projected sample whose field normal turns further than this from the mesh's is kept on the mesh:
        it has gone over to another part of the surface
    """

    size: int = 1024
    samples: int = 2
    rows_per_chunk: int = 64
    project: ProjectConfig = field(default_factory=lambda: ProjectConfig(0.003, 2e-5, 2))
    min_cosine: float = 0.2


@dataclass(frozen=True)
class _Surface:
    """The mesh and its frames, corner by corner: (F, 3, 3) each, hand (F,)."""

    positions: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    hand: np.ndarray


def bake(
    field: HeadField,
    mesh_canonical: TriangleMesh,
    atlas: Atlas,
    light: SGLight,
    world_from_canonical: np.ndarray,
    config: BakeConfig = BakeConfig(),
    *,
    shadows: SurfaceVisibility | None = None,
    device: str = "cpu",
) -> TextureSet:
    """Bake albedos, normals and irradiance of `field` over `mesh_canonical`.

    Parameters
    ----------
    mesh_canonical : the mesh that will be exported, still in canonical metres
    light : in the scene's world frame
    world_from_canonical : (4, 4) similarity; only its rotation matters here
    shadows : what the full surface sees of this light; the irradiance map is without cast shadows if None

    Returns
    -------
    TextureSet : all texels filled.

    Raises
    ------
    InputError : the atlas is of another mesh, covers no texel, or the field gives values that are not finite.
    """
    vertex_of_uv(mesh_canonical, atlas)
    frame = tangents(mesh_canonical, atlas)[atlas.faces_uv]
    corners = mesh_canonical.faces
    surface = _Surface(
        mesh_canonical.vertices[corners], mesh_canonical.normals[corners], frame[..., :3], frame[:, 0, 3]
    )
    size = config.size
    # Columns: diffuse 3, specular 1, tangent-space normal 3, canonical normal 3, position 3.
    found = np.zeros((size * size, 13))
    coverage = np.zeros(size * size, bool)
    for first in range(0, size, config.rows_per_chunk):
        last = min(first + config.rows_per_chunk, size)
        samples = rasterise(atlas.uv, atlas.faces_uv, size, samples=config.samples, first_row=first, last_row=last)
        if len(samples.face):
            texels, band = _bake_rows(field, surface, samples, config, device)
            found[texels], coverage[texels] = band, True
    if not coverage.any():
        raise InputError(expected="an atlas that covers some texels", received="none", remedy="unwrap again")
    values = np.zeros((size * size, 10), np.float32)
    values[:, :7] = found[:, :7]
    seen = shadows.near(Raycaster(shadows.mesh), found[coverage, 10:]) if shadows is not None else None
    values[coverage, 7:] = _irradiance(found[coverage, 7:10], light, world_from_canonical, seen)
    maps = fill_empty(values.reshape(size, size, 10), coverage.reshape(size, size))
    return TextureSet(
        diffuse=np.ascontiguousarray(maps[..., :3]),
        specular_f0=np.ascontiguousarray(maps[..., 3]),
        normal_tangent=np.ascontiguousarray(maps[..., 4:7]),
        irradiance=np.ascontiguousarray(maps[..., 7:]),
        coverage=coverage.reshape(size, size),
    )


def fill_empty(values: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Give every uncovered texel the value of the nearest covered one.

    Nearest and not a blurred dilation: a blur darkens seams, and mipmaps reach any distance, so all texels are filled.

    Parameters
    ----------
    values : (S, S, C)
    coverage : (S, S) bool, some True
    """
    from scipy.ndimage import distance_transform_edt

    row, column = distance_transform_edt(~coverage, return_distances=False, return_indices=True)
    return values[row, column]


def _bake_rows(
    field: HeadField,
    surface: _Surface,
    samples: AtlasSamples,
    config: BakeConfig,
    device: str,
) -> tuple[np.ndarray, np.ndarray]:
    """Texels of a band that have samples, and their (N, 13) values: albedos, both normals, position."""
    texels, local = np.unique(samples.texel, return_inverse=True)
    count = np.bincount(local)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(local, column) for column in values.T], 1) / count

    position, normal, tangent = (
        np.einsum("nk,nkc->nc", samples.barycentric, corner[samples.face])
        for corner in (surface.positions, surface.normals, surface.tangents)
    )
    centre, normal, tangent = mean(position), _unit(mean(normal), (0.0, 0.0, 1.0)), mean(tangent)
    hand = np.where(mean(surface.hand[samples.face][:, None])[:, 0] < 0, -1.0, 1.0)
    moved = project_points(field, centre, config.project, device=device)
    # Ten times the tolerance: the last step of a point that converges may fall a little short of it.
    good = np.abs(moved.residual_m) <= 10 * config.project.tolerance_m
    good &= (moved.normals * normal).sum(1) > config.min_cosine
    detail = np.where(good[:, None], moved.normals, normal)
    shift = np.where(good[:, None], moved.points - centre, 0.0)
    position = position + shift[local]
    there = query(field, position, material=True, device=device)
    bad = ~(np.isfinite(there.diffuse).all(1) & np.isfinite(there.specular_f0))
    if bad.any():
        raise InputError(
            expected="finite albedos on the surface",
            received=f"{int(bad.sum())} samples not finite, the first at {position[bad][0].round(4).tolist()}",
            remedy="the weights are damaged or the fit diverged; fit again",
        )
    albedos = mean(np.column_stack([there.diffuse, there.specular_f0]))
    return texels, np.column_stack([albedos, to_tangent_space(detail, normal, tangent, hand), detail, centre + shift])


def _irradiance(
    normals: np.ndarray, light: SGLight, world_from_canonical: np.ndarray, visibility: np.ndarray | None
) -> np.ndarray:
    """(N, 3) irradiance at canonical unit normals; the light is turned into their frame."""
    if not len(light):
        return np.zeros((len(normals), 3), np.float32)
    import torch

    from sira_assets.numerics.sg import irradiance

    linear = np.asarray(world_from_canonical, np.float64)[:3, :3]
    canonical_from_world = (linear / np.cbrt(np.linalg.det(linear))).T
    turned = light.rotated(canonical_from_world)
    axis, sharpness, amplitude = (
        torch.tensor(a, dtype=torch.float32) for a in (turned.axis, turned.sharpness, turned.amplitude)
    )
    out = []
    chunk = max(1, 2_000_000 // len(light))  # normals times lobes held at once
    with torch.no_grad():
        for start in range(0, len(normals), chunk):
            rows = slice(start, start + chunk)
            n = torch.tensor(normals[rows], dtype=torch.float32)
            seen = None if visibility is None else torch.tensor(visibility[rows])
            out.append(irradiance(n, axis, sharpness, amplitude, visibility=seen).numpy())
    return np.concatenate(out)


def _unit(vectors: np.ndarray, otherwise: tuple[float, float, float]) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-9, vectors / np.maximum(length, 1e-300), np.array(otherwise))
