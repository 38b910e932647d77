"""A surface to fit an appearance to, made by hand."""

import torch

from sira_assets.fit.pixels import PixelRays
from sira_assets.fit.seen_surface import SurfacePoints


def half_ball(count: int = 2000) -> SurfacePoints:
    """The side of a unit ball that faces +z, black as a photo."""
    torch.manual_seed(1)
    n = torch.nn.functional.normalize(torch.randn(count, 3), dim=-1)
    n = torch.where(n[:, 2:] < 0, -n, n)
    view = torch.tensor([[0.0, 0.0, 1.0]]).expand(count, 3)
    flags, index = torch.ones(count, dtype=torch.bool), torch.arange(count)
    rays = PixelRays(n, -view, torch.zeros(count, 3), flags, flags, index, index)
    return SurfacePoints(n, n, view, n, torch.zeros(count, 2), rays)
