"""Direct light of spherical gaussians on surface points, integrated numerically with shadow rays.

Notation: P points, N directions a point, M lobes. n shading normal, v unit direction to the camera, w unit direction
to the light, h half vector; nl = n . w, nv = n . v, nh = n . h, vh = v . h. a the diffuse albedo, ks the specular
factor (F0 = 0.04 ks), alpha = roughness^2. Radiance out = integral of (a / pi + ks D G F / (4 nl nv)) L(w) V(w) nl dw
with D of GGX, G Smith's separable masking, F = 0.04 + 0.96 (1 - vh)^5, V the visibility of the sky.

Directions come from a mixture of M von Mises-Fisher lobes, the cosine hemisphere and the GGX half-vector density, all
weighted by the mixture's density (one-sample balance heuristic, Veach and Guibas 1995, DOI 10.1145/218380.218498). The
diffuse term is the unshadowed irradiance, known from quadrature, times the sampled share of it that is not in shadow
(ratio estimator, Heitz et al. 2018, DOI 10.1145/3190834.3190852): no noise where nothing casts a shadow.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.render_irradiance import irradiance_per_lobe
from sira_assets.scene.sg_light import SGLight

F0_DIELECTRIC = 0.04  # reflectance at normal incidence of a dielectric of index 1.5: ((1.5 - 1) / (1.5 + 1))^2
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709-6, item 3.3
GGX_SHARE = 0.2  # of the directions follow the highlight, where a surface has one
COSINE_SHARE = 0.1  # at least; so that no direction above the horizon has a vanishing density
# A lobe broader than this spends more than a quarter of its samples below the horizon: the cosine serves it better.
BROAD_SHARPNESS = 2.0
SAMPLES_PER_CHUNK = 65_536  # keeps the working set, about 30 float32 arrays, near the cache


@dataclass(frozen=True)
class DirectLight:
    """Outgoing radiance (P, 3) float32 of each kind; `irradiance_unshadowed` has no noise."""

    diffuse: np.ndarray
    specular: np.ndarray
    diffuse_unshadowed: np.ndarray
    specular_unshadowed: np.ndarray
    irradiance_unshadowed: np.ndarray


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
    return np.minimum(points, 1.0 - 2.0**-24).astype(np.float32)


def direct_light(
    normals: np.ndarray,
    to_camera: np.ndarray,
    diffuse: np.ndarray,
    specular_f0: np.ndarray,
    light: SGLight,
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
    occluded : function of (indices (K,), directions (K, 3) float32) -> (K,) bool, True where the ray is blocked
    rotations : (P, 3) in [0, 1), the Cranley-Patterson shift of each point's sequence
    roughness : in [0.05, 1]
    directions : N >= 1

    Returns
    -------
    DirectLight
    """
    count = len(normals)
    outputs = [np.zeros((count, 3), np.float32) for _ in range(4)]
    irradiance = irradiance_per_lobe(normals, light.axis, light.sharpness)
    total = (irradiance @ light.amplitude).astype(np.float32)
    shares = strategy_shares(irradiance * (light.amplitude @ LUMINANCE), light.sharpness, specular_f0)
    step = max(1, SAMPLES_PER_CHUNK // directions)
    for start in range(0, count, step):
        part = slice(start, min(start + step, count))
        n, v = normals[part].astype(np.float32), to_camera[part].astype(np.float32)
        w = sample_directions(n, v, shares[part], light, rotations[part], directions, roughness)
        results = _integrate(n, v, w, shares[part], specular_f0[part], light, occluded, start, roughness)
        lit, unlit, specular, specular_unshadowed = results
        albedo = diffuse[part] / np.pi
        share_lit = np.where(unlit > 0, lit / np.maximum(unlit, 1e-20), 1.0)
        outputs[0][part] = albedo * total[part] * share_lit
        outputs[1][part] = specular
        outputs[2][part] = albedo * total[part]
        outputs[3][part] = specular_unshadowed
    return DirectLight(*outputs, total)


def strategy_shares(energy: np.ndarray, sharpness: np.ndarray, specular_f0: np.ndarray) -> np.ndarray:
    """Probability of each strategy at each point: M lobes, the cosine, the highlight; (P, M + 2) float32.

    Lobes get 70 % by the light they bring to the point and 30 % evenly among those that bring any, so that what
    remains after the strongest lamp is in shadow is sampled too.
    """
    usable = energy > 1e-6 * np.maximum(energy.sum(1, keepdims=True), 1e-30)
    by_energy = energy / np.maximum(energy.sum(1, keepdims=True), 1e-30)
    share = 0.7 * by_energy + 0.3 * usable / np.maximum(usable.sum(1, keepdims=True), 1)
    highlight = np.where(specular_f0 > 0, GGX_SHARE, 0.0)
    lobes = share * (1.0 - highlight - COSINE_SHARE)[:, None]
    lobes[:, sharpness < BROAD_SHARPNESS] = 0.0
    out = np.concatenate([lobes, (1.0 - highlight - lobes.sum(1))[:, None], highlight[:, None]], axis=1)
    return out.astype(np.float32)


def sample_directions(
    n: np.ndarray,
    v: np.ndarray,
    shares: np.ndarray,
    light: SGLight,
    rotations: np.ndarray,
    count: int,
    roughness: float,
) -> np.ndarray:
    """Unit directions (P, count, 3) float32 drawn from the mixture `shares`; some lie below the horizon."""
    lobes = len(light)
    # The first coordinate is shifted by less than one stratum, so that the strategies' counts stay even.
    base = sobol(count)
    u0 = base[:, 0] + (rotations[:, :1].astype(np.float32) - 0.5) / count
    u1, u2 = (np.mod(base[:, k] + rotations[:, k : k + 1].astype(np.float32), 1.0) for k in (1, 2))
    strategy = np.zeros(u0.shape, np.int64)
    for edge in np.cumsum(shares, axis=1).T[:-1]:
        strategy += u0 >= edge[:, None]
    axis = np.zeros((*u0.shape, 3), np.float32)
    axis[:] = n[:, None]
    of_lobe = strategy < lobes
    axis[of_lobe] = light.axis.astype(np.float32)[strategy[of_lobe]]
    # 1 - cos of the polar angle, per strategy; u1 is kept off 0 so that logarithms stay finite.
    u1 = np.maximum(u1, 1e-7)
    lam = np.ones(lobes + 2, np.float32)
    lam[:lobes] = light.sharpness
    lam = lam[strategy]
    t_lobe = -np.log(u1 + (1.0 - u1) * np.exp(-2.0 * lam)) / lam  # inverse distribution of a von Mises-Fisher lobe
    cosine = np.sqrt(1.0 - u1)
    alpha2 = roughness**4
    half = np.sqrt((1.0 - u1) / (1.0 + (alpha2 - 1.0) * u1))
    t = np.where(of_lobe, t_lobe, 1.0 - np.where(strategy == lobes, cosine, half))
    radius = np.sqrt(np.maximum(t * (2.0 - t), 0.0))
    phi = (2.0 * np.pi) * u2
    w = _from_local(axis, radius * np.cos(phi), radius * np.sin(phi), 1.0 - t)
    # A half vector turns into the direction that it mirrors v into.
    row, column = np.nonzero(strategy == lobes + 1)
    h, view = w[row, column], v[row]
    w[row, column] = 2.0 * _dot(h, view)[:, None] * h - view
    return w


def _from_local(axis: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """x t + y b + z axis with (t, b, axis) orthonormal (Duff et al. 2017, JCGT 6(1))."""
    ax, ay, az = axis[..., 0], axis[..., 1], axis[..., 2]
    sign = np.copysign(np.float32(1.0), az)
    a = -1.0 / (sign + az)
    b = ax * ay * a
    out = np.empty_like(axis)
    out[..., 0] = x * (1.0 + sign * ax * ax * a) + y * b + z * ax
    out[..., 1] = x * sign * b + y * (sign + ay * ay * a) + z * ay
    out[..., 2] = -x * sign * ax - y * ay + z * az
    return out


def _integrate(n, v, w, shares, specular_f0, light, occluded, start, roughness):
    """Sums over directions, (P, 3) each: diffuse (before albedo) with and without shadows, specular likewise."""
    lobes, count = len(light), w.shape[1]
    row, column = np.nonzero(np.einsum("pnk,pk->pn", w, n) > 1e-6)
    w = np.ascontiguousarray(w[row, column])
    n, v, shares = n[row], v[row], shares[row]
    nl = _dot(n, w)
    h = w + v
    h /= np.maximum(np.sqrt(_dot(h, h)), 1e-12)[:, None]
    vh = np.clip(_dot(v, h), 0.0, 1.0)
    # |h - nh n|^2 in place of 1 - nh^2: the difference of two near ones loses the highlight's core in float32.
    alpha2 = np.float32(roughness**4)
    nh = np.maximum(_dot(n, h), 0.0)
    across = h - nh[:, None] * n
    d = alpha2 / (np.float32(np.pi) * (_dot(across, across) + alpha2 * nh * nh) ** 2)
    density = shares[:, lobes] * nl * np.float32(1.0 / np.pi)
    density += shares[:, lobes + 1] * d * nh / np.maximum(4.0 * vh, 1e-6)
    radiance = np.zeros((len(w), 3), np.float32)
    for k in range(lobes):
        lam = light.sharpness[k]
        gap = w - light.axis[k].astype(np.float32)
        g = np.exp(np.float32(-0.5 * lam) * _dot(gap, gap))  # |w - xi|^2 / 2 = 1 - w . xi, without cancellation
        radiance += g[:, None] * light.amplitude[k].astype(np.float32)
        density += shares[:, k] * g * np.float32(lam / (2.0 * np.pi * -np.expm1(-2.0 * lam)))
    incident = radiance * (nl / (count * density))[:, None]
    # Smith's separable visibility G / (4 nl nv) = V1(nl) V1(nv), V1(c) = 1 / (c + sqrt(alpha2 + (1 - alpha2) c^2)).
    nv = np.maximum(np.abs(_dot(n, v)), 1e-4)
    visibility = 1.0 / (
        (nl + np.sqrt(alpha2 + (1.0 - alpha2) * nl * nl)) * (nv + np.sqrt(alpha2 + (1.0 - alpha2) * nv * nv))
    )
    fresnel = F0_DIELECTRIC + (1.0 - F0_DIELECTRIC) * (1.0 - vh) ** 5
    brdf = (specular_f0 / F0_DIELECTRIC).astype(np.float32)[row] * d * visibility * fresnel
    glossy = incident * brdf[:, None]
    clear = ~occluded(row + start, w)
    points = len(specular_f0)
    return (
        _sum_rows(incident[clear], row[clear], points),
        _sum_rows(incident, row, points),
        _sum_rows(glossy[clear], row[clear], points),
        _sum_rows(glossy, row, points),
    )


def _sum_rows(values: np.ndarray, row: np.ndarray, points: int) -> np.ndarray:
    """(points, 3) sums of `values` (K, 3) by `row` (K,)."""
    return np.stack([np.bincount(row, values[:, k], points) for k in range(3)], axis=-1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Row-wise dot products of two (K, 3) arrays."""
    return np.einsum("ij,ij->i", a, b)
