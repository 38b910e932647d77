"""Shadows on the seen surface while the light is being found.

Notation: as in render/visibility_table.py. At first the light may go anywhere and directions are spread over the
sphere; later they are drawn from the lobes found so far, so that a lamp's shadow has its edge.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sira_assets.fields.mlp import UNIT_M
from sira_assets.fit.light import FreeLight
from sira_assets.fit.seen_surface import SurfacePoints
from sira_assets.mesh.raycast import Raycaster
from sira_assets.render.visibility_table import (
    SharedDirections,
    VisibilityTable,
    aimed_directions,
    even_directions,
    visibility_table,
)


@dataclass(frozen=True)
class ShadowConfig:
    """Rays of the appearance fit, per point: half of the directions lie below a point's horizon and cost nothing.

    Parameters
    ----------
    early : directions all over the sphere, while the light is sought; they resolve lobes of sharpness early / pi
    aimed : directions once it is found, a quarter of them all over the sphere
    refresh : steps of the refinement between two looks at the shares of lobes that have moved meanwhile
    """

    early: int = 256
    aimed: int = 256
    refresh: int = 100


class FitShadows:
    """What points of the seen surface see of the light; the chosen directions change in place."""

    def __init__(self, caster: Raycaster, config: ShadowConfig, *, device: str | torch.device = "cpu"):
        self.caster, self.config = caster, config
        self.early = even_directions(config.early, device=device)
        self.aimed = even_directions(config.aimed, device=device)

    def state(self) -> dict[str, Tensor]:
        """What a resumed fit needs to cast the same rays again."""
        return {"shadow_directions": self.aimed.directions, "shadow_solid_angle": self.aimed.solid_angle}

    @torch.no_grad()
    def aim(self, light: FreeLight) -> None:
        """Choose directions by the light found so far."""
        axis, sharpness, amplitude = light.lobes()
        found = aimed_directions(axis, sharpness, amplitude, self.config.aimed)
        self.aimed.directions.copy_(found.directions)
        self.aimed.solid_angle.copy_(found.solid_angle)

    def early_table(self, points: SurfacePoints) -> VisibilityTable:
        """Rays in all directions."""
        return self._table(points, self.early)

    def aimed_table(self, points: SurfacePoints) -> VisibilityTable:
        """Rays along the directions that `aim` chose."""
        shared = SharedDirections(self.aimed.directions.clone(), self.aimed.solid_angle.clone(), math.inf)
        return self._table(points, shared)

    def _table(self, points: SurfacePoints, shared: SharedDirections) -> VisibilityTable:
        return visibility_table(self.caster, points.x.double().cpu().numpy() * UNIT_M, points.normals, shared)
