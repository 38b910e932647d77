"""Render a surface under distant light: numerical integration with shadow rays, no bounces.

Notation: x_world surface points; barycentric coordinates weigh a triangle's three vertices. The picture is the mean of
`supersample` sub-pixel samples over a black background, so its edges are premultiplied by coverage (`alpha`). Maps of
geometry and material are sampled at pixel centres, unfiltered. This module shares no code with `sira_assets.render`, so
that it can serve as its oracle.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.render_light import F0_DIELECTRIC, direct_light
from data_synth.render_source import LightSource, SGSource
from sira_assets.errors import InputError
from sira_assets.mesh.open3d_core import open3d_core
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight

Material = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Occluder:
    """Something that stands before the surface: matt, of one colour.

    kind : what it is; mesh : in the scene's world, outward; albedo : (3,) linear
    """

    kind: str
    mesh: TriangleMesh
    albedo: np.ndarray


@dataclass(frozen=True)
class Surface:
    """What is rendered.

    Parameters
    ----------
    mesh : in the scene's world, outward, with vertex normals (these are interpolated and shaded with)
    material_coordinates : (V, 3), interpolated over triangles and handed to `material`
    material : function of (N, 3) coordinates -> diffuse albedo (N, 3) linear, specular F0 (N,)
    roughness : in [0.05, 1]; GGX alpha = roughness^2
    occluder : stands before it, is seen and casts shadows, but is no part of masks and maps; or None
    """

    mesh: TriangleMesh
    material_coordinates: np.ndarray
    material: Material
    roughness: float
    occluder: Occluder | None = None


@dataclass(frozen=True)
class RenderConfig:
    """directions: light samples a sub-pixel sample; supersample: sub-pixel samples a pixel, a square number;
    threads: of the ray caster (0 = all cores)."""

    directions: int = 64
    supersample: int = 1
    threads: int = 1

    def __post_init__(self):
        side = round(self.supersample**0.5)
        if self.supersample < 1 or side * side != self.supersample or self.directions < 1:
            raise InputError(
                expected="directions >= 1 and supersample a square number (1, 4, 9, 16)",
                received=f"directions {self.directions}, supersample {self.supersample}",
                remedy="choose such numbers",
            )


@dataclass(frozen=True)
class Rendering:
    """One view: (H, W, 3) or (H, W) float32 arrays, zero where nothing is hit.

    image = diffuse_radiance + specular_radiance (with shadows), and what is seen of an occluder; *_unshadowed without
    shadows; diffuse_shading the unshadowed irradiance / pi at pixel centres; albedo linear; specular ks = F0 / 0.04;
    normal_world facing the camera; depth the distance along the optical axis; position_world; alpha the coverage in
    [0, 1]; mask (H, W) bool, the centre is hit. An occluder is zero in all but the image.
    """

    image: np.ndarray
    diffuse_radiance: np.ndarray
    specular_radiance: np.ndarray
    diffuse_unshadowed: np.ndarray
    specular_unshadowed: np.ndarray
    diffuse_shading: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    normal_world: np.ndarray
    depth: np.ndarray
    position_world: np.ndarray
    alpha: np.ndarray
    mask: np.ndarray


@dataclass(frozen=True)
class _Hits:
    """K hits among rays: which ray, where, and the surface there; `own` (K,) bool is False on an occluder."""

    ray: np.ndarray
    own: np.ndarray
    x_world: np.ndarray
    face_normal: np.ndarray
    normal: np.ndarray
    to_camera: np.ndarray
    coordinates: np.ndarray


class RayScene:
    """A surface made ready for rays; build once, render many views.

    Rays are cast in single precision relative to the surface's own centre: a world far from the origin costs nothing.
    """

    def __init__(self, surface: Surface, *, threads: int = 1):
        o3d = open3d_core()

        self.surface, self.threads = surface, threads
        mesh, coordinates = surface.mesh, np.asarray(surface.material_coordinates)
        self._own_faces = len(mesh.faces)
        if surface.occluder is not None:
            mesh, coordinates = _with_occluder(mesh, coordinates, surface.occluder.mesh)
        self._mesh, self._coordinates = mesh, coordinates
        self.centre_world = 0.5 * (mesh.vertices.min(0) + mesh.vertices.max(0))
        local = (mesh.vertices - self.centre_world).astype(np.float32)
        self._tensor = o3d.core.Tensor
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
        self._scene.add_triangles(self._tensor(local), self._tensor(mesh.faces.astype(np.uint32)))
        # Above single-precision rounding (6e-8 of the size), far below a triangle's edge.
        self.offset = 2e-5 * float(np.ptp(mesh.vertices, axis=0).max())
        cross = face_cross_products(mesh.vertices, mesh.faces)
        self._face_normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    def first_hits(self, origins_world: np.ndarray, directions_world: np.ndarray) -> _Hits:
        """Nearest hits of (N, 3) rays."""
        rays = np.concatenate([origins_world - self.centre_world, directions_world], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=self.threads)
        ray = np.flatnonzero(np.isfinite(answer["t_hit"].numpy()))
        face = answer["primitive_ids"].numpy()[ray].astype(np.int64)
        uv = answer["primitive_uvs"].numpy()[ray].astype(np.float64)
        weights = np.stack([1.0 - uv.sum(1), uv[:, 0], uv[:, 1]], axis=1)[:, :, None]
        mesh = self._mesh
        corners = mesh.faces[face]
        normal = (mesh.normals[corners] * weights).sum(1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        to_camera = -directions_world[ray]
        face_normal = self._face_normals[face]
        face_normal = np.where((face_normal * to_camera).sum(1, keepdims=True) < 0, -face_normal, face_normal)
        return _Hits(
            ray=ray,
            own=face < self._own_faces,
            x_world=(mesh.vertices[corners] * weights).sum(1),
            face_normal=face_normal,
            normal=normal,
            to_camera=to_camera,
            coordinates=(self._coordinates[corners] * weights).sum(1),
        )

    def material_at(self, hits: _Hits) -> tuple[np.ndarray, np.ndarray]:
        """Diffuse albedo (K, 3) and specular F0 (K,) of hits, an occluder's included."""
        if self.surface.occluder is None:
            return self.surface.material(hits.coordinates)
        diffuse = np.empty((len(hits.ray), 3), np.float32)
        specular_f0 = np.zeros(len(hits.ray), np.float32)
        diffuse[~hits.own] = self.surface.occluder.albedo
        diffuse[hits.own], specular_f0[hits.own] = self.surface.material(hits.coordinates[hits.own])
        return diffuse, specular_f0

    def occluded_from(self, hits: _Hits) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """A test of shadow rays: (hit index (K,), directions (K, 3)) -> (K,) bool."""
        origins = (hits.x_world - self.centre_world + self.offset * hits.face_normal).astype(np.float32)

        def occluded(index: np.ndarray, directions: np.ndarray) -> np.ndarray:
            rays = np.empty((len(index), 6), np.float32)
            rays[:, :3], rays[:, 3:] = origins[index], directions
            return self._scene.test_occlusions(self._tensor(rays), nthreads=self.threads).numpy()

        return occluded


