"""What a photo's shading tells of the shape, before anything else is fitted: Gauss-Newton steps on the shape code.

Notation: c coefficients of z_sdf (sigma units), q the pose correction (w, u), L the second-order spherical harmonics of
the irradiance for each colour, b the gains of patches, all found together; the photo is taken for
exp(Phi b) sqrt(a(x_ref)) (Y(n) L), sRGB-encoded, with n the normal and a the mean albedo of AF-SM where a
pixel's ray meets the surface. The square root is half-way between the model's mean person and skin of one colour.
Frames and units as in fit/geometry.py.

Irradiance is what nine harmonics hold to a few per cent (Ramamoorthi and Hanrahan 2001, DOI 10.1145/383259.383317), and
the renderer of SA-SM, which is not bound to any light, cannot tell from one photo what its change of brightness owes to
the normals. Patches (centimetres wide) stand for the albedo and the shadows that this leaves out.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.fields.mlp import UNIT_M
from sira_assets.fields.prior import Prior
from sira_assets.fields.sa_sm import sdf_and_gradient
from sira_assets.fit.landmark_rays import LandmarkRays, landmark_offsets
from sira_assets.fit.pixels import PixelRays
from sira_assets.fit.pose import POSE_SIGMA, PoseCorrection, corrected, moved_by
from sira_assets.numerics.srgb import srgb_decode, srgb_encode_beyond
from sira_assets.render.tracing import TraceConfig, sphere_trace

# Pixels within this of the face's middle, in front of this depth and not more aslant than this, network units.
FACE_MIDDLE, FACE_RADIUS, FACE_BACK, LEAST_FACING = (0.0, -0.35), 0.85, -0.3, 0.3
# A hit moves along its ray by no more than this a Newton step, whose slope is no flatter than that.
LONGEST_MOVE, FLATTEST = 0.08, 0.2
# Fewer pixels than this say nothing worth the time.
FEWEST = 200
# Looks for a smaller objective before a step is given up, each with four times the damping.
TRIES = 5
# A step that lowers the objective by less (nats) is the last.
ENOUGH = 0.1
# The light is as free as the photo lets it be; this keeps an unlit side's from being undetermined.
LIGHT_PRECISION = 1.0e-3
# The landmarks say where the head stands; so many times what they leave open keeps a pose from running away.
LOOSE_POSE = 4.0
# A landmark that misses by more expected misses than this is another spot (Geman and McClure).
WRONG = 3.0
# Robust means that the first light is found by.
LIGHT_ROUNDS, LIGHT_ERROR = 10, 0.05


@dataclass(frozen=True)
class ShadingConfig:
    """How far the photo's shading is believed.

    Parameters
    ----------
    pixels : at most so many are looked at
    steps : at most so many Gauss-Newton steps
    worth : so many pixels of independent errors the face is worth, however many are looked at: neighbours err alike
    error : from here on (sRGB-encoded) an error is another material or a shadow (Geman and McClure)
    usual : a photo whose median error under the first light is greater is believed less, by the fourth power: its
        errors are larger, and cover more
    patch : standard deviation of Phi, network units, and the distance of the patches
    patch_gain, patch_tint : standard deviations of b, common to the colours and of each
    """

    pixels: int = 3000
    steps: int = 8
    worth: float = 600.0
    error: float = 0.04
    usual: float = 0.025
    patch: float = 0.25
    patch_gain: float = 0.05
    patch_tint: float = 0.05


@dataclass(frozen=True)
class ShadingEvidence:
    """A gaussian that the shading multiplies the prior of c by, and where both together put c and the pose.

    Parameters
    ----------
    coefficients : (K,) the most probable c
    pose : (6,) the most probable correction, zero where the pose is given
    precision : (K + 6, K + 6) of photo and pose about both, light and patches integrated out; (K, K) of the photo about
        c where the pose is given
    """

    coefficients: Float[Tensor, " K"]
    pose: Float[Tensor, "6"]
    precision: Float[Tensor, "P P"]

    def energy(self, coefficients: Float[Tensor, " K"], pose: Float[Tensor, "6"]) -> Float[Tensor, ""]:
        """Squared distance from the most probable c and pose under prior and photo; |c|^2 where no photo tells."""
        away = coefficients - self.coefficients
        both = torch.cat([away, pose - self.pose])[: len(self.precision)]
        return away.square().sum() + both @ self.precision @ both


def no_evidence(prior: Prior, *, refine_pose: bool) -> ShadingEvidence:
    """That of a photo whose shading tells nothing."""
    zeros = torch.zeros_like(prior.z_sdf.basis[0])
    sigma = zeros.new_tensor(POSE_SIGMA if refine_pose else ())
    return ShadingEvidence(zeros, zeros.new_zeros(6), torch.diag(torch.cat([zeros, sigma**-2])))


def shading_evidence(
    rays: PixelRays, landmarks: LandmarkRays, prior: Prior, config: ShadingConfig, generator: torch.Generator
) -> ShadingEvidence:
    """Find the shape whose normals shade as the photo does, and how sure that is.

    Parameters
    ----------
    rays : of the mask
    landmarks : those that the pose was estimated from, which is then found anew together with the shape; or none
    """
    if config.steps < 1:
        return no_evidence(prior, refine_pose=len(landmarks) > 0)
    pixels, t = _face_pixels(rays, prior, config, generator)
    if len(pixels) < FEWEST:
        return no_evidence(prior, refine_pose=len(landmarks) > 0)
    return _Problem(pixels, t, landmarks, prior, config).solved(t)


def harmonics(n: Float[Tensor, "N 3"]) -> Float[Tensor, "N 9"]:
    """Real spherical harmonics up to the second order at unit n, not normalised."""
    x, y, z = n.unbind(-1)
    return torch.stack([torch.ones_like(x), x, y, z, x * y, y * z, 3.0 * z * z - 1.0, x * z, x * x - y * y], -1)


def harmonics_slopes(n: Float[Tensor, "N 3"]) -> Float[Tensor, "N 9 3"]:
    """Derivatives of `harmonics` in x, y, z."""
    x, y, z = n.unbind(-1)
    one, no = torch.ones_like(x), torch.zeros_like(x)
    rows = [
        (no, no, no),
        (one, no, no),
        (no, one, no),
        (no, no, one),
        (y, x, no),
        (no, z, y),
        (no, no, 6.0 * z),
        (z, no, x),
        (2.0 * x, -2.0 * y, no),
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def _face_pixels(
    rays: PixelRays, prior: Prior, config: ShadingConfig, generator: torch.Generator
) -> tuple[PixelRays, Tensor]:
    """Pixels in which the prior's mean head shows its face, and where their rays meet it."""
    device = rays.origins.device
    order = torch.randperm(len(rays), generator=generator, device=device)[: 4 * config.pixels]
    rays = rays.select(order)
    low, high = (rays.origins.new_tensor(bound / UNIT_M) for bound in BOUNDS_M)
    z_sdf = prior.z_sdf.mean
    hits = sphere_trace(lambda x: prior.shape(x, z_sdf)[0], rays.origins, rays.directions, low, high, TraceConfig())
    x = rays.origins + hits.t[:, None] * rays.directions
    _, gradient, _, _ = sdf_and_gradient(prior.shape, x, z_sdf, differentiable=False)
    facing = -(nn.functional.normalize(gradient, dim=-1) * rays.directions).sum(-1)
    face = ((x[:, :2] - x.new_tensor(FACE_MIDDLE)).norm(dim=-1) < FACE_RADIUS) & (x[:, 2] > FACE_BACK)
    chosen = torch.nonzero(hits.hit & rays.usable & face & (facing > LEAST_FACING))[: config.pixels, 0]
    return rays.select(chosen), hits.t[chosen]


