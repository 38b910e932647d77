"""Loss terms of the single-view geometry fit.

Notation: as in fit/geometry.py and render/tracing.py.
"""

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior, freeze
from sira_assets.fields.sa_sm import sdf_and_gradient
from sira_assets.fit.kept_rays import KeptRays
from sira_assets.fit.pixels import CUT_Y_M, on_ears, on_face
from sira_assets.fit.pose import PoseCorrection, corrected
from sira_assets.fit.shading import ShadingConfig, ShadingEvidence
from sira_assets.render.tracing import TraceConfig, differentiable_hit

# Rays that are traced to see where the silhouette is wrong, for each step that then mends it: a tenth of its time.
ATTENDED_FOR_A_STEP = 400
# A pixel of the mask is covered for good where its ray goes this deep (network units: 0.1 mm).
COVERED = 0.001
# Points a step at which phase B's change is held to be small, and on the face to be alike on both sides.
HELD = 384
# Over this distance (network units: 1 cm) the change of the deformation should be even.
SLOPE_REACH = 0.1


@dataclass(frozen=True)
class GeometryFitConfig:
    """Steps, rays and weights.

    Rays are kept and followed: each step moves a kept ray's hit by one Newton step, and all are traced anew every
    `retrace` steps.
    """

    steps_appearance: int = 80
    steps_codes: int = 200
    steps_networks: int = 320
    steps_cover: int = 200
    pool: int = 6000
    band_pool: int = 2500
    rays: int = 1000
    band_rays: int = 400
    retrace: int = 40
    rate_codes: float = 0.04
    rate_appearance_codes: float = 0.08
    rate_pose: float = 0.004
    rate_networks: float = 1.5e-4
    # Of a renderer that the prior has not trained (ShapeConfig.joint_appearance): as in training.
    rate_new_renderer: float = 1.0e-3
    colour: float = 0.5
    silhouette: float = 0.5
    # Sharpness of the soft silhouette: sigmoid(-alpha f) of the nearest point of a missed ray, per network unit.
    alpha: float = 50.0
    reach: float = 0.1
    reach_networks: float = 0.8
    # A pixel of the mask without surface costs this much more than surface outside it, in phase B and in phase C: it
    # would stay a hole in the render, and a thousandth of the mask as holes costs a render of 32 dB 1 or 2.
    cover: float = 8.0
    cover_last: float = 60.0
    # Phase C: rays on the wrong side of the silhouette are followed this much more often, and what is seen is held.
    attention: float = 30.0
    # So many times as strongly at first: large early steps are wide ones and would take the face along.
    hold: float = 2000.0
    hold_first: float = 16.0
    rate_cover: float = 4.0e-4
    # Where a larger share of the band's rays passes further out than an ear can be, hair covers it: such an ear is held
    # so much more firmly than the rest, and its outline is left to what is behind it. A share of 1: never.
    hair_share: float = 0.003
    ear_hold: float = 50.0
    prior: float = 1.0e-3
    appearance_prior: float = 3.0e-6
    eikonal: float = 0.05
    # Phase B stays near phase A (C near B, by `hold`): squared change of the deformation over and around the surface.
    anchor: float = 4.0
    slope: float = 0.1
    # Squared difference between phase B's change and its mirror image, over the face: blotched skin and cast shadows,
    # which the networks take for shape, lie on one side; features lie on both.
    symmetry: float = 300.0
    # A ray whose kept hit is further than this off the surface waits for the next retrace.
    lost: float = 0.08
    trace: TraceConfig = TraceConfig()
    shading: ShadingConfig = ShadingConfig()
    # Hidden layers of the networks in bfloat16 instead of float32.
    bfloat16: bool = False
    seed: int = 0


