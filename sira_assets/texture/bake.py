"""From a field to maps over an atlas.

Notation: a texel's mean point on the mesh is moved onto the field's zero set (at most a few millimetres) and its normal
taken there; the same move carries the texel's k x k surface samples, whose albedos are averaged. So the maps carry the
field's detail and not the triangles'. Normals are not supersampled: it costs four times the network gradients, and a
field's normals hardly turn within a texel of half a millimetre, while albedos have edges.
Texels at the border of a chart, and those one beyond it, take their samples from the plane of the nearest face, moved
onto the zero set as well: there stands what the surface shows beyond the seam, so both sides of a seam read the same.
Where they do not all the same (folds), `seams.even_seams` moves the texels there; tangent-space normals are relative to
each side's own tangents, and positions are exact, so these two are left.
Everything is in the canonical frame.
"""

from dataclasses import dataclass, field

import numpy as np

from sira_assets.errors import InputError
from sira_assets.fields.head_field import HeadField, query
from sira_assets.mesh.project import ProjectConfig, project_points
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.render.visibility import SurfaceVisibility, ambient_occlusion
from sira_assets.scene.canonical import transform_points
from sira_assets.scene.sg_light import SGLight
from sira_assets.texture.atlas import Atlas, vertex_of_uv
from sira_assets.texture.light_maps import light_maps
from sira_assets.texture.raster import border_texels, rasterise
from sira_assets.texture.seams import Seams, even_seams, find_seams
from sira_assets.texture.tangents import tangents, to_tangent_space
from sira_assets.texture.texture_set import DEFAULT_MAPS, TextureSet, check_maps

# Samples baked at once: about 0.5 GB with a network's activations.
_SAMPLES_AT_ONCE = 1 << 20
# Bilinear reading at a chart's border looks up to one texel beyond it.
_REACH = 1
# A thin face's plane may lead astray: beyond the border no sample goes further from the face than this many texels.
_FURTHEST_TEXELS = 4.0


@dataclass(frozen=True)
class BakeConfig:
    """Size and quality of the maps.

    Parameters
    ----------
    size : texels a side
    samples : k; each texel averages the albedos of k x k samples
    maps : those wanted, of `texture_set.MAPS`
    rows_per_chunk : texel rows baked at once; bounds the memory, changes nothing else. As many as a million samples
        fill if None
    project : how samples reach the zero set; 20 micrometres is far below a texel (about 0.3 mm at 1024)
    min_cosine : a projected sample whose field normal turns further than this from the mesh's is kept on the mesh:
        it has gone over to another part of the surface
    occlusion_rays : rays from each vertex of the full surface, for the occlusion map
    """

    size: int = 1024
    samples: int = 2
    maps: tuple[str, ...] = DEFAULT_MAPS
    rows_per_chunk: int | None = None
    project: ProjectConfig = field(default_factory=lambda: ProjectConfig(0.003, 2e-5, 2))
    min_cosine: float = 0.2
    occlusion_rays: int = 256

    def __post_init__(self):
        check_maps(self.maps)


@dataclass(frozen=True)
class _Surface:
    """The mesh and its frames, corner by corner: (F, 3, 3) each, hand (F,); the length of a texel, metres."""

    positions: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    hand: np.ndarray
    texel_m: float


@dataclass(frozen=True)
class _Samples:
    """Samples of a band: face, weights and texel; the weights `held` they fall back on where a plane leads astray."""

    face: np.ndarray
    weights: np.ndarray
    held: np.ndarray
    texel: np.ndarray


@dataclass(frozen=True)
class _Texels:
    """N baked texels, float32; diffuse and specular_f0 are None where no map needs them."""

    number: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    normal_tangent: np.ndarray
    diffuse: np.ndarray | None
    specular_f0: np.ndarray | None


