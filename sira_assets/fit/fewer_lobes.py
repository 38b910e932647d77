"""As few lobes as the seen surface can tell from all of them: lobes that lie together become one.

Notation: w = int G dw a lobe's flux; A(lambda) = coth lambda - 1 / lambda the mean cosine about its axis (its density
is von Mises-Fisher's), so w A xi is its mean vector. Radiance is linear in the lobes: each is shaded on its own.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from sira_assets.numerics.sg import sg_integral
from sira_assets.numerics.srgb import srgb_encode
from sira_assets.render.shading import shade

Lobes = tuple[Tensor, Tensor, Tensor]
# Below this lambda a lobe is so wide that its mean cosine is lambda / 3 to a millionth.
WIDE = 1.0e-3


def mean_cosine(sharpness: float) -> float:
    """A(lambda), in [0, 1)."""
    if sharpness < WIDE:
        return sharpness / 3.0
    return 1.0 / math.tanh(sharpness) - 1.0 / sharpness


def sharpness_of(cosine: float) -> float:
    """The lambda of a mean cosine in [0, 1): Banerjee et al.'s estimate (JMLR 6, 2005, eq. 4.4), then Newton steps."""
    if cosine < WIDE / 3.0:
        return 3.0 * cosine
    sharpness = cosine * (3.0 - cosine**2) / (1.0 - cosine**2)
    for _ in range(4):
        a = mean_cosine(sharpness)
        sharpness -= (a - cosine) / max(1.0 - a * a - 2.0 * a / sharpness, 1e-300)
    return sharpness


def one_lobe(lobes: Lobes) -> Lobes:
    """The lobe (1 row) with the flux and the mean vector of all the given ones together.

    Colours are added; the mean vector is weighted by the fluxes' means over the channels.
    """
    axis, sharpness, amplitude = (t.double() for t in lobes)
    flux = sg_integral(sharpness, amplitude)
    weight = flux.mean(-1) / flux.mean().clamp_min(1e-300) / len(flux)
    cosine = torch.tensor([mean_cosine(float(s)) for s in sharpness], dtype=axis.dtype, device=axis.device)
    mean = ((weight * cosine)[:, None] * axis).sum(0)
    length = float(mean.norm())
    # Opposite lobes cancel: what is left is even light, and any axis will do.
    direction = mean / length if length > 1e-12 else axis[0]
    merged = axis.new_tensor([sharpness_of(min(length, 1.0 - 1e-12))])
    unit = sg_integral(merged, torch.ones_like(flux[:1]))
    out = (direction[None], merged, flux.sum(0, keepdim=True) / unit)
    return tuple(new.to(old) for new, old in zip(out, lobes, strict=True))


@torch.no_grad()
def fewer_lobes(
    normals: Float[Tensor, "N 3"],
    view: Float[Tensor, "N 3"],
    diffuse: Float[Tensor, "N 3"],
    specular_f0: Float[Tensor, " N"] | None,
    lobes: Lobes,
    *,
    roughness: float,
    most_change: float,
) -> tuple[Lobes, Bool[Tensor, " M"], float]:
    """Merge pairs of lobes, those first that change the points' radiance least, while it changes by little.

    Parameters
    ----------
    most_change : mean change of the sRGB-encoded radiance, 0 to 1, that is still allowed

    Returns
    -------
    lobes (M rows, merged ones in the place of their first), which rows still count, the mean change
    """
    every = [tuple(t[i : i + 1] for t in lobes) for i in range(len(lobes[1]))]

    def radiance(lobe: Lobes) -> Tensor:
        return shade(normals, view, diffuse, specular_f0, *lobe, roughness=roughness).radiance

    def encoded(linear: Tensor) -> Tensor:
        return srgb_encode(linear.clamp(0.0, 1.0))

    own = [radiance(lobe) for lobe in every]
    now, change = sum(own), 0.0
    before = encoded(now)
    alive, pairs = list(range(len(every))), {}
    while len(alive) > 1:
        for i in alive:
            for j in alive:
                if i < j and (i, j) not in pairs:
                    lobe = one_lobe(tuple(torch.cat(two) for two in zip(every[i], every[j], strict=True)))
                    pairs[i, j] = lobe, radiance(lobe)
        changes = {
            (i, j): float((encoded(now + new - own[i] - own[j]) - before).abs().mean())
            for (i, j), (_, new) in pairs.items()
        }
        i, j = min(changes, key=changes.get)
        if changes[i, j] > most_change:
            break
        change = changes[i, j]
        lobe, new = pairs[i, j]
        now = now + new - own[i] - own[j]
        every[i], own[i] = lobe, new
        alive.remove(j)
        pairs = {pair: made for pair, made in pairs.items() if not {i, j} & set(pair)}
    kept = torch.zeros(len(every), dtype=torch.bool, device=normals.device)
    kept[alive] = True
    return tuple(torch.cat(column) for column in zip(*every, strict=True)), kept, change
