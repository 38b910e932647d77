"""What a photo's 2D landmarks tell of shape and pose: each lies on the ray through its pixel.

Notation: as in fields/sa_sm.py and fit/pose.py; l landmarks, x_l where the model has one, r_l how far that is from its
ray, network units. A landmark is a point of the reference space, the same for all heads: x_l + delta(x_l) = x_ref_l.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior
from sira_assets.fields.sa_sm import ShapeAppearanceModel
from sira_assets.fit.pixels import canonical_rays
from sira_assets.fit.pose import PoseCorrection, corrected, moved_by
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.pose import LANDMARK_NOISE_M

# Steps in which x_l is found, each by this part of what is missing: the deformation is smooth, but not everywhere slow.
SEARCH, PART = 30, 0.8


@dataclass(frozen=True)
class LandmarkRays:
    """L landmarks; none where the pose is given.

    Parameters
    ----------
    origins, directions : (L, 3) canonical rays before the pose correction, network units, unit directions
    sigma : (L,) expected miss of a detector, network units
    start, x_ref : (L, 3) where the prior's mean head has them, and where that is in the reference space
    """

    origins: Float[Tensor, "L 3"]
    directions: Float[Tensor, "L 3"]
    sigma: Float[Tensor, " L"]
    start: Float[Tensor, "L 3"]
    x_ref: Float[Tensor, "L 3"]

    def __len__(self) -> int:
        return len(self.origins)


@torch.no_grad()
def landmark_rays(portrait: Portrait, prior: Prior) -> LandmarkRays:
    """Rays through the pixels of the landmarks that the portrait was posed by."""
    names = list(portrait.landmarks_px)
    mean = prior.z_sdf.mean
    pixels = np.array([portrait.landmarks_px[name] for name in names]).reshape(-1, 2)
    origins, directions = canonical_rays(portrait, pixels)
    sigma = mean.new_tensor([LANDMARK_NOISE_M[name] for name in names]) / UNIT_M
    start = mean.new_tensor([CANONICAL_LANDMARKS_M[name] for name in names]).reshape(-1, 3) / UNIT_M
    x_ref = start + prior.shape.deform(start, mean)[0]
    return LandmarkRays(mean.new_tensor(origins), mean.new_tensor(directions), sigma, start, x_ref)


def landmark_offsets(
    rays: LandmarkRays, model: ShapeAppearanceModel, z_sdf: Tensor, basis: Float[Tensor, "Z K"], pose: PoseCorrection
) -> tuple[Float[Tensor, "L 3"], Float[Tensor, "L 3 K+6"]]:
    """r_l, across the rays, and its derivatives in the code's coefficients and the pose.

    Parameters
    ----------
    z_sdf : the code
    basis : its derivative in the coefficients
    """
    x = rays.start.clone()
    with torch.no_grad():
        for _ in range(SEARCH):
            x += PART * (rays.x_ref - x - model.deform(x, z_sdf)[0])
    with torch.enable_grad():
        z = z_sdf.expand(len(x), -1).clone().requires_grad_(True)
        at = x.clone().requires_grad_(True)
        # Without a reference space nothing says where a landmark went: delta hangs on neither, and landmarks stay.
        delta = model.deform(at, z)[0] + 0.0 * (at + z.sum(-1, keepdim=True))
        slopes = [torch.autograd.grad(delta[:, i].sum(), (z, at), retain_graph=True) for i in range(3)]
    by_code = torch.stack([by_z @ basis for by_z, _ in slopes], 1)
    by_place = torch.stack([by_x for _, by_x in slopes], 1) + torch.eye(3).to(x)
    moves = -torch.linalg.solve(by_place, by_code)
    o, d = corrected(pose, rays.origins, rays.directions)
    along = ((x - o) * d).sum(-1, keepdim=True)
    nearest = o + along * d
    changes = torch.cat([moves, -moved_by(nearest, pose.translation)], -1)
    across = lambda v: v - d[:, :, None] * (d[:, :, None] * v).sum(1, keepdim=True)  # noqa: E731
    return (x - nearest).detach(), across(changes).detach()
