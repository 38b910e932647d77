"""The loss terms of the appearance fit, and the state that its steps change.

Notation: as in fields/af_sm.py; r_pb = r_d + k_s r_s; a = a_base + k_r a_refine; S_i visibility of lobe i;
L_reg = mean |a_refine| w with w = l8 max(0, |a_base|_1 - |r_d,base|_1) + l9 |r_s|_1, large in shadow (attached or cast)
and in highlights, so that neither is baked into the albedo.
"""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from sira_assets.fields.af_sm import AppearanceFactorModel
from sira_assets.fields.fitted import AlbedoRefinement, RefinementConfig
from sira_assets.fields.prior import Prior
from sira_assets.fit.fewer_lobes import fewer_lobes
from sira_assets.fit.light import FreeLight
from sira_assets.fit.pixels import on_face
from sira_assets.fit.seen_surface import SurfacePoints
from sira_assets.fit.shadows import FitShadows, ShadowConfig
from sira_assets.numerics.sg import Grade
from sira_assets.numerics.srgb import srgb_decode, srgb_encode_beyond
from sira_assets.render.shading import ROUGHNESS, Shading, shade
from sira_assets.render.visibility_table import VisibilityTable


@dataclass(frozen=True)
class AppearanceFitConfig:
    """Steps of each stage, pixels a step, rates and weights (l8, l9 in the paper).

    Parameters
    ----------
    max_surface : seen points that the refinement learns from; all other stages make do with `early_surface` of them
    lobes : how many of the mean light's lobes the search starts from, those that give most; all if None
    grade : of the closed-form shading, see `render.shading.shade`
    shadows : whether the head casts shadows on itself
    scheduled : False learns light, codes and the decoders' own weights all at once, with k_s = 1 and no refinement, in
        as many steps: what is left where there is no trained prior (the paper's ablation)
    tint : weight of `FreeLight.tint`
    squared : weight of the colour's squared error beside the plain one in the refinement, where few pixels are far off;
        before it, pixels that no head of the prior can explain shall not decide
    face : how much more often than other points those of the face are drawn before the refinement
    drift : weight of the patches' mean refinement, see `_drift`; `drift_scale` the share of the base albedo from which
        on a patch counts as of another material, `drift_cell` its size (network units), `drift_from` the share of the
        refinement's steps after which the term sets in
    everything : keep every lobe, highlights and shadows, whether the scene requires them or not
    merge : lobes are made one, once found, while the seen surface's mean sRGB-encoded radiance changes by no more
    roughness_every : steps between two looks for a better roughness
    """

    steps_light: int = 150
    steps_albedo: int = 200
    steps_specular: int = 150
    steps_refinement: int = 800
    pixels: int = 3000
    max_surface: int = 60000
    early_surface: int = 15000
    rate_codes: float = 0.05
    rate_light: float = 0.03
    rate_refinement: float = 1.0e-2
    rate_decoders: float = 1.5e-3
    albedo_prior: float = 3.0e-5
    light_prior: float = 3.0e-5
    tint: float = 4.0e-4
    squared: float = 12.0
    shadow: float = 1.0
    highlight: float = 2.0
    regularity: float = 0.25
    unseen: float = 0.5
    lobes: int | None = None
    grade: Grade = "accurate"
    face: float = 5.0
    drift: float = 0.02
    drift_scale: float = 0.12
    drift_cell: float = 0.12
    drift_from: float = 0.4
    shadows: bool = True
    scheduled: bool = True
    roughness_every: int = 10
    everything: bool = False
    merge: float = 0.002
    rays: ShadowConfig = ShadowConfig()
    refinement: RefinementConfig = RefinementConfig()
    seed: int = 0


# Steps in which the roughness is sought, where skin has been measured (Weyrich et al. 2006), and at how many points.
ROUGHNESS_STEP = 0.02
ROUGHNESS_RANGE = (0.3, 0.7)
ROUGHNESS_POINTS = 4000
# Points of the face whose mean albedo the light follows.
LEVEL_POINTS = 200
# Skin reflects, so highlights stay unless the fit with them is worse by more than this share of the mean error. Without
# any in the photo it was worse by 2 to 9 % (generated heads under one and twelve lobes), with them from 10 % better to
# 4 % worse, on a real scan neither.
MOST_HIGHLIGHT_LOSS = 0.02
# Points that decide which lobes are made one.
MERGED_POINTS = 1500
# A channel of a clipped pixel counts as clipped from here, an 8-bit step below white.
CLIPPED = 254.5 / 255.0


