"""How well behaved a trained prior's shapes are: what its codes decode to.

Notation: c coefficients of z_sdf in sigma units; f its signed distance, gradients in space; lengths in metres.
"""

from dataclasses import dataclass

import numpy as np
import torch

from sira_assets.fields.fitted import FittedHead
from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior
from sira_assets.fields.sa_sm import sdf_and_gradient
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.topology import topology, vertex_pieces
from sira_assets.mesh.triangle_mesh import face_cross_products

# Closer to the surface than this, |grad f| decides how well rays and offsets work.
NEAR_M = 0.01


@dataclass(frozen=True)
class DecodedHead:
    """One code's head.

    Parameters
    ----------
    pieces : connected pieces of its zero set; floaters are all but the largest
    floaters : share of the area that is not in the largest piece
    closed : watertight
    slope_mean, slope_spread : of |grad f| within a centimetre of the surface
    slope_greatest : of |grad f| over all sampled points of the box: a Lipschitz bound from below
    volume_l : what it encloses, litres
    """

    pieces: int
    floaters: float
    closed: bool
    slope_mean: float
    slope_spread: float
    slope_greatest: float
    volume_l: float


@dataclass(frozen=True)
class LatentConfig:
    """Heads drawn, steps of each interpolation between two of them, cell of the extraction, sampled points a head."""

    draws: int = 40
    between: int = 3
    cell_m: float = 0.004
    points: int = 20_000
    sigma: float = 2.0
    seed: int = 0


def draw_coefficients(prior: Prior, config: LatentConfig = LatentConfig()) -> np.ndarray:
    """(draws, K) coefficients: gaussian, each within `sigma` standard deviations."""
    rng = np.random.default_rng(config.seed)
    return np.clip(rng.normal(size=(config.draws, prior.z_sdf.basis.shape[1])), -config.sigma, config.sigma)


def interpolated(coefficients: np.ndarray, between: int) -> np.ndarray:
    """Points on the segments from each row to the next, ends left out."""
    share = np.arange(1, between + 1)[None, :, None] / (between + 1)
    steps = coefficients[:-1, None] * (1.0 - share) + coefficients[1:, None] * share
    return steps.reshape(-1, coefficients.shape[1])


def decode_head(prior: Prior, coefficients: np.ndarray, config: LatentConfig = LatentConfig()) -> DecodedHead:
    """Extract one code's surface and measure it."""
    z = prior.z_sdf.code(torch.as_tensor(coefficients, dtype=torch.float32))
    head = FittedHead(prior.shape, prior.appearance, z, prior.z_a.mean, prior.z_s.mean)
    mesh = extract_mesh(head, ExtractConfig(cell_m=config.cell_m))
    rng = np.random.default_rng(config.seed)
    points = rng.uniform(*BOUNDS_M, (config.points, 3))
    near = mesh.vertices[rng.integers(len(mesh.vertices), size=config.points)]
    near = near + rng.uniform(-NEAR_M, NEAR_M, near.shape)
    slope = [_slopes(prior, z, x) for x in (near, points)]
    facts = topology(mesh)
    cross = face_cross_products(mesh.vertices, mesh.faces)
    area = np.bincount(vertex_pieces(mesh)[mesh.faces[:, 0]], np.linalg.norm(cross, axis=1))
    return DecodedHead(
        pieces=facts.pieces,
        floaters=float(1.0 - area.max() / area.sum()),
        closed=facts.watertight,
        slope_mean=float(slope[0].mean()),
        slope_spread=float(slope[0].std()),
        slope_greatest=float(max(s.max() for s in slope)),
        volume_l=float(1e3 * (mesh.vertices[mesh.faces[:, 0]] * cross).sum() / 6.0),
    )


def _slopes(prior: Prior, z: torch.Tensor, x_m: np.ndarray) -> np.ndarray:
    """|grad f| (N,) at points (N, 3) in metres."""
    x = torch.as_tensor(x_m / UNIT_M, dtype=torch.float32)
    parts = [sdf_and_gradient(prior.shape, part, z, differentiable=False)[1] for part in x.split(8192)]
    return torch.cat(parts).norm(dim=-1).detach().numpy()
