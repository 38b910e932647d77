"""Direct light of a distant source on surface points, integrated numerically with shadow rays.

Notation: P points, N directions a point, K patterns of the light (`render_source`). n shading normal, v unit direction
to the camera, w unit direction to the light, h half vector; nl = n . w, nv = n . v, nh = n . h, vh = v . h. a the
diffuse albedo, ks the specular factor (F0 = 0.04 ks), alpha = roughness^2. Radiance out = integral of
(a / pi + ks D G F / (4 nl nv)) L(w) V(w) nl dw with D of GGX, G Smith's separable masking, F = 0.04 + 0.96 (1 - vh)^5,
V the visibility of the sky.

Directions come from a mixture of the source's proposals, the cosine hemisphere and the GGX half-vector density, all
weighted by the mixture's density (one-sample balance heuristic, Veach and Guibas 1995, DOI 10.1145/218380.218498). The
diffuse term is the unshadowed irradiance of each pattern, known from quadrature, times the sampled share of it that is
not in shadow (ratio estimator, Heitz et al. 2018, DOI 10.1145/3190834.3190852): no noise where nothing casts a shadow.

A reflectance is defined for directions above the surface. Where an interpolated normal faces away from the camera,
which happens within a triangle of a silhouette, the radiance is therefore zero, as path tracers have it; the unshadowed
maps, which are the local shading model, are not affected.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.render_source import LUMINANCE, LightSource, SGSource, from_local
from sira_assets.scene.sg_light import SGLight

F0_DIELECTRIC = 0.04  # reflectance at normal incidence of a dielectric of index 1.5: ((1.5 - 1) / (1.5 + 1))^2
GGX_SHARE = 0.22  # of the directions follow the highlight, where a surface has one
BY_ENERGY = 0.8  # of the proposals' part
COSINE_SHARE = 0.15  # at least; so that no direction above the horizon has a vanishing density
SAMPLES_PER_CHUNK = 32_768  # keeps the working set, about 30 float32 planes, near the cache


@dataclass(frozen=True)
class DirectLight:
    """Outgoing radiance (P, 3) float32 of each kind; `irradiance_unshadowed` (P, 3) has no noise.

    visibility (P, K) float32 in [0, 1]: the share of each pattern's irradiance that is not in shadow.
    """

    diffuse: np.ndarray
    specular: np.ndarray
    diffuse_unshadowed: np.ndarray
    specular_unshadowed: np.ndarray
    irradiance_unshadowed: np.ndarray
    visibility: np.ndarray


@lru_cache(maxsize=8)
def sobol(count: int) -> np.ndarray:
    """The first `count` points of a Sobol sequence, (count, 3) float32 in [0, 1), sorted by the first coordinate."""
    from scipy.stats import qmc

    points = qmc.Sobol(3, scramble=True, rng=np.random.default_rng(7)).random_base2(max(count - 1, 1).bit_length())
    points = points[:count]
    # A part of a net leaves gaps in the coordinate that picks the strategy: space it evenly, keep its order.
    order = np.argsort(points[:, 0])
    points = points[order]
    points[:, 0] = (np.arange(count) + 0.5) / count
    return (points * 2.0**32).astype(np.uint32)


def direct_light(
    normals: np.ndarray,
    to_camera: np.ndarray,
    diffuse: np.ndarray,
    specular_f0: np.ndarray,
    light: SGLight | LightSource,
    occluded,
    rotations: np.ndarray,
    *,
    roughness: float,
    directions: int,
) -> DirectLight:
    """Integrate the light over `directions` directions at each point.

    Parameters
    ----------
    normals, to_camera : (P, 3) unit
    diffuse : (P, 3) albedo, linear
    specular_f0 : (P,) F0 = 0.04 ks
    light : in the frame of the normals; sharpness up to 1e6 keeps a relative error below 1e-3 in float32
    occluded : function of (indices (R,), directions (R, 3) float32) -> (R,) bool, True where the ray is blocked
    rotations : (P, 3) in [0, 1), the Cranley-Patterson shift of each point's sequence
    roughness : in [0.05, 1]
    directions : N >= 1

    Returns
    -------
    DirectLight
    """
    source = SGSource(light) if isinstance(light, SGLight) else light
    count, patterns = len(normals), len(source.colour)
    irradiance = source.irradiance(normals)
    facing = np.einsum("pi,pi->p", normals, to_camera) > 0
    glints = (specular_f0 > 0) & facing
    shares = strategy_shares(source.proposal_energy(irradiance), irradiance, source, glints)
    visibility = np.empty((count, patterns), np.float32)
    glossy = np.empty((2, count, patterns), np.float32)
    step = max(1, SAMPLES_PER_CHUNK // directions)
    for start in range(0, count, step):
        part = slice(start, min(start + step, count))
        n, v = normals[part].astype(np.float32), to_camera[part].astype(np.float32)
        w = sample_directions(n, v, shares[part], source, rotations[part], directions, roughness)
        sums = _integrate(n, v, w, shares[part], specular_f0[part], source, occluded, start, roughness)
        clear, whole, glossy[0, part], glossy[1, part] = sums
        visibility[part] = np.where(whole > 0, clear / np.maximum(whole, 1e-30), 1.0)
    colour, albedo = source.colour, diffuse / np.pi
    total = irradiance @ colour
    facing = facing[:, None]
    return DirectLight(
        diffuse=(facing * albedo * ((irradiance * visibility) @ colour)).astype(np.float32),
        specular=(facing * (glossy[0] @ colour)).astype(np.float32),
        diffuse_unshadowed=(albedo * total).astype(np.float32),
        specular_unshadowed=(glossy[1] @ colour).astype(np.float32),
        irradiance_unshadowed=total.astype(np.float32),
        visibility=visibility,
    )


def strategy_shares(energy: np.ndarray, irradiance: np.ndarray, source: LightSource, glints: np.ndarray) -> np.ndarray:
    """Probability of each strategy at each point: S proposals, the cosine, the highlight; (P, S + 2) float32.

    Proposals get 70 % by the light they bring to the point and 30 % evenly among those that bring any, so that what
    remains after the strongest lamp is in shadow is sampled too.
    """
    total = np.maximum((irradiance * (source.colour @ LUMINANCE)).sum(1, keepdims=True), 1e-30)
    usable = energy > 1e-6 * total
    evenly = usable / np.maximum(usable.sum(1, keepdims=True), 1)
    share = BY_ENERGY * energy / total + (1 - BY_ENERGY) * evenly
    highlight = np.where(glints, GGX_SHARE, 0.0)
    lobes = share * (1.0 - highlight - COSINE_SHARE)[:, None]
    out = np.concatenate([lobes, (1.0 - highlight - lobes.sum(1))[:, None], highlight[:, None]], axis=1)
    return out.astype(np.float32)


def sample_directions(
    n: np.ndarray,
    v: np.ndarray,
    shares: np.ndarray,
    source: LightSource,
    rotations: np.ndarray,
    count: int,
    roughness: float,
) -> np.ndarray:
    """Unit directions (3, P, count) float32 drawn from the mixture `shares`; some lie below the horizon."""
    base = sobol(count)
    # The first coordinate is shifted by less than one stratum, so that the strategies' counts stay even.
    u0 = ((np.arange(count) + rotations[:, :1]) / count).astype(np.float32)
    scramble = (rotations * 2.0**32).astype(np.uint32)
    u1, u2 = (((base[:, k] ^ scramble[:, k : k + 1]) >> 8) * np.float32(2.0**-24) for k in (1, 2))
    strategy = np.zeros(u0.shape, np.int8)
    for edge in np.cumsum(shares, axis=1).T[:-1]:
        strategy += u0 >= edge[:, None]
    strategy, u1, u2 = strategy.ravel(), u1.ravel(), u2.ravel()
    w = np.empty((3, len(u1)), np.float32)
    for k in range(source.proposals):
        of_k = np.flatnonzero(strategy == k)
        if len(of_k):
            w[0][of_k], w[1][of_k], w[2][of_k] = source.draw(k, u1[of_k], u2[of_k])
    for k, draw in enumerate((_draw_cosine, _draw_highlight)):
        of_k = np.flatnonzero(strategy == source.proposals + k)
        if len(of_k):
            w[0][of_k], w[1][of_k], w[2][of_k] = draw(n, v, of_k // count, u1[of_k], u2[of_k], roughness)
    return w.reshape(3, len(n), count)


def _draw_cosine(n, v, row, u1, u2, roughness):
    """Directions by the cosine to the normal."""
    radius, phi = np.sqrt(u1), np.float32(2 * np.pi) * u2
    return from_local(n.T[:, row], radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1 - u1))


def _draw_highlight(n, v, row, u1, u2, roughness):
    """Mirrored visible normals of GGX (Dupuy and Benyoub 2023, DOI 10.1111/cgf.14867)."""
    alpha = np.float32(roughness**2)
    one, zero = np.float32(1), np.float32(0)
    tangent, across = (np.stack(from_local(n.T, *e), -1) for e in ((one, zero, zero), (zero, one, zero)))
    lx, ly, lz = (np.einsum("pi,pi->p", v, e)[row] for e in (tangent, across, n))
    # the view in the space where the surface is a unit hemisphere
    length = np.sqrt(alpha * alpha * (lx * lx + ly * ly) + lz * lz)
    sx, sy, sz = alpha * lx / length, alpha * ly / length, lz / length
    phi = np.float32(2 * np.pi) * u2
    z = (1 - u1) * (1 + sz) - sz
    radius = np.sqrt(np.maximum(1 - z * z, 0))
    hx, hy, hz = alpha * (radius * np.cos(phi) + sx), alpha * (radius * np.sin(phi) + sy), z + sz
    hz = np.maximum(hz, np.float32(1e-6))
    twice = 2 * (hx * lx + hy * ly + hz * lz) / (hx * hx + hy * hy + hz * hz)
    return from_local(n.T[:, row], twice * hx - lx, twice * hy - ly, twice * hz - lz)


def _integrate(n, v, w, shares, specular_f0, source, occluded, start, roughness):
    """Sums over directions, (P, K) each: irradiance with and without shadows, glossy radiance with and without."""
    x, y, z = w
    count, proposals = w.shape[2], source.proposals
    nx, ny, nz = (a[:, None] for a in n.T)
    vx, vy, vz = (a[:, None] for a in v.T)
    nl = x * nx + y * ny + z * nz
    above = np.flatnonzero(nl > 1e-6)
    g, densities = source.evaluate(x, y, z)
    nv = vx * nx + vy * ny + vz * nz
    # h is half / |half|; |half|^2 = 2 + 2 w . v, and v . half is half of that.
    half = x + vx, y + vy, z + vz
    square = np.maximum(half[0] * half[0] + half[1] * half[1] + half[2] * half[2], np.float32(1e-12))
    along = nl + nv
    # |half - (half . n) n|^2 in place of |half|^2 - (half . n)^2, which loses the highlight's core in float32.
    across = sum((p - (nl + nv) * q) ** 2 for p, q in zip(half, (nx, ny, nz), strict=True))
    alpha2 = np.float32(roughness**4)
    d = across
    d += alpha2 * along * along
    d /= square
    np.square(d, out=d)
    np.divide(alpha2 / np.float32(np.pi), np.maximum(d, np.float32(1e-30)), out=d)
    vh = np.float32(0.5) * np.sqrt(square)
    density = shares[:, proposals, None] * np.float32(1 / np.pi) * np.maximum(nl, 0)
    # Visible normals have the density D V1(nv) / 2 of mirrored directions.
    nv = np.maximum(np.abs(nv), np.float32(1e-4))
    facing = nv + np.sqrt(alpha2 + (1 - alpha2) * nv * nv)
    density += shares[:, proposals + 1, None] / (2 * facing) * d
    for k in range(proposals):
        density += shares[:, k, None] * densities[k]
    weight = np.zeros_like(nl)
    weight.ravel()[above] = nl.ravel()[above] / (count * density.ravel()[above])
    # Smith's separable visibility G / (4 nl nv) = V1(nl) V1(nv), V1(c) = 1 / (c + sqrt(alpha2 + (1 - alpha2) c^2)).
    smith = (nl + np.sqrt(alpha2 + (1 - alpha2) * nl * nl)) * facing
    fresnel = np.float32(F0_DIELECTRIC) + np.float32(1 - F0_DIELECTRIC) * np.maximum(1 - vh, 0) ** 5
    ks = (specular_f0 / F0_DIELECTRIC).astype(np.float32)[:, None]
    brdf = ks * d * fresnel / np.where(nl > 0, smith, 1)
    towards = np.empty((len(above), 3), np.float32)
    for k in range(3):
        towards[:, k] = w[k].ravel()[above]
    clear = np.zeros_like(nl)
    clear.ravel()[above] = ~occluded(start + above // count, towards)
    weights = np.empty((4, *nl.shape), np.float32)
    np.multiply(weight, clear, out=weights[0])
    weights[1] = weight
    np.multiply(weights[0], brdf, out=weights[2])
    np.multiply(weight, brdf, out=weights[3])
    return np.einsum("kpn,spn->spk", g, weights)
