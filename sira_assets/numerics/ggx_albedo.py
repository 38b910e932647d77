"""Directional albedo of a GGX surface: what it reflects towards the camera under constant white light.

Notation: nv = n . v; alpha = r^2; R(nv) = f0 A + B, with A = int (1 - F_c) D G / (4 nv) dl and B the same with F_c, the
fifth power in Schlick's Fresnel. D GGX, G Smith's separable form: the BRDF of glTF viewers and of the data set.
"""

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

# Knots are equidistant in sqrt(nv), where A and B bend least; between them linear interpolation errs by 1e-3 at most.
_KNOTS = 64
_COSINE_FIRST = 1e-4
_POLAR, _AZIMUTH = 256, 64


@lru_cache(maxsize=64)
def _table(roughness: float) -> np.ndarray:
    """A and B at the knots, (2, _KNOTS), by midpoints over the half vector in coordinates where D is uniform."""
    alpha2 = roughness**4
    u = ((np.arange(_POLAR) + 0.5) / _POLAR)[:, None]
    phi = np.pi * ((np.arange(_AZIMUTH) + 0.5) / _AZIMUTH)[None]
    cos_h = np.sqrt((1.0 - u) / (1.0 + (alpha2 - 1.0) * u))
    sin_h = np.sqrt(1.0 - cos_h**2)
    rows = []
    for n_dot_v in np.maximum(np.linspace(0.0, 1.0, _KNOTS) ** 2, _COSINE_FIRST):
        vh = np.sqrt(1.0 - n_dot_v**2) * sin_h * np.cos(phi) + n_dot_v * cos_h
        nl = 2.0 * vh * cos_h - n_dot_v
        visible = (vh > 0.0) & (nl > 0.0)
        nl, vh = np.where(visible, nl, 1.0), np.where(visible, vh, 1.0)
        smith = [2.0 * c / (c + np.sqrt(alpha2 + (1.0 - alpha2) * c * c)) for c in (nl, n_dot_v)]
        weight = np.where(visible, smith[0] * smith[1] * vh / (n_dot_v * cos_h), 0.0)
        grazing = (1.0 - vh) ** 5
        rows.append(((weight * (1.0 - grazing)).mean(), (weight * grazing).mean()))
    return np.array(rows).T


def directional_albedo(n_dot_v: Float[Tensor, "*n"], f0: Float[Tensor, "*n"], roughness: float) -> Float[Tensor, "*n"]:
    """R(nv) in (0, 1] for nv in [0, 1], f0 in [0, 1], roughness 0.05 to 1.

    The table for a roughness is computed once (some 50 ms) and kept; there is no gradient with respect to roughness.
    """
    table = torch.as_tensor(_table(float(roughness)), dtype=n_dot_v.dtype, device=n_dot_v.device)
    position = torch.sqrt(n_dot_v.clamp(_COSINE_FIRST, 1.0)) * (_KNOTS - 1)
    left = position.detach().floor().clamp(0, _KNOTS - 2).long()
    blend = position - left
    scale, bias = (row[left] + (row[left + 1] - row[left]) * blend for row in table)
    return f0 * scale + bias
