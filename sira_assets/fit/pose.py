"""A small correction of the head's pose: where a pose comes from 2D landmarks, shape and pose must be found together.

Notation: p = (rotation vector w (3), translation u (3)) in the canonical frame, network units; the correction takes a
ray's canonical origin o to R(w) o + u and its direction d to R(w) d. Size is not refined: with one view it is depth.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.fields.mlp import UNIT_M

# How far off PnP on nine landmarks is, one standard deviation: 4.6 degrees, mostly pitch and yaw, and 1.9 % of a
# distance of about 1.2 m; sideways it is held by the landmarks themselves.
POSE_SIGMA = (0.06, 0.06, 0.025, 0.05, 0.05, 0.25)


@dataclass(frozen=True)
class PoseCorrection:
    """The two halves of p."""

    rotation: Float[Tensor, "3"]
    translation: Float[Tensor, "3"]

    def matrix(self) -> np.ndarray:
        """(4, 4) the correction in canonical metres: canonical_from_world becomes this times canonical_from_world."""
        out = np.eye(4)
        out[:3, :3] = rotation_matrix(self.rotation.detach().double()).cpu().numpy()
        out[:3, 3] = self.translation.detach().double().cpu().numpy() * UNIT_M
        return out


def rotation_matrix(w: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """exp of the skew matrix of w (Rodrigues), differentiable at 0."""
    zero = torch.zeros_like(w[0])
    skew = torch.stack([zero, -w[2], w[1], w[2], zero, -w[0], -w[1], w[0], zero]).view(3, 3)
    return torch.linalg.matrix_exp(skew)


def corrected(
    correction: PoseCorrection, origins: Float[Tensor, "N 3"], directions: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"]]:
    """Rays under the correction."""
    # Autocast multiplies matrices in bfloat16, which would move a ray's origin by millimetres.
    with torch.autocast(origins.device.type, enabled=False):
        rotation = rotation_matrix(correction.rotation)
        return origins @ rotation.T + correction.translation, directions @ rotation.T


def moved_by(points: Float[Tensor, "N 3"], translation: Float[Tensor, "3"]) -> Float[Tensor, "N 3 6"]:
    """How corrected points that keep their place in the world move with w and u, to first order."""
    out = points.new_zeros(len(points), 3, 6)
    axes = torch.eye(3, dtype=points.dtype, device=points.device)
    for k in range(3):
        out[:, :, k] = torch.linalg.cross(axes[k].expand_as(points), points - translation)
        out[:, :, 3 + k] = axes[k]
    return out
