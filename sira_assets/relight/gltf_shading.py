"""glTF's metallic-roughness surface under spherical gaussian light, in closed form.

Notation: n normal, v direction to the camera, l to the light, h half-way between v and l, all unit; E irradiance; F(c)
= F0 + (F90 - F0) (1 - c)^5 with c = v . h; S_i the mean of (1 - v . h)^5 over the light that lobe i sends to the point.
The specular lobe is `numerics.sg_specular` (grade "accurate": the energy of the GGX surface that viewers render), which
is affine in F0 and in F90, so that coloured F0 and other F90 cost one evaluation more. NumPy in and out, torch inside.

What differs from glTF: its diffuse lobe is base / pi (1 - max F), SIRA's is base / pi. `gltf_weighting` chooses. With
F0 = 0.04 it darkens the diffuse radiance by 4 % seen head-on, and by 6 % near grazing.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sira_assets.numerics.sg import irradiance
from sira_assets.numerics.sg_specular import specular_radiance
from sira_assets.relight.surface import Surface
from sira_assets.scene.sg_light import SGLight

# max(n . l, 0) as a lobe about n: sharpness 2.133 (Wang et al. 2009, doi:10.1145/1618452.1618479). Only the directions
# over which S is a mean are drawn from it.
COSINE_SHARPNESS = 2.133
# S by midpoints: cosines of equal share of the lobe times azimuths over the half circle (v's mirror plane halves it).
_POLAR, _AZIMUTH = 4, 4
# Roughness of a texture is met in such steps, as the closed form wants one roughness for all points.
ROUGHNESS_STEP = 1.0 / 32.0
ROUGHNESS_RANGE = (0.05, 1.0)
# Pairs of point and lobe shaded together: some 200 MB.
_PAIRS = 1 << 20


@dataclass(frozen=True)
class Shaded:
    """Radiance towards the camera from N points; (N, 3) float32 each, linear."""

    diffuse: np.ndarray
    specular: np.ndarray


def shade_surface(
    surface: Surface,
    normals: np.ndarray,
    view: np.ndarray,
    light: SGLight,
    *,
    visibility: np.ndarray | None = None,
    gltf_weighting: bool = True,
) -> Shaded:
    """Shade points of an asset.

    Parameters
    ----------
    normals, view : (N, 3) unit, world; normals on the camera's side, view towards the camera
    light : M lobes, world
    visibility : (N, M) in [0, 1], the share of each lobe that nothing stands before; 1 if None
    gltf_weighting : weigh the diffuse lobe by 1 - max F as glTF does; False as SIRA's own model
    """
    diffuse, specular = np.zeros((len(surface), 3), np.float32), np.zeros((len(surface), 3), np.float32)
    rows = max(1, _PAIRS // max(len(light), 1))
    low, high = ROUGHNESS_RANGE
    # A constant roughness is met exactly, a texture's to within half a step.
    same = np.ptp(surface.roughness) < 1e-9 if len(surface) else True
    steps = surface.roughness if same else np.round(surface.roughness / ROUGHNESS_STEP) * ROUGHNESS_STEP
    steps = np.clip(steps, low, high)
    lobes = [torch.as_tensor(a.copy(), dtype=torch.float32) for a in (light.axis, light.sharpness, light.amplitude)]
    for roughness in np.unique(np.round(steps, 9)):
        at = np.flatnonzero(np.abs(steps - roughness) < 1e-8)
        for start in range(0, len(at), rows):
            here = at[start : start + rows]
            with torch.no_grad():
                d, s = _shade(surface, here, normals, view, lobes, visibility, float(roughness), gltf_weighting)
            diffuse[here], specular[here] = d.numpy(), s.numpy()
    return Shaded(diffuse, specular)


def _shade(surface, here, normals, view, lobes, visibility, roughness, gltf_weighting) -> tuple[Tensor, Tensor]:
    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(values[here]), dtype=torch.float32)

    n, v = tensor(normals), tensor(view)
    seen = None if visibility is None else tensor(visibility)
    received = irradiance(n, *lobes, visibility=seen)
    if gltf_weighting:
        grazing = grazing_share(n, v, lobes[0], lobes[1])
        lost = irradiance(n, *lobes, visibility=grazing if seen is None else grazing * seen)
        f0, f90 = tensor(surface.layer_f0).unsqueeze(-1), tensor(surface.layer_f90).unsqueeze(-1)
        received = (1.0 - f0) * received - (f90 - f0) * lost
    diffuse = tensor(surface.diffuse) * received.clamp_min(0.0) / math.pi

    f0, f90 = tensor(surface.f0), tensor(surface.f90)
    grey, full = bool((f0 == f0[:, :1]).all()), bool((f90 == 1.0).all())
    if grey and full:
        return diffuse, specular_radiance(n, v, f0[:, 0], *lobes, roughness=roughness, visibility=seen)
    none, one = torch.zeros_like(f90), torch.ones_like(f90)
    edge = specular_radiance(n, v, none, *lobes, roughness=roughness, visibility=seen)
    whole = specular_radiance(n, v, one, *lobes, roughness=roughness, visibility=seen)
    return diffuse, f0 * (whole - edge) + f90.unsqueeze(-1) * edge


def grazing_share(normals: Tensor, view: Tensor, axis: Tensor, sharpness: Tensor) -> Tensor:
    """S (N, M): the mean of (1 - v . h)^5 over lobe times clamped cosine.

    The clamped cosine is taken for a lobe, their product is one, and S the mean over 16 directions of equal share in
    it, with v . h = sqrt((1 + v . l) / 2). Where the lobe sends little light S may be off by 0.7; what it does to the
    irradiance is within 1.3 % of the lobe's head-on one (sharpness 0 to 300, v on the normal's side).

    Parameters
    ----------
    normals, view : (N, 3) unit
    axis, sharpness : (M, 3) unit, (M,)
    """
    centre = sharpness[:, None] * axis + COSINE_SHARPNESS * normals.unsqueeze(-2)  # (N, M, 3)
    width = torch.linalg.vector_norm(centre, dim=-1).clamp_min(1e-3)
    along = (centre * view.unsqueeze(-2)).sum(-1) / width
    along = along.clamp(-1.0, 1.0)
    across = torch.sqrt((1.0 - along * along).clamp_min(0.0))
    out = torch.zeros_like(along)
    for i in range(_POLAR):
        share = (i + 0.5) / _POLAR
        cosine = (1.0 + torch.log1p(share * torch.expm1(-2.0 * width)) / width).clamp(-1.0, 1.0)
        sine = torch.sqrt((1.0 - cosine * cosine).clamp_min(0.0))
        for j in range(_AZIMUTH):
            turn = math.cos(math.pi * (j + 0.5) / _AZIMUTH)
            vl = cosine * along + sine * across * turn
            out += (1.0 - torch.sqrt((0.5 + 0.5 * vl).clamp_min(0.0))) ** 5
    return out / (_POLAR * _AZIMUTH)
