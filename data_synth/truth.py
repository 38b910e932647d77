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
from data_synth.render_light import sample_directions
from sira_assets.mesh.signed_distance import signed_distance
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight

BACKGROUND = 255
SAMPLES_PER_CHUNK = 65_536  # as in render_light: keeps the working set near the cache
# Half of a lobe's directions follow the lobe, half the cosine, whatever the other does badly.
LOBE_SHARE = 0.5
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
    out[hits.ray] = regions(hits.coordinates)
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
    occluded, roughness = rays.occluded_from(hits), rays.surface.roughness
    rotations = rng.random((len(hits.ray), 3), np.float32)
    out = np.zeros((len(light), camera.height * camera.width), np.float32)
    step = max(1, SAMPLES_PER_CHUNK // directions)
    for k in range(len(light)):
        lobe = SGLight(light.axis[k : k + 1], light.sharpness[k : k + 1], np.ones((1, 3)))
        for start in range(0, len(hits.ray), step):
            part = slice(start, start + step)
            n, v = (a[part].astype(np.float32) for a in (hits.normal, hits.to_camera))
            shares = np.broadcast_to(np.array([LOBE_SHARE, 1.0 - LOBE_SHARE, 0.0], np.float32), (len(n), 3))
            w = sample_directions(n, v, shares, lobe, rotations[part], directions, roughness)
            row, column = np.nonzero(np.einsum("pnk,pk->pn", w, n) > 1e-6)
            w = np.ascontiguousarray(w[row, column])
            weight = _lobe_over_density(w, n[row], lobe)
            clear = ~occluded(row + start, w)
            total = np.bincount(row, weight, len(n))
            seen = np.bincount(row[clear], weight[clear], len(n))
            out[k, hits.ray[part]] = np.where(total > 0.0, seen / np.maximum(total, 1e-300), 0.0)
    return out.reshape(len(light), camera.height, camera.width)


def _lobe_over_density(w: np.ndarray, n: np.ndarray, lobe: SGLight) -> np.ndarray:
    """G max(0, n . w) over the density that `w` was drawn with, (K,)."""
    lam, gap = float(lobe.sharpness[0]), w - lobe.axis[0].astype(np.float32)
    g = np.exp(-0.5 * lam * np.einsum("ij,ij->i", gap, gap).astype(np.float64))  # |w - xi|^2 / 2 = 1 - w . xi
    cosine = np.einsum("ij,ij->i", w, n).astype(np.float64)
    density = LOBE_SHARE * g * lam / (2.0 * np.pi * -np.expm1(-2.0 * lam)) + (1.0 - LOBE_SHARE) * cosine / np.pi
    return g * cosine / density


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