class GeometryLosses:
    """The loss terms of every step, and what they read: all tensors in it change in place."""

    def __init__(
        self,
        config: GeometryFitConfig,
        prior: Prior,
        inside: KeptRays,
        edge: KeptRays,
        evidence: ShadingEvidence,
    ):
        device = inside.t.device
        self.config, self.prior, self.inside, self.edge = config, prior, inside, edge
        self.model = copy.deepcopy(prior.shape)
        freeze(self.model)
        # The end of the phase before, from which phases B and C should not stray.
        self.before = copy.deepcopy(self.model)
        self.before_z = prior.z_sdf.mean.clone()
        self.networks_open = self.covering = False
        self.ears_covered = torch.zeros(2, dtype=torch.bool, device=device)
        self.evidence = evidence
        self.coefficients = nn.Parameter(evidence.coefficients.clone())
        self.appearance = nn.Parameter(torch.zeros(prior.z_r.basis.shape[1], device=device))
        self.pose = PoseCorrection(nn.Parameter(evidence.pose[:3].clone()), nn.Parameter(evidence.pose[3:].clone()))

    def codes(self) -> tuple[Tensor, Tensor]:
        """z_sdf and z_r."""
        return self.prior.z_sdf.code(self.coefficients), self.prior.z_r.code(self.appearance)

    def state(self) -> dict[str, Tensor]:
        """All that the fit's steps change."""
        own = {
            "coefficients": self.coefficients,
            "appearance": self.appearance,
            "rotation": self.pose.rotation,
            "translation": self.pose.translation,
            "before_z": self.before_z,
            "ears_covered": self.ears_covered,
        }
        for name, rays in (("inside", self.inside), ("edge", self.edge)):
            own |= {f"{name}_index": rays.index, f"{name}_t": rays.t, f"{name}_hit": rays.hit}
        own |= {"edge_weight": self.edge.weight, "edge_lowest": self.edge.lowest}
        for name, model in (("model", self.model), ("before", self.before)):
            own |= {f"{name}.{key}": value for key, value in model.state_dict().items()}
        return own

    def network_parameters(self) -> list[nn.Parameter]:
        """Deformation and renderer: never the reference."""
        return [*self.model.deformation.parameters(), *self.model.renderer.parameters()]

    def new_renderer(self) -> list[nn.Parameter]:
        """The renderer where the prior has not trained it: it learns from the first step. Else nothing."""
        return [] if self.model.config.joint_appearance else list(self.model.renderer.parameters())

    def open_new_renderer(self) -> None:
        """Let gradients reach an untrained renderer."""
        for parameter in self.new_renderer():
            parameter.requires_grad_(True)

    def open_networks(self) -> None:
        """Let gradients reach the networks, and their anchor."""
        self.networks_open = True
        for parameter in self.network_parameters():
            parameter.requires_grad_(True)

    def begin_cover(self) -> None:
        """Take the present state as what phase C should keep, and look where the silhouette is wrong."""
        self.remember()
        most = ATTENDED_FOR_A_STEP * max(self.config.steps_cover, 1)
        self.edge.attend(self.config.attention, most, self.model, self.codes()[0], self.pose, self.config.trace)

    def open_cover(self) -> None:
        """Let gradients reach the deformation; the colours have had their say."""
        self.networks_open = self.covering = True
        for parameter in self.model.deformation.parameters():
            parameter.requires_grad_(True)

    @torch.no_grad()
    def remember(self) -> None:
        """Take the present state as what the phase that begins should keep."""
        self.before.load_state_dict(self.model.state_dict())
        self.before_z.copy_(self.codes()[0])
        if not self.networks_open:
            # Once, and on what the codes make of the head: networks may have drawn ears out already.
            self.edge.retrace(self.model, self.before_z, self.pose, self.config.trace)
            shares = self.edge.beyond_ears(self.model, self.before_z, self.pose)
            self.ears_covered.copy_(shares > self.config.hair_share)

    @torch.no_grad()
    def retrace(self, generator: torch.Generator) -> None:
        """Follow other rays, and trace them."""
        for kept in (self.inside, self.edge):
            kept.choose(generator)
        z_sdf = self.codes()[0]
        self.inside.retrace(self.model, z_sdf, self.pose, self.config.trace)
        self.edge.retrace(self.model, z_sdf, self.pose, self.config.trace)
        self.edge.deepest(self.model, z_sdf, self.pose)
        if self.networks_open and bool(self.ears_covered.any()):
            self.edge.spare_ears(self.model, z_sdf, self.pose, self.before, self.before_z, self.ears_covered)

    def losses(self, generator: torch.Generator, *, geometry: bool, share: float) -> dict[str, Tensor]:
        """Weighted loss terms of one step, `share` of its phase's way; without `geometry` only the appearance code
        learns."""
        c = self.config
        z_sdf, z_r = self.codes()
        usable = self.inside.hit & self.inside.every.usable[self.inside.index]
        chosen = self.inside.draw(c.rays // 2 if self.covering else c.rays, generator, usable.float())
        rays = self.inside.drawn(chosen)
        origins, directions = corrected(self.pose, rays.origins, rays.directions)
        x0 = origins + self.inside.t[chosen, None] * directions
        if not geometry:
            with torch.no_grad():
                z_sdf = z_sdf.detach()
            _, gradient, x_ref, gamma = sdf_and_gradient(self.model, x0.detach(), z_sdf, differentiable=False)
            normals, x_ref, gamma = nn.functional.normalize(gradient.detach(), dim=-1), x_ref.detach(), gamma.detach()
            colour = self.model.render(x_ref, normals, -directions.detach(), gamma, z_r)
            return {
                "colour": c.colour * (colour - rays.rgb).abs().mean(),
                "appearance_prior": c.appearance_prior * self.appearance.square().sum(),
            }
        f, gradient, _, _ = sdf_and_gradient(self.model, x0, z_sdf, differentiable=True)
        length = gradient.norm(dim=-1)
        normals = gradient / length.clamp_min(1e-6)[:, None]
        x = differentiable_hit(x0, directions, f, gradient)
        if self.covering:
            far, uneven = self._anchor(x.detach(), z_sdf, generator)
            return {
                "silhouette": c.silhouette * self._silhouette(z_sdf, generator),
                "eikonal": c.eikonal * ((length - 1.0) ** 2).mean(),
                "anchor": c.hold * c.hold_first ** (1.0 - share) * far,
                "slope": c.slope * uneven,
            }
        on = (f.detach().abs() < c.lost).float()
        with torch.no_grad():
            # A step that is not finite is taken back; its rays must stay where they were.
            self.inside.t[chosen] += ((x - x0) * directions).sum(-1).nan_to_num(0.0).clamp(-c.lost, c.lost)
        delta, gamma = self.model.deform(x, z_sdf)
        colour = self.model.render(x + delta, normals, -directions, gamma, z_r)
        pose = torch.cat([self.pose.rotation, self.pose.translation])
        losses = {
            "colour": c.colour * ((colour - rays.rgb).abs().mean(-1) * on).sum() / on.sum().clamp_min(1.0),
            "silhouette": c.silhouette * self._silhouette(z_sdf, generator),
            "prior": c.prior * self.evidence.energy(self.coefficients, pose),
            "appearance_prior": c.appearance_prior * self.appearance.square().sum(),
        }
        if self.networks_open:
            losses["eikonal"] = c.eikonal * ((length - 1.0) ** 2).mean()
            far, uneven = self._anchor(x.detach(), z_sdf, generator)
            losses["anchor"], losses["slope"] = c.anchor * far, c.slope * uneven
            losses["symmetry"] = c.symmetry * self._lopsided(x.detach(), z_sdf)
        return losses

    def _silhouette(self, z_sdf: Tensor, generator: torch.Generator) -> Tensor:
        """Cross-entropy of the soft silhouette, over band rays that miss where they should hit or the reverse; in phase
        C also over those that hit and only graze."""
        c = self.config
        # Rays that hit and should are content, as in IDR; those that miss and should only guard the outside. In phase C
        # a ray that just grazes is drawn in as well, or rays that were won are lost as soon as nothing holds them.
        hit, inside = self.edge.hit, self.edge.every.in_mask[self.edge.index]
        content = hit & inside & (self.edge.lowest < -COVERED if self.covering else True)
        chance = torch.where(content, 0.0, torch.where(hit | inside, 1.0, 0.2))
        chosen = self.edge.draw(c.band_rays, generator, chance)
        rays = self.edge.drawn(chosen)
        origins, directions = corrected(self.pose, rays.origins, rays.directions)
        x = origins + self.edge.t[chosen, None] * directions
        f, _, _ = self.model(x, z_sdf)
        target = rays.in_mask.float()
        logits = -c.alpha * f
        off = nn.functional.binary_cross_entropy_with_logits(logits, target, reduction="none") / c.alpha
        # Saturating: hair and clothes that no code can reach must not bend the face. The networks can reach further.
        reach = c.reach_networks if self.networks_open else c.reach
        robust = reach * off / (reach + off)
        weight = torch.where(rays.in_mask & self.networks_open, c.cover_last if self.covering else c.cover, 1.0)
        return 10.0 * chance.mean() * (weight * robust).sum() / max(len(chosen), 1)

    def _anchor(self, x: Tensor, z_sdf: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """How far, squared, and how unevenly the deformation changed since the phase before, where seen and around it.

        The second term is the squared slope of the change: it lets features move and keeps spikes (an ear drawn out
        into hair) from growing.
        """
        low, high = (x.new_tensor(b / UNIT_M) for b in BOUNDS_M)
        random = torch.rand(256, 3, generator=generator, device=x.device)
        edge = self.edge.draw(256, generator, torch.ones_like(self.edge.t))
        rays = self.edge.drawn(edge)
        with torch.no_grad():
            origins, directions = corrected(self.pose, rays.origins, rays.directions)
        band = origins + self.edge.t[edge, None] * directions
        seen = [x] if self.covering else [x[:HELD], band]
        points = torch.cat([*seen, low + (high - low) * random])
        away = SLOPE_REACH * torch.randn(points.shape, generator=generator, device=x.device)
        both = torch.cat([points, points + away])
        with torch.no_grad():
            before, _ = self.before.deform(both, self.before_z)
        now, _ = self.model.deform(both, z_sdf)
        here, there = (now - before).chunk(2)
        slope = (there - here).square().sum(-1) / away.square().sum(-1)
        # Below the chin are collars and scarves, which stand off the neck that the prior knows.
        held = torch.where(points[:, 1] * UNIT_M < CUT_Y_M, 0.1, 1.0)
        covered = (on_ears(points + before[: len(points)]) & self.ears_covered).any(-1)
        held = torch.where(covered, self.config.ear_hold, held)
        return (held * here.square().sum(-1)).mean(), (held * slope).mean()

    def _lopsided(self, x: Tensor, z_sdf: Tensor) -> Tensor:
        """How far, squared, the deformation's change since the phase before is from its mirror image, over the face."""
        x = x[:HELD]
        flip = x.new_tensor([-1.0, 1.0, 1.0])
        both = torch.cat([x, flip * x])
        with torch.no_grad():
            before, _ = self.before.deform(both, self.before_z)
        now, _ = self.model.deform(both, z_sdf)
        here, there = (now - before).chunk(2)
        return (on_face(x) * (here - flip * there).square().sum(-1)).mean()