def bake(
    field: HeadField,
    mesh_canonical: TriangleMesh,
    atlas: Atlas,
    light: SGLight,
    world_from_canonical: np.ndarray,
    config: BakeConfig = BakeConfig(),
    *,
    shadows: SurfaceVisibility | None = None,
    surface: TriangleMesh | None = None,
    roughness: float | None = None,
    device: str = "cpu",
) -> TextureSet:
    """Bake the maps asked for of `field` over `mesh_canonical`.

    Parameters
    ----------
    mesh_canonical : the mesh that will be exported, still in canonical metres
    light : in the scene's world frame
    world_from_canonical : (4, 4) similarity
    shadows : what the full surface sees of this light; light arrives everywhere if None
    surface : the full surface, which the occlusion map is cast on; that of `shadows`, or the mesh itself, if None
    roughness : of the highlights in the radiance map; `render.shading.ROUGHNESS` if None

    Returns
    -------
    TextureSet : all texels of the maps asked for filled, the others None.

    Raises
    ------
    InputError : the atlas is of another mesh, covers no texel, or the field gives values that are not finite.
    """
    vertex_of_uv(mesh_canonical, atlas)
    size = config.size
    corners = _corner_frames(mesh_canonical, atlas, size)
    coverage = np.zeros((size, size), bool)
    bands = []
    rows = config.rows_per_chunk or max(1, _SAMPLES_AT_ONCE // (size * config.samples**2))
    for first in range(0, size, rows):
        last = min(first + rows, size)
        samples, coverage[first:last] = _band_samples(atlas, config, first, last)
        if len(samples.face):
            bands.append(_bake_band(field, corners, samples, config, device))
    if not coverage.any():
        raise InputError(expected="an atlas that covers some texels", received="none", remedy="unwrap again")
    found = _joined(bands)
    seams = find_seams(mesh_canonical, atlas, size)
    lit = (light, roughness, shadows, surface or mesh_canonical)
    return _maps(found, coverage, seams, world_from_canonical, config, *lit)


def _maps(
    found: _Texels,
    coverage: np.ndarray,
    seams: Seams,
    world_from_canonical: np.ndarray,
    config: BakeConfig,
    light: SGLight,
    roughness: float | None,
    shadows: SurfaceVisibility | None,
    surface: TriangleMesh,
) -> TextureSet:
    """Light and occlusion at the baked texels, and every map filled."""
    wanted, size = config.maps, len(coverage)
    nearest = _nearest_filled(found.number, size)

    def picture(values: np.ndarray, name: str) -> np.ndarray | None:
        if name not in wanted:
            return None
        filled = np.ascontiguousarray(values.astype(np.float32)[nearest])
        return filled if name in ("normal", "position") else even_seams(filled, seams)

    linear = np.asarray(world_from_canonical, np.float64)[:3, :3]
    turned = light.rotated((linear / np.cbrt(np.linalg.det(linear))).T)
    seen = None
    if shadows is not None and {"irradiance", "visibility", "radiance"} & set(wanted):
        seen = shadows.near(Raycaster(shadows.mesh), found.position.astype(np.float64))
    irradiance = radiance = occlusion = visibility = None
    if {"irradiance", "radiance"} & set(wanted):
        albedos = {"diffuse": found.diffuse, "specular_f0": found.specular_f0} if "radiance" in wanted else {}
        irradiance, radiance = light_maps(found.normal, turned, seen, roughness=roughness, **albedos)
    if "visibility" in wanted:
        visibility = np.ones((len(found.number), len(light)), np.float32) if seen is None else seen
    if "occlusion" in wanted:
        occlusion = _occlusion(shadows.mesh if shadows is not None else surface, found.position, config)
    return TextureSet(
        diffuse=picture(found.diffuse, "diffuse") if "diffuse" in wanted else None,
        specular_f0=picture(found.specular_f0, "specular") if "specular" in wanted else None,
        normal_tangent=picture(found.normal_tangent, "normal"),
        irradiance=picture(irradiance, "irradiance") if irradiance is not None else None,
        coverage=coverage,
        occlusion=picture(occlusion, "occlusion") if occlusion is not None else None,
        position=picture(transform_points(world_from_canonical, found.position.astype(np.float64)), "position"),
        visibility=picture(visibility, "visibility") if visibility is not None else None,
        radiance=picture(radiance, "radiance") if radiance is not None else None,
    )


def _occlusion(surface: TriangleMesh, points: np.ndarray, config: BakeConfig) -> np.ndarray:
    """(N,) open share at points near the surface, linear over its triangles."""
    caster = Raycaster(surface)
    share = ambient_occlusion(caster, surface.vertices, surface.normals, rays=config.occlusion_rays)
    return SurfaceVisibility(surface, share[:, None]).near(caster, points.astype(np.float64))[:, 0]


def _corner_frames(mesh: TriangleMesh, atlas: Atlas, size: int) -> _Surface:
    frame = tangents(mesh, atlas)[atlas.faces_uv]
    positions = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]), axis=1)
    texel = np.sqrt(area.sum() / max(atlas.report.utilisation, 1e-3)) / size
    return _Surface(positions, mesh.normals[mesh.faces], frame[..., :3], frame[:, 0, 3], float(texel))


