"""What the scene required of the model: lobes, shadows, highlights; what the photo cannot tell from none is left out.

Notation: as in fit/appearance_losses.py; shares are of the light on the seen surface, mean over points and channels.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from sira_assets.fit.decision import FitDecision
from sira_assets.fit.seen_surface import SurfacePoints
from sira_assets.numerics.sg import irradiance

# Shadows that take less than this share of the light are left out: an 8-bit step of 255.
LEAST_SHADOWED_SHARE = 0.004
# A lobe that gives less than this share of the light is left out: an eighth of an 8-bit step.
LEAST_LOBE_SHARE = 0.0005

Lobes = tuple[Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class Evidence:
    """Some of the seen surface under the found light.

    Parameters
    ----------
    points : of the seen surface
    lobes : axis (M, 3), sharpness (M,), amplitude (M, 3)
    visibility : (N, M), or None where nothing was to cast shadows
    """

    points: SurfacePoints
    lobes: Lobes
    visibility: Tensor | None

    @staticmethod
    @torch.no_grad()
    def of(surface: SurfacePoints, lobes: Lobes, visibility: Tensor | None, *, at_most: int = 8000) -> "Evidence":
        """Every so many of the points and of their (N, M) shares, if there are shadows."""
        rows = torch.arange(0, len(surface), max(1, len(surface) // at_most), device=surface.x.device)
        return Evidence(surface.rows(rows), lobes, None if visibility is None else visibility[rows])

    def light(self, *, shadowed: bool) -> Tensor:
        """(M,) what each lobe gives the points."""
        axis, sharpness, amplitude = self.lobes
        seen = self.visibility if shadowed else None
        one = lambda i: slice(i, i + 1)  # noqa: E731
        return torch.stack(
            [
                irradiance(
                    self.points.normals,
                    axis[one(i)],
                    sharpness[one(i)],
                    amplitude[one(i)],
                    visibility=None if seen is None else seen[:, one(i)],
                ).mean()
                for i in range(len(axis))
            ]
        )


@torch.no_grad()
def needed_shadows(evidence: Evidence) -> tuple[Evidence, bool, tuple[FitDecision, ...]]:
    """The evidence, without shadows if they take too little; whether they are cast; the decision, if there was one."""
    if evidence.visibility is None:
        return evidence, False, ()
    lit, left = (float(evidence.light(shadowed=s).sum()) for s in (False, True))
    share = 1.0 - left / max(lit, 1e-12)
    said = f"the head itself hides {100 * share:.2g} % of the light on the seen surface"
    cast = share >= LEAST_SHADOWED_SHARE
    if not cast:
        evidence = replace(evidence, visibility=None)
    return evidence, cast, (FitDecision("shadows", "cast" if cast else "none", said),)


@torch.no_grad()
def needed_lobes(evidence: Evidence, *, sought: int, merging: float) -> tuple[Evidence, FitDecision]:
    """The lobes that the seen surface can tell from none, and the decision.

    Parameters
    ----------
    sought : lobes that the fit began with
    merging : what making some of them one has changed, mean sRGB-encoded radiance
    """
    light = evidence.light(shadowed=True)
    share = light / light.sum().clamp_min(1e-12)
    keep = share >= LEAST_LOBE_SHARE
    said = f"the others give {100 * float(share[~keep].sum()):.2g} % of the light on the seen surface"
    if len(keep) < sought:
        said += f" or were made one with those beside them (mean change {merging:.2g} of 1, sRGB-encoded)"
    axis, sharpness, amplitude = (t[keep] for t in evidence.lobes)
    seen = None if evidence.visibility is None else evidence.visibility[:, keep]
    decision = FitDecision("light lobes", f"{int(keep.sum())} of {sought}", said)
    return Evidence(evidence.points, (axis, sharpness, amplitude), seen), decision


def needed_highlights(scale: float, *, plain: float, shiny: float) -> FitDecision:
    """What the fit decided before the refinement, by its mean errors without highlights and with them."""
    said = f"mean error {shiny:.4f} with highlights, {plain:.4f} without, each fitted (sRGB-encoded, 0 to 1)"
    return FitDecision("specular", f"k_s = {scale:.2g}", said)
