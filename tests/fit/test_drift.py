"""What is even over a patch is light rather than albedo."""

import torch
from ball_prior import ball_prior
from test_roughness import half_ball

from sira_assets.fit.appearance_losses import AppearanceFitConfig, AppearanceLosses


def test_drift_is_that_of_every_cell_by_itself():
    surface = half_ball(300)
    config = AppearanceFitConfig(shadows=False, drift_cell=0.4)
    fit = AppearanceLosses(config, ball_prior(), surface, (surface.x_ref, surface.gamma), None)
    torch.manual_seed(2)
    x_ref, extra, base = surface.x_ref.double(), torch.randn(300, 3).double(), torch.rand(300, 3).double()
    found = fit._drift(extra, base, x_ref, torch.Generator().manual_seed(3))
    shift = torch.rand(3, generator=torch.Generator().manual_seed(3)).double()
    cells: dict[tuple[int, ...], list[int]] = {}
    for i, x in enumerate(x_ref):
        cells.setdefault(tuple(torch.floor(x / config.drift_cell + shift).int().tolist()), []).append(i)
    assert len(cells) > 30
    expected = torch.zeros((), dtype=torch.float64)
    for rows in cells.values():
        mean = extra[rows].sum(0) / (base[rows] + 0.02).sum(0)
        expected += len(rows) * (mean**2 / (config.drift_scale**2 + mean**2)).mean()
    torch.testing.assert_close(found, expected / len(x_ref), rtol=1e-6, atol=0)