def _with_occluder(mesh: TriangleMesh, coordinates: np.ndarray, other: TriangleMesh) -> tuple[TriangleMesh, np.ndarray]:
    """Both meshes as one, the occluder's faces last, its material coordinates zero."""
    both = TriangleMesh(
        np.concatenate([mesh.vertices, other.vertices]),
        np.concatenate([mesh.faces, other.faces + len(mesh.vertices)]),
        np.concatenate([mesh.normals, other.normals]),
    )
    return both, np.concatenate([coordinates, np.zeros((len(other.vertices), coordinates.shape[1]))])


def render(
    scene: RayScene,
    camera: Camera,
    light: SGLight | LightSource,
    rng: np.random.Generator,
    config: RenderConfig = RenderConfig(),
) -> Rendering:
    """Render one view.

    Parameters
    ----------
    scene : the surface, ready for rays
    camera, light : in the surface's world
    rng : the only source of randomness; the same state gives the same bytes

    Returns
    -------
    Rendering
    """
    size = camera.height * camera.width
    side = round(config.supersample**0.5)
    grid = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), -1).reshape(-1, 2)
    sums, beside, coverage = np.zeros((4, size, 3)), np.zeros((size, 3)), np.zeros(size)
    for k in range(config.supersample):
        shift = (np.array([k % side, k // side]) + 0.5) / side - 0.5
        hits = scene.first_hits(*camera.rays_world(grid + shift))
        diffuse, specular_f0 = scene.material_at(hits)
        lit = direct_light(
            hits.normal,
            hits.to_camera,
            diffuse,
            specular_f0,
            light,
            scene.occluded_from(hits),
            rng.random((size, 3), np.float32)[hits.ray],
            roughness=scene.surface.roughness,
            directions=config.directions,
        )
        for total, part in zip(
            sums, (lit.diffuse, lit.specular, lit.diffuse_unshadowed, lit.specular_unshadowed), strict=True
        ):
            total[hits.ray[hits.own]] += part[hits.own]
        beside[hits.ray[~hits.own]] += lit.diffuse[~hits.own]
        coverage[hits.ray[hits.own]] += 1.0
    if config.supersample > 1:
        hits = scene.first_hits(*camera.rays_world(grid))
        diffuse, specular_f0 = scene.material_at(hits)
        source = SGSource(light) if isinstance(light, SGLight) else light
        shading = source.irradiance(hits.normal) @ source.colour / np.pi
    else:
        shading = lit.irradiance_unshadowed / np.pi
    facing = np.where((hits.normal * hits.to_camera).sum(1, keepdims=True) < 0, -hits.normal, hits.normal)
    depth = camera.project(hits.x_world)[1]

    def spread(values: np.ndarray) -> np.ndarray:
        out = np.zeros((size, *values.shape[1:]), np.float32)
        out[hits.ray[hits.own]] = values[hits.own]
        return out.reshape(camera.height, camera.width, *values.shape[1:])

    radiance = (sums / config.supersample).astype(np.float32).reshape(4, camera.height, camera.width, 3)
    return Rendering(
        image=radiance[0] + radiance[1] + (beside / config.supersample).astype(np.float32).reshape(radiance[0].shape),
        diffuse_radiance=radiance[0],
        specular_radiance=radiance[1],
        diffuse_unshadowed=radiance[2],
        specular_unshadowed=radiance[3],
        diffuse_shading=spread(shading),
        albedo=spread(diffuse),
        specular=spread(specular_f0 / F0_DIELECTRIC),
        normal_world=spread(facing),
        depth=spread(depth),
        position_world=spread(hits.x_world),
        alpha=(coverage / config.supersample).astype(np.float32).reshape(camera.height, camera.width),
        mask=spread(np.ones(len(hits.ray))) > 0,
    )
