"""The weights that ship: small enough, described, and decoding to heads."""

from pathlib import Path

import numpy as np
import pytest
import torch

import sira_assets.fields
from sira_assets.fields.fitted import FittedHead
from sira_assets.fields.prior import load_prior
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.topology import topology

WEIGHTS = Path(sira_assets.fields.__file__).parent / "weights"


def test_weights_are_small_and_have_a_card():
    assert (WEIGHTS / "prior.safetensors").stat().st_size <= 20e6
    card = (WEIGHTS / "README.md").read_text(encoding="utf-8").lower()
    for word in ("trained on", "seconds", "mm"):
        assert word in card


@pytest.mark.slow
@pytest.mark.parametrize("seed", [None, 0, 1, 2])
def test_the_mean_and_draws_from_the_prior_are_one_closed_surface_of_a_head_s_size(seed):
    prior = load_prior()
    c = torch.zeros(prior.z_sdf.basis.shape[1])
    if seed is not None:
        c = torch.randn(c.shape, generator=torch.Generator().manual_seed(seed))
    head = FittedHead(prior.shape, prior.appearance, prior.z_sdf.code(c), prior.z_a.mean, prior.z_s.mean)
    mesh = extract_mesh(head, ExtractConfig(cell_m=0.004))
    found = topology(mesh)
    assert found.watertight
    size = np.ptp(mesh.vertices, axis=0)
    assert 0.2 < size[0] < 0.5  # shoulders
    assert 0.3 < size[1] < 0.5  # crown to chest
    # The nose tip of the canonical frame stands within the population's spread (3.4 mm RMS) of the surface.
    assert abs(head.sdf(torch.tensor([[0.0, -0.0316, 0.0456]])).item()) < 0.012