def _band_samples(atlas: Atlas, config: BakeConfig, first: int, last: int) -> tuple[_Samples, np.ndarray]:
    """All samples of texel rows `first` to `last`, and (rows, S) which of the texels a face touches."""
    size, k = config.size, config.samples
    held = rasterise(atlas.uv, atlas.faces_uv, size, samples=k, first_row=first, last_row=last)
    count = np.bincount(held.texel - first * size, minlength=(last - first) * size).reshape(last - first, size)
    inner = count == k * k
    at_border, nearest = border_texels(
        atlas.uv, atlas.faces_uv, size, samples=k, first_row=first, last_row=last, inner=inner, reach=_REACH
    )
    keep = inner.reshape(-1)[held.texel - first * size]
    # A texel of faces without any area has no plane; it keeps the points it was given.
    bare = ~np.isin(held.texel, at_border.texel) & ~keep
    keep |= bare
    # One and the same texel's samples may not be spread over the band: its mean is taken by number.
    samples = _Samples(
        np.concatenate([held.face[keep], at_border.face]),
        np.concatenate([held.barycentric[keep], at_border.barycentric]),
        np.concatenate([held.barycentric[keep], nearest]),
        np.concatenate([held.texel[keep], at_border.texel]),
    )
    return samples, count > 0


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


def _bake_band(field: HeadField, surface: _Surface, samples: _Samples, config: BakeConfig, device: str) -> _Texels:
    """Bake the texels that a band's samples lie in."""
    texels, local = np.unique(samples.texel, return_inverse=True)
    count = np.bincount(local)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(local, column) for column in values.T], 1) / count

    position = np.einsum("nk,nkc->nc", samples.weights, surface.positions[samples.face])
    beyond = (samples.weights != samples.held).any(1)
    anchor = np.einsum("nk,nkc->nc", samples.held[beyond], surface.positions[samples.face[beyond]])
    weights = samples.weights.copy()
    astray = np.linalg.norm(position[beyond] - anchor, axis=1) > _FURTHEST_TEXELS * surface.texel_m
    lost = np.flatnonzero(beyond)[astray]
    weights[lost], position[lost] = samples.held[lost], anchor[astray]
    normal, tangent = (
        np.einsum("nk,nkc->nc", weights, corner[samples.face]) for corner in (surface.normals, surface.tangents)
    )
    centre, normal, tangent = mean(position), _unit(mean(normal), (0.0, 0.0, 1.0)), mean(tangent)
    hand = np.where(mean(surface.hand[samples.face][:, None])[:, 0] < 0, -1.0, 1.0)
    moved = project_points(field, centre, config.project, device=device)
    # Ten times the tolerance: the last step of a point that converges may fall a little short of it.
    good = np.abs(moved.residual_m) <= 10 * config.project.tolerance_m
    good &= (moved.normals * normal).sum(1) > config.min_cosine
    detail = np.where(good[:, None], moved.normals, normal)
    shift = np.where(good[:, None], moved.points - centre, 0.0)
    diffuse = specular_f0 = None
    if {"diffuse", "specular", "radiance"} & set(config.maps):
        albedos = mean(_albedos(field, position + shift[local], device))
        diffuse, specular_f0 = albedos[:, :3].astype(np.float32), albedos[:, 3].astype(np.float32)
    return _Texels(
        number=texels,
        position=(centre + shift).astype(np.float32),
        normal=detail.astype(np.float32),
        normal_tangent=to_tangent_space(detail, normal, tangent, hand).astype(np.float32),
        diffuse=diffuse,
        specular_f0=specular_f0,
    )


def _albedos(field: HeadField, position: np.ndarray, device: str) -> np.ndarray:
    """(N, 4) diffuse and specular albedo at points of the surface."""
    there = query(field, position, material=True, device=device)
    bad = ~(np.isfinite(there.diffuse).all(1) & np.isfinite(there.specular_f0))
    if bad.any():
        raise InputError(
            expected="finite albedos on the surface",
            received=f"{int(bad.sum())} samples not finite, the first at {position[bad][0].round(4).tolist()}",
            remedy="the weights are damaged or the fit diverged; fit again",
        )
    return np.column_stack([there.diffuse, there.specular_f0])


def _joined(bands: list[_Texels]) -> _Texels:
    def all_of(name: str) -> np.ndarray | None:
        parts = [getattr(band, name) for band in bands]
        return None if parts[0] is None else np.concatenate(parts)

    return _Texels(*(all_of(name) for name in _Texels.__dataclass_fields__))


def _nearest_filled(number: np.ndarray, size: int) -> np.ndarray:
    """(S, S) index into the N baked texels of the one nearest to each texel."""
    place = np.full(size * size, -1, np.int64)
    place[number] = np.arange(len(number))
    place = place.reshape(size, size)
    return fill_empty(place[..., None], place >= 0)[..., 0]


def _unit(vectors: np.ndarray, otherwise: tuple[float, float, float]) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-9, vectors / np.maximum(length, 1e-300), np.array(otherwise))
