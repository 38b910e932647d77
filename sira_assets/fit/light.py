"""Light as free parameters of a fit.

Notation: lobes in log space, so that sharpness and amplitude stay positive with a gradient everywhere; canonical frame;
E the mean irradiance, without shadows, on normals within 60 degrees of the face's.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sira_assets.fields.af_sm import fibonacci_sphere
from sira_assets.fields.prior import Prior
from sira_assets.numerics.sg import irradiance, sg_integral

# ln E_R / E_G and ln E_B / E_G that cameras leave: of 200 white-balanced portraits by the generator half lie within
# 0.034 and 0.045 of 0, with tails to 0.3, so that a lamp's own colour is doubted, not forbidden.
TINT_RED, TINT_BLUE = 0.05, 0.08


class FreeLight:
    """Spherical gaussians to be optimised, started at the prior's mean light.

    Parameters
    ----------
    lobes : keep so many of that light's lobes, those of the greatest flux; all if None
    """

    def __init__(self, prior: Prior, *, lobes: int | None = None):
        with torch.no_grad():
            axis, sharpness, amplitude = (t[0] for t in prior.appearance.lobes(prior.z_l.mean[None]))
            if lobes is not None and lobes < len(sharpness):
                flux = sg_integral(sharpness, amplitude).mean(-1)
                kept = flux.topk(max(lobes, 1)).indices.sort().values
                axis, sharpness, amplitude = axis[kept], sharpness[kept], amplitude[kept]
        self.axis = nn.Parameter(axis.clone())
        self.log_sharpness = nn.Parameter(sharpness.log())
        self.log_amplitude = nn.Parameter(amplitude.clamp_min(1e-4).log())
        self.start = self.log_sharpness.detach().clone()
        # Lobes that were merged into others no longer count; their parameters stay, so that shapes do.
        self.kept = torch.ones_like(self.start, dtype=torch.bool)

    def parameters(self) -> list[nn.Parameter]:
        """What an optimiser moves."""
        return [self.axis, self.log_sharpness, self.log_amplitude]

    def lobes(
        self, brighter: Float[Tensor, "3"] | float = 0.0
    ) -> tuple[Float[Tensor, "M 3"], Float[Tensor, " M"], Float[Tensor, "M 3"]]:
        """Of the lobes that count: axis, sharpness in (0.02, 3000) and amplitude in (6e-6, 22000).

        Parameters
        ----------
        brighter : log of what every amplitude is multiplied by
        """
        axis = nn.functional.normalize(self.axis, dim=-1)
        amplitude = (self.log_amplitude + brighter).clamp(-12.0, 10.0).exp()
        lobes = axis, self.log_sharpness.clamp(-4.0, 8.0).exp(), amplitude
        return tuple(t[self.kept] for t in lobes)

    def energy(self) -> Float[Tensor, ""]:
        """How far the sharpnesses went from where they began, and how coloured the lobes are."""
        chroma = (self.log_amplitude - self.log_amplitude.mean(-1, keepdim=True))[self.kept]
        return (self.log_sharpness - self.start)[self.kept].square().sum() + 4.0 * chroma.square().sum()

    def tint(self, brighter: Float[Tensor, "3"] | float = 0.0) -> Float[Tensor, ""]:
        """How far the light that meets the face is from grey: sum of ln(1 + t^2), t the two log ratios over their
        scales (Student's t of one degree).

        One photo does not tell a pale face under a bluish light from a darker one under a grey light; cameras balance
        to grey, and skin's colour goes with its lightness.
        """
        every_way = fibonacci_sphere(192).to(self.axis)
        met = irradiance(every_way[every_way[:, 2] > 0.5], *self.lobes(brighter)).mean(0)
        red, green, blue = met.clamp_min(1e-6).log()
        return torch.log1p(((red - green) / TINT_RED).square()) + torch.log1p(((blue - green) / TINT_BLUE).square())

    @torch.no_grad()
    def put(self, lobes: tuple[Tensor, Tensor, Tensor], kept: Tensor) -> None:
        """Go on from these lobes, a row for each that counts now, of which `kept` still count."""
        rows = self.kept.clone()
        for parameter, new in zip(self.parameters(), (lobes[0], lobes[1].log(), lobes[2].log()), strict=True):
            parameter[rows] = new
        self.start[rows] = self.log_sharpness[rows]
        self.kept[rows] = kept

    def state(self) -> dict[str, Tensor]:
        """All that a fit's steps change."""
        names = ("axis", "log_sharpness", "log_amplitude")
        return {name: getattr(self, name) for name in names} | {"light_start": self.start, "light_kept": self.kept}

    @torch.no_grad()
    def brighten(self, brighter: Float[Tensor, "3"] | float) -> None:
        """Multiply the radiance by the exponential of `brighter`."""
        self.log_amplitude += brighter