class AppearanceLosses:
    """The loss terms of every step, and what they read: all tensors in it change in place."""

    def __init__(
        self,
        config: AppearanceFitConfig,
        prior: Prior,
        surface: SurfacePoints,
        hidden: tuple[Tensor, Tensor],
        shadows: FitShadows | None,
    ):
        device = surface.x.device
        self.config, self.prior, self.hidden, self.shadows = config, prior, hidden, shadows
        self.surface = surface
        step = max(1, len(surface) // config.early_surface)
        self.early = surface.rows(torch.arange(0, len(surface), step, device=device))
        # Which points the present stage draws from, and what they see.
        self.points: SurfacePoints = self.early
        self.table: VisibilityTable | None = None
        self.model = prior.appearance if config.scheduled else opened(prior.appearance)
        self.light = FreeLight(prior, lobes=config.lobes)
        face = torch.nonzero(on_face(self.early.x))[:, 0]
        face = face if len(face) else torch.arange(len(self.early), device=device)
        self.level_points = self.early.rows(face[:: max(1, len(face) // LEVEL_POINTS)])
        # Each lobe's share at all points when last looked at; nothing to keep without shadows.
        self.held = torch.ones(len(surface) if shadows is not None else 0, len(self.light.log_sharpness), device=device)
        self.z_a = nn.Parameter(torch.zeros(prior.z_a.basis.shape[1], device=device))
        self.z_s = nn.Parameter(torch.zeros(prior.z_s.basis.shape[1], device=device))
        self.roughness = torch.tensor(ROUGHNESS, dtype=torch.float64)
        # Mean errors without and with highlights once each was fitted, and whether they are needed.
        self.plain_error, self.shiny_error = (torch.tensor(0.0, dtype=torch.float64) for _ in range(2))
        self.highlights = torch.tensor(1.0)
        # What making lobes one has changed so far.
        self.merging = torch.tensor(0.0, dtype=torch.float64)
        feature_size = surface.gamma.shape[-1]
        # Layers draw their first weights from the global generator: seeded here, and left as it was.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.refinement = AlbedoRefinement(config.refinement, feature_size=feature_size).to(device)
        # The level of the albedo that the light goes with, see `_follow`.
        self.level = self._level().detach()
        self.plain = [tensor.detach().clone() for tensor in self._fitted()]
        self._match_exposure()

    def state(self) -> dict[str, Tensor]:
        """All that the fit's steps change."""
        own = self.light.state() | {"z_a": self.z_a, "z_s": self.z_s, "level": self.level}
        own |= {"roughness": self.roughness, "merging": self.merging, "highlights": self.highlights}
        own |= {"plain_error": self.plain_error, "shiny_error": self.shiny_error}
        own |= {f"plain.{i}": tensor for i, tensor in enumerate(self.plain)}
        own |= {f"refinement.{key}": value for key, value in self.refinement.state_dict().items()}
        if not self.config.scheduled:
            own |= {f"model.{key}": value for key, value in self.model.state_dict().items()}
        return own | (self.shadows.state() | {"held": self.held} if self.shadows is not None else {})

    def enter_early(self) -> None:
        """Draw from some of the points; shadows of a light that may be anywhere, cast when first asked for."""
        if self.shadows is not None and self.table is None:
            self.table = self.shadows.early_table(self.early)

    def aim(self) -> None:
        """Turn to the light that was found: lobes that the surface cannot tell apart are made one."""
        if self.config.merge > 0 and not self.config.everything:
            self._merge_lobes()
        if self.shadows is not None:
            self.shadows.aim(self.light)

    def enter_aimed(self, points: SurfacePoints) -> None:
        """Draw from these points; shadows of the light that `aim` turned to."""
        self.points = points
        self.table = None if self.shadows is None else self.shadows.aimed_table(points)

    @torch.no_grad()
    def shares(self) -> Tensor | None:
        """(N, M) of the lobes where they now are, at the points of the present stage; None without shadows."""
        if self.table is None:
            return None
        return self.table.share(torch.arange(len(self.points), device=self.points.x.device), *self.light.lobes()[:2])

    def look(self) -> None:
        """Take the shares that the refinement holds."""
        if self.table is not None:
            self.held[:, self.light.kept] = self.shares()

    def losses(self, generator: torch.Generator, *, k_s: float, refine: bool, drift: bool = False) -> dict[str, Tensor]:
        """Weighted loss terms of one step.

        Parameters
        ----------
        k_s : weight of the specular lobe
        refine : fit a_refine on the frozen base albedo
        drift : hold the refinement's means over patches
        """
        c, device = self.config, self.points.x.device
        count = min(c.pixels, len(self.points))
        if refine:
            rows = torch.randint(len(self.points), (count,), generator=generator, device=device)
        else:
            # The prior knows skin best: the light is read from the face rather than from hair and clothes.
            chance = torch.where(on_face(self.points.x), c.face, 1.0)
            rows = torch.multinomial(chance, count, replacement=True, generator=generator)
        points = self.points.rows(rows)
        base = self.model.diffuse(points.x_ref, points.gamma, self.prior.z_a.code(self.z_a))
        albedo = base
        if refine:
            base = base.detach()
            extra = self.refinement(points.x_ref, points.gamma)
            albedo = (base + extra).clamp(1e-4, 1.0)
        f0 = None
        if k_s > 0 or not refine:
            # Before the refinement the reflection at grazing angles stays on: with it left out as well, light took its
            # place (james_soft: specular albedo 9.4 instead of 10.8 dB, the light too bright by 2.0 instead of 1.8).
            f0 = k_s * self.model.specular_f0(points.x_ref, albedo, self.prior.z_s.code(self.z_s))
        brighter = self._follow() if c.scheduled and not refine else 0.0
        lobes = self.light.lobes(brighter)
        if self.table is None:
            seen = None
        else:
            # While the light is sought its shadows pull at it; in the refinement it hardly moves.
            seen = self.held[rows][:, self.light.kept] if refine else self.table.share(rows, *lobes[:2])
        roughness = float(self.roughness)
        shading = shade(
            points.normals,
            points.view,
            albedo,
            f0,
            *lobes,
            roughness=roughness,
            visibility=seen,
            grade=c.grade,
        )
        losses = {
            "colour": colour_error(shading.radiance, points, squared=c.squared if refine else 0.0),
            "albedo_prior": c.albedo_prior * (self.z_a.square().sum() + self.z_s.square().sum()),
            "light_prior": c.light_prior * self.light.energy(),
            "tint": c.tint * self.light.tint(brighter),
        }
        if refine:
            diffuse_base = base * shading.irradiance.detach() / math.pi
            weight = c.shadow * (base.sum(-1) - diffuse_base.sum(-1)).clamp_min(0.0)
            weight = weight + c.highlight * shading.specular_radiance.detach().sum(-1)
            losses["regularity"] = c.regularity * (extra.abs().sum(-1) * weight).mean()
            pick = torch.randint(len(self.hidden[0]), (512,), generator=generator, device=device)
            unseen = self.refinement(self.hidden[0][pick], self.hidden[1][pick])
            losses["unseen"] = c.unseen * unseen.abs().mean()
            if drift:
                losses["drift"] = c.drift * self._drift(extra, base, points.x_ref, generator)
        return losses

    def _drift(self, extra: Tensor, base: Tensor, x_ref: Tensor, generator: torch.Generator) -> Tensor:
        """How far the mean refinement of patches leaves the base albedo, saturating (Geman and McClure).

        What is even over a centimetre is light that the lobes could not make, unless it is so much that it must be
        another material: collars, dyed hair.
        """
        c = self.config
        shift = torch.rand(3, generator=generator, device=x_ref.device)
        cells = torch.floor(x_ref / c.drift_cell + shift).long()
        cells = cells - cells.amin(0)
        _, high, deep = (cells.amax(0) + 1).tolist()
        # One number a cell: unique rows take ten times as long.
        _, cell = torch.unique((cells[:, 0] * high + cells[:, 1]) * deep + cells[:, 2], return_inverse=True)
        total = extra.new_zeros(int(cell.max()) + 1, 7)
        total = total.index_add(0, cell, torch.cat([extra, base + 0.02, torch.ones_like(base[:, :1])], -1))
        mean = total[:, :3] / total[:, 3:6].clamp_min(1e-6)
        squared = mean.square()
        robust = (squared / (c.drift_scale**2 + squared)).mean(-1)
        return (total[:, 6] * robust).sum() / len(x_ref)

    def _level(self) -> Tensor:
        """(3,) mean log of the face's base albedo."""
        points = self.level_points
        albedo = self.model.diffuse(points.x_ref, points.gamma, self.prior.z_a.code(self.z_a))
        return albedo.clamp_min(1e-4).log().mean(0)

    def _follow(self) -> Tensor:
        """Make the light as much brighter as the albedo has become darker; (3,) zeros whose gradient goes on doing so.

        A darker skin in so much more light looks the same but for its hue, so steps that move either alone hardly move
        at all: all skin would stay near the lightness it was begun with.
        """
        level = self._level()
        self.light.brighten(self.level - level.detach())
        self.level.copy_(level.detach())
        return level.detach() - level

    @torch.no_grad()
    def settle_light(self) -> None:
        """Let the light follow the last step's albedo too."""
        if self.config.scheduled:
            self._follow()

    @torch.no_grad()
    def settle_roughness(self, *, k_s: float) -> None:
        """Move the roughness by a step if that explains the photo better, everything else being as it is.

        The closed form has no gradient in the roughness: GGX's energy comes from a table for each (`ggx_albedo`).
        """
        error = self._error_at(self._some_rows(), k_s=k_s)
        now = float(self.roughness)
        low, high = ROUGHNESS_RANGE
        tried = [r for r in (now, now - ROUGHNESS_STEP, now + ROUGHNESS_STEP) if low <= r <= high]
        self.roughness.fill_(round(min(tried, key=error), 6))

    def _error_at(self, rows: Tensor, *, k_s: float) -> Callable[[float], float]:
        """The mean error at these points by the base albedo, of a roughness."""
        points, lobes = self.points.rows(rows), self.light.lobes()
        albedo = self.model.diffuse(points.x_ref, points.gamma, self.prior.z_a.code(self.z_a))
        f0 = k_s * self.model.specular_f0(points.x_ref, albedo, self.prior.z_s.code(self.z_s))
        seen = None if self.table is None else self.table.share(rows, *lobes[:2])

        def error(roughness: float) -> float:
            shading = shade(points.normals, points.view, albedo, f0, *lobes, roughness=roughness, visibility=seen)
            return float(colour_error(shading.radiance, points))

        return error

    @torch.no_grad()
    def remember_plain(self) -> None:
        """Keep what explains the photo without highlights, and how well it does."""
        self.plain_error.fill_(self._error_at(self._some_rows(), k_s=0.0)(float(self.roughness)))
        for kept, now in zip(self.plain, self._fitted(), strict=True):
            kept.copy_(now)

    @torch.no_grad()
    def decide_highlights(self) -> None:
        """Go back to what explained the photo without highlights if these have made it clearly worse.

        Both sides have been fitted, light, albedo and all: taking highlights away from a fit made with them would leave
        their place dark, and nothing would ever do without.
        """
        self.shiny_error.fill_(self._error_at(self._some_rows(), k_s=1.0)(float(self.roughness)))
        if not self.config.everything and self.shiny_error > (1.0 + MOST_HIGHLIGHT_LOSS) * self.plain_error:
            self.highlights.fill_(0.0)
            for kept, now in zip(self.plain, self._fitted(), strict=True):
                now.copy_(kept)

    def _fitted(self) -> list[Tensor]:
        """What the stages before the refinement have found, without highlights' own."""
        return [*self.light.parameters(), self.light.start, self.light.kept, self.z_a, self.level]

    def _some_rows(self) -> Tensor:
        step = max(1, len(self.points) // ROUGHNESS_POINTS)
        return torch.arange(0, len(self.points), step, device=self.z_a.device)

    @torch.no_grad()
    def _merge_lobes(self) -> None:
        """One lobe for those that could be told apart on the seen surface by less than `merge`."""
        rows = torch.arange(0, len(self.early), max(1, len(self.early) // MERGED_POINTS), device=self.z_a.device)
        points = self.early.rows(rows)
        albedo = self.model.diffuse(points.x_ref, points.gamma, self.prior.z_a.code(self.z_a))
        f0 = None
        if self.highlights > 0:
            f0 = self.model.specular_f0(points.x_ref, albedo, self.prior.z_s.code(self.z_s))
        lobes, kept, change = fewer_lobes(
            points.normals,
            points.view,
            albedo,
            f0,
            self.light.lobes(),
            roughness=float(self.roughness),
            most_change=self.config.merge,
        )
        self.light.put(lobes, kept)
        self.merging += change

    @torch.no_grad()
    def _match_exposure(self) -> None:
        """Scale the starting light so that the mean albedo under it is as bright as the photo on average."""
        surface = self.surface
        albedo = self.model.diffuse(surface.x_ref, surface.gamma, self.prior.z_a.mean)
        shading: Shading = shade(surface.normals, surface.view, albedo, None, *self.light.lobes())
        gain = srgb_decode(surface.rays.rgb).mean() / shading.radiance.mean().clamp_min(1e-6)
        self.light.brighten(math.log(min(max(float(gain), 1e-4), 1e4)))


def opened(model: AppearanceFactorModel) -> AppearanceFactorModel:
    """A copy whose albedo and specular decoders may learn."""
    model = copy.deepcopy(model)
    for decoder in (model.albedo, model.specular):
        decoder.requires_grad_(True)
    return model


def colour_error(radiance: Tensor, points: SurfacePoints, *, squared: float = 0.0) -> Tensor:
    """Mean error, and the mean of its square times `squared`, sRGB-encoded; a channel that the photo clipped says only:
    as bright as that, or brighter."""
    error = srgb_encode_beyond(radiance) - points.rays.rgb
    clipped = ~points.rays.usable[:, None] & (points.rays.rgb >= CLIPPED)
    error = torch.where(clipped, error.clamp_max(0.0), error)
    return error.abs().mean() + squared * error.square().mean() if squared else error.abs().mean()
