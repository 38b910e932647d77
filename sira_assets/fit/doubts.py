"""What about a portrait or its fit gives reason for doubt, in one line each, with the figure and the remedy.

Notation: c coefficients of a code in sigma units; for a person like those the prior has seen, |c|^2 / K is about 1.
"""

import numpy as np
import torch
from torch import Tensor

from sira_assets.fields.prior import CodeStatistics, Prior
from sira_assets.fit.geometry import GeometryFit
from sira_assets.scene.portrait import Portrait

# Each bound is where, on held-out portraits, a fit stops being what it is on good input; see docs on limits.
MOST_SIGMA = 1.6
MOST_CLIPPED = 0.25
MOST_BLACK = 0.2
BLACK = 0.002
LEAST_OVERLAP = 0.9
MOST_HOLES = 0.002
MOST_POSE_DEG = 8.0
MOST_OUTLINE = 0.03
FEWEST_PIXELS = 6000


def portrait_doubts(portrait: Portrait) -> tuple[str, ...]:
    """Doubts about the photo and its mask alone."""
    from scipy import ndimage

    mask, said = portrait.mask, []
    count = int(mask.sum())
    if count < FEWEST_PIXELS:
        said.append(f"the head has {count} pixels: details of the face cannot be told; use a larger photo")
    clipped = float(portrait.saturated[mask].mean())
    if clipped > MOST_CLIPPED:
        said.append(f"{clipped:.0%} of the head is clipped: albedo and light are guessed there; expose less")
    black = float((portrait.image_linear[mask].max(-1) < BLACK).mean())
    if black > MOST_BLACK:
        said.append(f"{black:.0%} of the head is black: its albedo is the prior's; use more light or check the mask")
    holes = ndimage.binary_fill_holes(mask) & ~mask
    if holes.sum() > MOST_HOLES * count:
        said.append(f"the mask has holes ({int(holes.sum())} pixels): they are left out of the fit; close them")
    border = np.concatenate([mask[0], mask[:, 0], mask[:, -1]])
    if border.any():
        said.append("the head is cut by the top or a side of the photo: what lies outside is the prior's")
    return tuple(said)


@torch.no_grad()
def geometry_doubts(portrait: Portrait, geometry: GeometryFit, prior: Prior, hit: np.ndarray) -> tuple[str, ...]:
    """Doubts about a geometry fit.

    Parameters
    ----------
    hit : (H, W) bool, pixels that see the fitted surface
    """
    said = list(geometry.warnings)
    distance = sigma_distance(prior.z_sdf, geometry.z_sdf)
    if distance > MOST_SIGMA:
        said.append(
            f"the shape is {distance:.1f} times as far from the mean as people are: check camera, focal length and mask"
        )
    from scipy import ndimage

    # Holes are a fault of the mask, and said as that.
    mask = ndimage.binary_fill_holes(portrait.mask)
    # Below the mask's lowest row the fitted bust goes on; a photo says nothing of it.
    rows = np.nonzero(mask.any(1))[0]
    seen = slice(rows[0], rows[0] + max(1, int(0.7 * len(rows))))
    overlap = float((mask & hit)[seen].sum() / max((mask | hit)[seen].sum(), 1))
    if overlap < LEAST_OVERLAP:
        said.append(f"head and mask overlap by {overlap:.0%} only: check camera, landmarks, canonical_from_world, mask")
    outline = outline_left(geometry.history)
    if outline > MOST_OUTLINE:
        said.append(
            f"no likely head has the mask's outline (left over: {outline / MOST_OUTLINE:.1f} times what is usual at "
            "most): check focal length, camera pose and mask; much hair or a hat does that as well"
        )
    if geometry.pose_change_deg > MOST_POSE_DEG:
        said.append(f"the head was turned by {geometry.pose_change_deg:.0f} degrees: check landmarks and focal length")
    return tuple(said)


def outline_left(history) -> float:
    """The silhouette's loss once the codes had settled; the networks, which come next, can follow any outline."""
    of_codes = [terms["silhouette"] for _, terms in history if "silhouette" in terms and "anchor" not in terms]
    return float(np.mean(of_codes[-3:])) if of_codes else 0.0


def sigma_distance(statistics: CodeStatistics, code: Tensor) -> float:
    """Root mean square of a code's coefficients: 1 on average over the people that the prior has seen."""
    basis = statistics.basis
    coefficients = ((code - statistics.mean) @ basis) / basis.square().sum(0)
    return float(coefficients.square().mean().sqrt())