@dataclass(frozen=True)
class _Seen:
    """The surface in each pixel for some c and q, and its change with them: the last axis is (c, q).

    Parameters
    ----------
    t : (N,) along the rays
    n, root : (N, 3) normal and square root of the albedo
    dn, droot : (N, 3, K + 6), or (N, 3, K) where the pose is given
    r, dr : (L, 3) and (L, 3, K + 6) offsets of the landmarks from their rays, in expected misses; or none
    """

    t: Tensor
    n: Tensor
    root: Tensor
    dn: Tensor
    droot: Tensor
    r: Tensor
    dr: Tensor


class _Problem:
    """The photo's pixels, and the unknowns p = (c, q, L, b) one after another."""

    def __init__(self, pixels: PixelRays, t: Tensor, landmarks: LandmarkRays, prior: Prior, config: ShadingConfig):
        self.pixels, self.landmarks, self.prior, self.config = pixels, landmarks, prior, config
        self.linear = srgb_decode(pixels.rgb)
        self.patches = _patches((pixels.origins + t[:, None] * pixels.directions)[:, :2], config.patch)
        self.codes, self.gains = prior.z_sdf.basis.shape[1], self.patches.shape[1]
        self.poses = 6 if len(landmarks) else 0
        ones = lambda count, sigma: t.new_full((count,), sigma**-2)  # noqa: E731
        self.precision = torch.cat(
            [
                ones(self.codes, 1.0),
                (LOOSE_POSE * t.new_tensor(POSE_SIGMA[: self.poses])) ** -2,
                t.new_zeros(27),
                ones(self.gains, config.patch_gain),
                ones(3 * self.gains, config.patch_tint),
            ]
        )
        self.damping = self.precision.clamp_min(LIGHT_PRECISION)
        self.weight = min(config.worth / len(t), 1.0)

    def solved(self, t: Tensor) -> ShadingEvidence:
        """Gauss-Newton with Levenberg's damping, from the mean head."""
        p = torch.zeros_like(self.precision)
        seen = self.seen(p, t)
        light = self.first_light(seen)
        p[self.codes + self.poses :][:27] = light.T.flatten()
        usual = float(self.error(p, seen)[1].abs().median())
        self.weight *= min(1.0, (self.config.usual / max(usual, 1e-6)) ** 4)
        value, damping = self.objective(p, seen), 1.0
        for _ in range(self.config.steps):
            hessian, slope = self.normal_equations(p, seen)
            for _ in range(TRIES):
                damped = hessian + torch.diag(damping * self.damping.double())
                trial = p - torch.linalg.solve(damped, slope).to(p)
                trial_seen = self.seen(trial, seen.t)
                trial_value = self.objective(trial, trial_seen)
                if trial_value < value:
                    break
                damping *= 4.0
            else:
                break
            fall, p, seen, value, damping = value - trial_value, trial, trial_seen, trial_value, max(1.0, damping / 4)
            if fall < ENOUGH:
                break
        precision = self.of_shape(self.normal_equations(p, seen)[0])
        return ShadingEvidence(p[: self.codes].clone(), self.pose(p), precision.to(p))

    def pose(self, p: Tensor) -> Tensor:
        """(6,) q; zero where the pose is given."""
        return p[self.codes : self.codes + 6].clone() if self.poses else p.new_zeros(6)

    def light_and_gain(self, p: Tensor) -> tuple[Tensor, Tensor]:
        """(9, 3) L and (N, 3) exp(Phi b)."""
        rest = p[self.codes + self.poses :]
        b = rest[27:].view(4, self.gains).T
        return rest[:27].view(3, 9).T, torch.exp(self.patches @ (b[:, :1] + b[:, 1:]))

    def seen(self, p: Tensor, t: Tensor) -> _Seen:
        """The surface along the pixels' rays, found from where they met it before."""
        model, q = self.prior.shape, self.pose(p)
        z_sdf = self.prior.z_sdf.code(p[: self.codes])
        pose = PoseCorrection(q[:3], q[3:])
        o, d = corrected(pose, self.pixels.origins, self.pixels.directions)
        for _ in range(3):
            f, g, _, _ = sdf_and_gradient(model, o + t[:, None] * d, z_sdf, differentiable=False)
            step = f / (g * d).sum(-1).clamp_max(-FLATTEST)
            t = (t - step.clamp(-LONGEST_MOVE, LONGEST_MOVE)).detach()
        # A code of its own for each point, so that one backward pass gives each point's derivative.
        z = z_sdf.expand(len(t), -1).clone().requires_grad_(True)
        x = (o + t[:, None] * d).requires_grad_(True)
        f, g, x_ref, gamma = sdf_and_gradient(model, x, z, differentiable=True)
        albedo = self.prior.appearance.diffuse(x_ref, gamma, self.prior.z_a.mean)
        root = albedo.clamp_min(1e-3).sqrt()
        slopes = lambda y: torch.autograd.grad(y.sum(), (z, x), retain_graph=True)  # noqa: E731
        dz = nn.functional.pad(self.prior.z_sdf.basis, (0, self.poses))
        # Where a point of a ray goes with p, if it stays at its t.
        moved = nn.functional.pad(moved_by(x.detach(), q[3:]), (self.codes, 0))[:, :, : self.codes + self.poses]
        fz, _ = slopes(f)
        g0 = g.detach()
        along = -(fz @ dz + torch.einsum("ni,nik->nk", g0, moved)) / (g0 * d).sum(-1, keepdim=True).clamp_max(-FLATTEST)
        dx = moved + d[:, :, None] * along[:, None]
        change = lambda y: torch.stack(  # noqa: E731
            [by_z @ dz + torch.einsum("ni,nik->nk", by_x, dx) for by_z, by_x in (slopes(y[:, i]) for i in range(3))], 1
        )
        dg, droot = change(g), change(root)
        length = g0.norm(dim=-1).clamp_min(1e-6)
        n = g0 / length[:, None]
        dn = (dg - n[:, :, None] * (n[:, :, None] * dg).sum(1, keepdim=True)) / length[:, None, None]
        r, dr = landmark_offsets(self.landmarks, model, z_sdf, self.prior.z_sdf.basis, pose)
        sigma = self.landmarks.sigma[:, None]
        return _Seen(t, n, root.detach(), dn, droot, r / sigma, dr / sigma[..., None])

    def error(self, p: Tensor, seen: _Seen) -> tuple[Tensor, Tensor]:
        """(N, 3) linear radiance and error, sRGB-encoded."""
        light, gain = self.light_and_gain(p)
        radiance = (gain * seen.root * (harmonics(seen.n) @ light)).clamp_min(0.0)
        return radiance, srgb_encode_beyond(radiance) - self.pixels.rgb

    def objective(self, p: Tensor, seen: _Seen) -> float:
        """Nats: robust error and the unknowns' priors."""
        squared = (self.error(p, seen)[1] / self.config.error).square()
        data = self.weight * (squared / (1.0 + squared)).mean(-1).sum()
        missed = seen.r.square().sum(-1)
        data = data + (missed / (1.0 + missed / WRONG**2)).sum()
        return float(0.5 * (data + (self.precision * p.square()).sum()))

    def first_light(self, seen: _Seen) -> Tensor:
        """(9, 3) L of the mean head by robust least squares of relative errors."""
        basis = harmonics(seen.n)
        even = 1.0 / (self.linear.mean(-1) + 0.2 * self.linear.mean())
        weight = even
        for _ in range(LIGHT_ROUNDS):
            light = []
            for k in range(3):
                # Normal equations in float64: LAPACK's least squares does not give the same bits twice.
                rows = (weight * seen.root[:, k])[:, None].double() * basis.double()
                right = rows.T @ (weight * self.linear[:, k]).double()
                square = rows.T @ rows
                # Surface that looks one way only leaves most harmonics open.
                square += 1e-6 * square.diagonal().mean() * torch.eye(9, dtype=square.dtype, device=square.device)
                light.append(torch.linalg.solve(square, right).to(weight))
            off = (seen.root * (basis @ torch.stack(light, 1)) - self.linear).abs().mean(-1) * even
            weight = even / torch.sqrt(1.0 + (off / LIGHT_ERROR).square())
        return torch.stack(light, 1)

    def normal_equations(self, p: Tensor, seen: _Seen) -> tuple[Tensor, Tensor]:
        """J^T W J of the data alone, and the objective's gradient, in float64."""
        light, gain = self.light_and_gain(p)
        radiance, error = self.error(p, seen)
        with torch.enable_grad():
            free = radiance.clone().requires_grad_(True)
            (encoded,) = torch.autograd.grad(srgb_encode_beyond(free).sum(), free)
        basis = harmonics(seen.n)
        irradiance = basis @ light
        by_normal = torch.einsum("nbi,nik,bc->nck", harmonics_slopes(seen.n), seen.dn, light)
        shape = (encoded * gain)[..., None] * (seen.droot * irradiance[..., None] + seen.root[..., None] * by_normal)
        own = torch.eye(3, dtype=basis.dtype, device=basis.device)
        by_light = torch.einsum("nc,nb,ce->nceb", encoded * gain * seen.root, basis, own).flatten(2)
        by_gain = (encoded * radiance)[..., None] * self.patches[:, None]
        by_tint = torch.einsum("nc,nq,ce->nceq", encoded * radiance, self.patches, own).flatten(2)
        jacobian = torch.cat([shape, by_light, by_gain, by_tint], -1).flatten(0, 1).double()
        scale = self.config.error
        weight = (self.weight / 3 / scale**2 / (1.0 + (error / scale).square()).square()).flatten().double()
        hessian = jacobian.T @ (weight[:, None] * jacobian)
        slope = jacobian.T @ (weight * error.flatten().double()) + (self.precision * p).double()
        if len(self.landmarks):
            shape = self.codes + self.poses
            trust = (1.0 + seen.r.square().sum(-1) / WRONG**2).double() ** -2
            hessian[:shape, :shape] += torch.einsum("l,lik,lim->km", trust, seen.dr.double(), seen.dr.double())
            slope[:shape] += torch.einsum("l,lik,li->k", trust, seen.dr.double(), seen.r.double())
        return hessian, slope

    def of_shape(self, hessian: Tensor) -> Tensor:
        """What the data say of c and q, light and patches integrated out, and the prior of q."""
        k = self.codes + self.poses
        others = hessian[k:, k:] + torch.diag(self.damping[k:].double())
        out = hessian[:k, :k] - hessian[:k, k:] @ torch.linalg.solve(others, hessian[k:, :k])
        out.diagonal()[self.codes :] += self.precision[self.codes : k].double()
        return 0.5 * (out + out.T)


def _patches(xy: Float[Tensor, "N 2"], size: float) -> Float[Tensor, "N Q"]:
    """Gaussians of this width on a square lattice, those that reach a pixel; xy where rays met the mean head."""
    low, high = xy.amin(0), xy.amax(0)
    lattice = [torch.arange(float(a), float(b) + size, size, device=xy.device) for a, b in zip(low, high, strict=True)]
    centres = torch.cartesian_prod(*lattice).to(xy)
    centres = centres[torch.cdist(centres, xy).amin(1) < size]
    return torch.exp(-0.5 * (torch.cdist(xy, centres) / size).square())
