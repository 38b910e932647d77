"""Rays against a signed distance: sphere tracing and the differentiable hit.

Notation: a ray o + t d with unit d; f the signed distance, negative inside; t0 the traced hit, x0 = o + t0 d. All
lengths in the units of f (network units inside the fit).
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class TraceConfig:
    """Numbers of sphere tracing.

    Parameters
    ----------
    steps : most evaluations before the bracketing search takes over
    relaxation : share of f that a step goes; below 1 because a network's gradient exceeds 1 in places
    tolerance : a hit's |f|
    samples : evenly spaced samples a ray that sphere tracing left undecided is searched with
    secant_steps : refinements of a bracketed zero
    chunk : rays traced at once
    """

    steps: int = 24
    relaxation: float = 0.9
    tolerance: float = 2.0e-4
    samples: int = 48
    secant_steps: int = 6
    chunk: int = 16384


@dataclass(frozen=True)
class Hits:
    """Of N rays: the first zero, or, for a miss, the point that came nearest.

    Parameters
    ----------
    t : (N,) ray parameter of the hit or of the nearest point
    hit : (N,) bool
    """

    t: Float[Tensor, " N"]
    hit: Bool[Tensor, " N"]


def box_interval(
    origins: Float[Tensor, "N 3"], directions: Float[Tensor, "N 3"], low: Float[Tensor, "3"], high: Float[Tensor, "3"]
) -> tuple[Float[Tensor, " N"], Float[Tensor, " N"]]:
    """Where rays enter and leave an axis-aligned box (slab method, Kay and Kajiya 1986); entry > exit is a miss."""
    inverse = 1.0 / torch.where(directions.abs() < 1e-12, torch.full_like(directions, 1e-12), directions)
    a, b = (low - origins) * inverse, (high - origins) * inverse
    return torch.minimum(a, b).amax(-1).clamp_min(0.0), torch.maximum(a, b).amin(-1)


@torch.no_grad()
def sphere_trace(
    sdf: Callable[[Float[Tensor, "N 3"]], Float[Tensor, " N"]],
    origins: Float[Tensor, "N 3"],
    directions: Float[Tensor, "N 3"],
    low: Float[Tensor, "3"],
    high: Float[Tensor, "3"],
    config: TraceConfig = TraceConfig(),
) -> Hits:
    """First zero of f along each ray inside the box.

    Steps of `relaxation` times f; a step that lands inside is bracketed and refined by the secant rule; rays that
    neither leave nor converge are sampled evenly, so that a bad gradient costs time and not the hit.
    """
    parts = [
        _trace_chunk(sdf, o, d, low, high, config)
        for o, d in zip(origins.split(config.chunk), directions.split(config.chunk), strict=True)
    ]
    return Hits(torch.cat([p.t for p in parts]), torch.cat([p.hit for p in parts]))


def _trace_chunk(sdf, origins, directions, low, high, config):
    near, far = box_interval(origins, directions, low, high)
    t, previous = near.clone(), near.clone()
    f_previous = torch.full_like(t, torch.inf)
    nearest, f_nearest = near.clone(), torch.full_like(t, torch.inf)
    hit = torch.zeros_like(t, dtype=torch.bool)
    crossed = torch.zeros_like(hit)
    f_crossed = torch.zeros_like(t)
    active = torch.nonzero(near < far)[:, 0]
    for _ in range(config.steps):
        if len(active) == 0:
            break
        f = sdf(origins[active] + t[active, None] * directions[active])
        closer = f < f_nearest[active]
        nearest[active] = torch.where(closer, t[active], nearest[active])
        f_nearest[active] = torch.minimum(f, f_nearest[active])
        inside = f < -config.tolerance
        done = f.abs() <= config.tolerance
        hit[active[done]] = True
        crossed[active[inside]] = True
        f_crossed[active[inside]] = f[inside]
        going = ~(inside | done)
        index = active[going]
        previous[index], f_previous[index] = t[index], f[going]
        t[index] = t[index] + config.relaxation * f[going].clamp_min(config.tolerance)
        active = index[t[index] < far[index]]
    undecided = active
    # A crossing found by stepping has its bracket, unless the first sample was inside (a camera in a head).
    bracketed = torch.nonzero(crossed & torch.isfinite(f_previous))[:, 0]
    hit[crossed] = True
    if len(undecided):
        grid = torch.linspace(0.0, 1.0, config.samples, dtype=t.dtype, device=t.device)
        ts = t[undecided, None] + grid * (far - t)[undecided, None]
        points = origins[undecided, None] + ts[..., None] * directions[undecided, None]
        f = sdf(points.reshape(-1, 3)).view(ts.shape)
        sign = (f[:, 1:] < 0) & (f[:, :-1] >= 0)
        found, first = sign.any(1), sign.float().argmax(1)
        rows = torch.arange(len(ts), device=t.device)
        best = f.argmin(1)
        closer = f[rows, best] < f_nearest[undecided]
        nearest[undecided] = torch.where(closer, ts[rows, best], nearest[undecided])
        chosen = undecided[found]
        previous[chosen], f_previous[chosen] = ts[rows, first][found], f[rows, first][found]
        t[chosen], f_crossed[chosen] = ts[rows, first + 1][found], f[rows, first + 1][found]
        hit[chosen] = True
        bracketed = torch.cat([bracketed, chosen])
    if len(bracketed):
        a, b = previous[bracketed], t[bracketed]
        fa, fb = f_previous[bracketed], f_crossed[bracketed]
        for _ in range(config.secant_steps):
            middle = a + (b - a) * (fa / (fa - fb).clamp_min(1e-12)).clamp(0.05, 0.95)
            f = sdf(origins[bracketed] + middle[:, None] * directions[bracketed])
            outside = f >= 0
            a, fa = torch.where(outside, middle, a), torch.where(outside, f, fa)
            b, fb = torch.where(outside, b, middle), torch.where(outside, fb, f)
        t[bracketed] = a + (b - a) * fa / (fa - fb).clamp_min(1e-12)
    return Hits(torch.where(hit, t, nearest), hit)


# A ray that grazes has grad f . d near 0 and its hit moves without bound; 0.1 is a surface seen at 84 degrees.
GRAZING = 0.1


def differentiable_hit(
    x0: Float[Tensor, "N 3"],
    directions: Float[Tensor, "N 3"],
    f: Float[Tensor, " N"],
    gradient: Float[Tensor, "N 3"],
) -> Float[Tensor, "N 3"]:
    """The hit as a function of the field's parameters (and of x0, if it depends on a pose).

    x = x0 - f(x0) / (grad f . d) d: its derivative is the implicit one (Yariv et al. 2020, IDR, eq. 3) and its value
    is one Newton step, so that hits kept from the last step of a fit stay on the surface. grad f . d is detached and
    held at most -GRAZING, where IDR's form explodes.

    Parameters
    ----------
    x0 : traced hits, seen from outside (grad f . d < 0)
    f, gradient : at x0; f carries the graph
    """
    slope = (gradient * directions).sum(-1).detach().clamp_max(-GRAZING)
    return x0 - (f / slope)[:, None] * directions
