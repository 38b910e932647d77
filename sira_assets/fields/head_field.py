"""What a fitted or an analytic head looks like to everything downstream.

Notation: x_canonical (N, 3) points in canonical metres; sdf in canonical metres, negative inside; a diffuse albedo,
linear Rec. 709 in [0, 1]; s specular albedo at normal incidence, an F0 (glTF and data files hold ks with s = 0.04 ks).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

# The half-open box in which a head field is defined: head, neck and shoulders of any adult in the canonical frame.
BOUNDS_M = (np.array([-0.24, -0.30, -0.26]), np.array([0.24, 0.24, 0.16]))

# One query holds this many points: activations of a 128-wide network then stay in cache (measured: REFERENCE of the
# large-batch allocator cost; larger chunks are slower on CPUs, smaller ones gain nothing).
CHUNK = 16384


class HeadField(Protocol):
    """One head: a signed distance and a material, in the canonical frame. Device and dtype come from the input."""

    def sdf(self, x_canonical: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """Signed distance in canonical metres, negative inside."""
        ...

    def material(self, x_canonical: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
        """Diffuse albedo (N, 3) and specular albedo F0 (N,)."""
        ...


@dataclass(frozen=True)
class PointSamples:
    """What `query` returns, NumPy arrays of one length N."""

    sdf_m: np.ndarray
    normals: np.ndarray | None
    diffuse: np.ndarray | None
    specular_f0: np.ndarray | None


def query(
    field: HeadField,
    points_m: np.ndarray,
    *,
    normals: bool = False,
    material: bool = False,
    device: str | torch.device = "cpu",
    chunk: int = CHUNK,
) -> PointSamples:
    """The one crossing from NumPy to torch: evaluate a field at many points, a chunk at a time.

    Parameters
    ----------
    points_m : (N, 3) canonical metres
    normals : also the unit gradient of the signed distance
    material : also the albedos

    Returns
    -------
    PointSamples : sdf_m (N,) float32; normals (N, 3), diffuse (N, 3), specular_f0 (N,) float32 or None.
    """
    columns: list[list[np.ndarray]] = [[], [], [], []]
    for start in range(0, max(len(points_m), 1), chunk):
        x = torch.as_tensor(np.ascontiguousarray(points_m[start : start + chunk]), dtype=torch.float32, device=device)
        with torch.enable_grad() if normals else torch.no_grad():
            x.requires_grad_(normals)
            sdf = field.sdf(x)
            if normals:
                (gradient,) = torch.autograd.grad(sdf.sum(), x)
                columns[1].append(torch.nn.functional.normalize(gradient, dim=-1).cpu().numpy())
        columns[0].append(sdf.detach().cpu().numpy())
        if material:
            with torch.no_grad():
                diffuse, specular = field.material(x.detach())
            columns[2].append(diffuse.cpu().numpy())
            columns[3].append(specular.cpu().numpy())
    return PointSamples(*(np.concatenate(column) if column else None for column in columns))
