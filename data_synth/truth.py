"""What is known of a scene beyond its pictures and maps: regions, each lobe's visibility, signed distances.

Notation: M lobes G_k(w) = exp(lambda_k (w . xi_k - 1)); n the shading normal; V(w) is 0 where the head itself stands
before the light and 1 elsewhere. A lobe's visibility at a point is

    V_k = (integral of G_k max(0, n . w) V dw) / (integral of G_k max(0, n . w) dw),

so that the diffuse radiance with shadows is albedo / pi times the sum of amplitude_k E_k V_k, E_k a lobe's irradiance.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_synth.render import RayScene
from data_synth.render_irradiance import irradiance_per_lobe, irradiance_table
from data_synth.render_light import direct_light
from sira_assets.mesh.signed_distance import signed_distance
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight

BACKGROUND = 255
SDF_NEAR, SDF_FAR = 16_384, 8_192
# Offsets of the near points from the surface, standard deviations, drawn evenly: detail, and its surroundings.
SDF_SIGMA_M = (0.002, 0.012)
SDF_MARGIN_M = 0.06  # how far the box of the far points reaches beyond the mesh


@dataclass(frozen=True)
class FullTruth:
    """What `--truth full` adds.

    Parameters
    ----------
    regions : a (H, W) uint8 map per view, `BACKGROUND` beside the head; None where the subject has none
    region_names : number -> name
    visibility : (M, H, W) float32 of frame 0, in [0, 1], 0 beside the head and where no light of the lobe falls
    sdf_points_world : (N, 3) float32; first `SDF_NEAR` points near the surface, then points all over
    sdf : (N,) float32 metres, negative inside
    sdf_known : (N,) bool, False where the nearest surface is a cap that closes a scan
    """

    regions: list[np.ndarray] | None
    region_names: Mapping[int, str]
    visibility: np.ndarray
    sdf_points_world: np.ndarray
    sdf: np.ndarray
    sdf_known: np.ndarray


def region_map(rays: RayScene, camera: Camera, regions) -> np.ndarray:
    """(H, W) uint8 region under each pixel centre, `BACKGROUND` where nothing is hit."""
    hits = rays.first_hits(*camera.rays_world())
    out = np.full(camera.height * camera.width, BACKGROUND, np.uint8)
    out[hits.ray[hits.own]] = regions(hits.coordinates[hits.own])
    return out.reshape(camera.height, camera.width)


def visibility_maps(
    rays: RayScene, camera: Camera, light: SGLight, rng: np.random.Generator, directions: int = 64
) -> np.ndarray:
    """V_k under each pixel centre of a view, by `directions` shadow rays a lobe and pixel.

    Parameters
    ----------
    light : in the world of `rays`
    rng : the only source of randomness

    Returns
    -------
    (M, H, W) float32; standard error at most 0.5 / sqrt(directions), where half of a lobe is hidden.
    """
    hits = rays.first_hits(*camera.rays_world())
    # Every lobe as bright head on as any other, so that none is starved of directions.
    head_on = np.array([irradiance_table(float(sharpness))[0] for sharpness in light.sharpness])
    even = SGLight(light.axis, light.sharpness, np.repeat(1.0 / head_on[:, None], 3, axis=1))
    nothing = np.zeros((len(hits.ray), 3))
    lit = direct_light(
        hits.normal,
        hits.to_camera,
        nothing,
        nothing[:, 0],
        even,
        rays.occluded_from(hits),
        rng.random((len(hits.ray), 3), np.float32),
        roughness=rays.surface.roughness,
        directions=directions * len(light),
    )
    falls = irradiance_per_lobe(hits.normal, light.axis, light.sharpness) > 1e-9 * head_on
    out = np.zeros((len(light), camera.height * camera.width), np.float32)
    out[:, hits.ray] = np.where(falls & hits.own[:, None], lit.visibility, 0.0).T
    return out.reshape(len(light), camera.height, camera.width)


def sample_signed_distance(
    mesh: TriangleMesh, closed: TriangleMesh, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points near `mesh` and all around it, and their exact distance to `closed`.

    Distances are those of the points as returned, single precision, to the vertices as gt/mesh.ply stores them.

    Returns
    -------
    points (N, 3) float32, distance (N,) float32 negative inside, known (N,) bool
    """
    stored = TriangleMesh(closed.vertices.astype(np.float32), closed.faces, closed.normals)
    area = np.linalg.norm(face_cross_products(mesh.vertices, mesh.faces), axis=1)
    corners = mesh.faces[rng.choice(len(area), SDF_NEAR, p=area / area.sum())]
    on = (mesh.vertices[corners] * rng.dirichlet(np.ones(3), SDF_NEAR)[:, :, None]).sum(1)
    sigma = np.array(SDF_SIGMA_M)[rng.integers(2, size=SDF_NEAR)]
    low, high = mesh.vertices.min(0) - SDF_MARGIN_M, mesh.vertices.max(0) + SDF_MARGIN_M
    points = np.concatenate([on + sigma[:, None] * rng.normal(size=on.shape), rng.uniform(low, high, (SDF_FAR, 3))])
    points = points.astype(np.float32)
    distance, face = signed_distance(stored, points.astype(np.float64))
    return points, distance.astype(np.float32), face < len(mesh.faces)


def full_truth(
    rays: RayScene,
    cameras: list[Camera],
    light: SGLight,
    mesh: TriangleMesh,
    closed: TriangleMesh,
    regions,
    region_names: Mapping[int, str],
    rng: np.random.Generator,
    directions: int,
) -> FullTruth:
    """All of it, in the world of `rays`; `regions` as in `Subject`."""
    points, distance, known = sample_signed_distance(mesh, closed, rng)
    return FullTruth(
        regions=None if regions is None else [region_map(rays, camera, regions) for camera in cameras],
        region_names=region_names,
        visibility=visibility_maps(rays, cameras[0], light, rng, directions),
        sdf_points_world=points,
        sdf=distance,
        sdf_known=known,
    )
