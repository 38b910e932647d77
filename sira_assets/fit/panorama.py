"""A panorama as few spherical gaussians: as many as the residual asked for needs.

Notation: E(n) irradiance of a surface with normal n; R(w) radiance blurred by a normalised gaussian of `blur_degrees`
standard deviation per axis, which is what a rough surface reflects; residual = lobes - panorama, over all channels.
Irradiance residual: RMS over the sphere of normals / mean of E. Glossy residual: RMS over the sphere of
(R_lobes - R) / (R_grey + mean R), so relative where it is bright and to the mean where it is dark.
"""

from dataclasses import dataclass

import numpy as np
import torch

from sira_assets.errors import InputError
from sira_assets.fit.lobe_descent import Lobes, Rows, descended, kernel, solved
from sira_assets.fit.panorama_cells import Cells, cells_blurred, cells_irradiance, fibonacci_sphere, panorama_cells
from sira_assets.fit.panorama_sources import bright_sources
from sira_assets.numerics.sg import irradiance
from sira_assets.scene.envmap import EnvironmentMap
from sira_assets.scene.sg_light import SGLight

# Normals: E is smooth (its SH fall like l^-2.5), so this many give its RMS to better than 1 %.
NORMALS = 512
# Directions of blurred radiance per unit of the blur's sharpness: 0.9 standard deviations apart.
DIRECTIONS_PER_SHARPNESS = 16
# Share of the glossy rows in the cost: at the default residuals both then weigh much the same.
GLOSSY_WEIGHT = 0.3
# Candidates for a new lobe, beside the bright sources: these sharpnesses on so many even axes, and a constant. Sharper
# ones fit a blurred map as well, but as spots.
CANDIDATE_AXES, CANDIDATE_SHARPNESS, CONSTANT = 512, (0.5, 2.0, 8.0, 32.0), 1e-3
# Candidates whose gain is within this share of the best are alike to the rows.
ALIKE = 0.98
# Steps of the descent after each growth; most rounds stop earlier, at a gain below 1 %.
STEPS, GAIN = 15, 1e-2
LAST_STEPS, LAST_GAIN = 60, 1e-4


@dataclass(frozen=True)
class PanoramaFitConfig:
    """How well, or with how many lobes.

    Parameters
    ----------
    residual : irradiance residual asked for, > 0
    glossy_residual : glossy residual asked for, > 0; inf to ask for irradiance alone
    lobes : this many lobes at most, whatever the residual, or None
    max_lobes : where the search ends if the residuals are not reached
    blur_degrees : 4 to 60; 10 is narrower than what roughness 0.35 reflects head-on (sharpness 1 / (2 r^4))
    """

    residual: float = 0.02
    glossy_residual: float = 0.05
    lobes: int | None = None
    max_lobes: int = 128
    blur_degrees: float = 10.0

    def __post_init__(self):
        most = self.max_lobes if self.lobes is None else self.lobes
        if not (self.residual > 0 and self.glossy_residual > 0 and most >= 1 and 4 <= self.blur_degrees <= 60):
            raise InputError(
                expected="residuals > 0, at least 1 lobe and a blur of 4 to 60 degrees",
                received=f"{self}",
                remedy="use residual 0.02, glossy residual 0.05, blur 10",
            )


@dataclass(frozen=True)
class PanoramaFit:
    """Lobes and what they leave, measured at normals and directions other than those of the fit.

    Parameters
    ----------
    light : the lobes, in the map's frame; their energy is the map's, by channel, to rounding
    irradiance_residual : RMS / mean, as the module's notation has it
    irradiance_residual_of_peak : RMS / largest E
    irradiance_worst_of_peak : largest residual / largest E
    glossy_residual : as the module's notation has it
    reached : whether both residuals asked for hold (always True where `lobes` was given)
    trail : (lobes, irradiance residual, glossy residual) after each growth
    """

    light: SGLight
    irradiance_residual: float
    irradiance_residual_of_peak: float
    irradiance_worst_of_peak: float
    glossy_residual: float
    reached: bool
    trail: tuple[tuple[int, float, float], ...]


def _rows(cells: Cells, spin: int, blur: float) -> Rows:
    """Weighted rows on spirals about one of the three axes, so that a fit is judged elsewhere than it was made."""
    normals = np.roll(fibonacci_sphere(NORMALS), spin, 1)
    directions = np.roll(fibonacci_sphere(max(NORMALS, int(DIRECTIONS_PER_SHARPNESS * blur))), spin, 1)
    received, radiance = cells_irradiance(cells, normals), cells_blurred(cells, directions, blur)
    glossy = radiance.mean(-1) + radiance.mean()
    weight = np.concatenate(
        [
            np.full(NORMALS, 1.0 / received.mean() / np.sqrt(received.size)),
            GLOSSY_WEIGHT / glossy / np.sqrt(radiance.size),
        ]
    )
    both = np.concatenate([normals, directions])
    return Rows(np.ascontiguousarray(both), np.concatenate([received, radiance]), weight, NORMALS, blur)


def _residuals(rows: Rows, lobes: Lobes) -> tuple[float, float]:
    left = _left(rows, lobes)
    split = rows.irradiances
    return float(np.sqrt((left[:split] ** 2).sum())), float(np.sqrt((left[split:] ** 2).sum())) / GLOSSY_WEIGHT


def _left(rows: Rows, lobes: Lobes) -> np.ndarray:
    """(n, 3) weighted rows that the lobes leave."""
    target = rows.target * rows.weight[:, None]
    if not len(lobes):
        return target
    return target - kernel(rows, lobes.axis, np.exp(lobes.log_sharpness)) @ lobes.amplitude


def fit_panorama(envmap: EnvironmentMap, config: PanoramaFitConfig = PanoramaFitConfig()) -> PanoramaFit:
    """Fit spherical gaussians to a panorama of any size.

    Lobes are added where they lower the cost most (candidates: bright sources with their own flux and spread, and
    even lobes of several widths), each time followed by a descent of all axes and sharpnesses, amplitudes >= 0 at
    their best; in the end lobes that are not needed are taken away. A black panorama has no lobes. Radiance below 0
    counts as 0. The same map gives the same bytes on one machine with the same number of threads.

    Returns
    -------
    PanoramaFit
    """
    cells = panorama_cells(envmap)
    if not len(cells.flux):
        empty = SGLight(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
        return PanoramaFit(empty, 0.0, 0.0, 0.0, 0.0, True, ())
    # Everything below is linear in the radiance: unit mean keeps thresholds and rounding away from the extremes.
    gain = cells.flux.mean() * len(cells.flux)
    cells = Cells(cells.flux / gain, cells.moment / gain, cells.centre, cells.place, cells.grid)
    blur = 1.0 / np.radians(config.blur_degrees) ** 2
    rows, check = _rows(cells, 0, blur), _rows(cells, 1, blur)

    def enough(lobes: Lobes) -> bool:
        irradiance_residual, glossy = _residuals(check, _with_energy(lobes, cells))
        return irradiance_residual <= config.residual and glossy <= config.glossy_residual

    lobes, trail = _grown(rows, cells, config, enough)
    if config.lobes is None and enough(lobes):
        lobes = _thinned(rows, lobes, enough)
    last = descended(rows, lobes, steps=LAST_STEPS, gain=LAST_GAIN)
    lobes = _with_energy(last if enough(last) or not enough(lobes) else lobes, cells)
    light = SGLight(lobes.axis, np.exp(lobes.log_sharpness), lobes.amplitude * gain)
    found, glossy = _residuals(check, lobes)
    left, received = _left(check, lobes)[:NORMALS] / check.weight[:NORMALS, None], check.target[:NORMALS]
    return PanoramaFit(
        light=light,
        irradiance_residual=found,
        irradiance_residual_of_peak=float(np.sqrt((left**2).mean()) / received.max()),
        irradiance_worst_of_peak=float(np.abs(left).max() / received.max()),
        glossy_residual=glossy,
        reached=config.lobes is not None or enough(lobes),
        trail=trail,
    )


def _grown(rows: Rows, cells: Cells, config: PanoramaFitConfig, enough) -> tuple[Lobes, tuple]:
    """Lobes added until `enough`, or until there are as many as allowed."""
    axes, sharpness = bright_sources(cells)
    even = fibonacci_sphere(CANDIDATE_AXES)
    axes = np.concatenate([axes, np.array([[0.0, 1.0, 0.0]]), *[even] * len(CANDIDATE_SHARPNESS)])
    sharpness = np.concatenate([sharpness, [CONSTANT], np.repeat(CANDIDATE_SHARPNESS, CANDIDATE_AXES)])
    candidates = kernel(rows, axes, sharpness)
    norm = (candidates**2).sum(0)
    lobes, trail = Lobes(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0)), []
    most = config.max_lobes if config.lobes is None else config.lobes
    stop = enough if config.lobes is None else None
    stuck = 0
    while len(lobes) < most and stuck < 3:
        before = len(lobes)
        for _ in range(min(1 + before // 8, most - before)):
            # What one new amplitude >= 0 by channel would take off the cost, the others held.
            fall = (np.maximum(candidates.T @ _left(rows, lobes), 0.0) ** 2).sum(-1) / norm
            # Sources come first, the brightest at their head: of sharp lobes that serve alike it is the likeliest.
            best = [int(np.argmax(fall >= ALIKE * fall.max()))]
            lobes, _ = solved(rows, lobes.joined(axes[best], sharpness[best]))
        lobes = descended(rows, lobes, steps=STEPS, gain=GAIN, enough=stop)
        trail.append((len(lobes), *_residuals(rows, lobes)))
        stuck = stuck + 1 if len(lobes) <= before else 0  # new lobes came out dark: nothing is left to explain
        if stop is not None and stop(lobes):
            break
    return lobes, tuple(trail)


def _thinned(rows: Rows, lobes: Lobes, enough) -> Lobes:
    """The lobes without those that the others can make up for."""
    while len(lobes) > 1:
        others = [np.arange(len(lobes)) != k for k in range(len(lobes))]
        costs = [solved(rows, lobes.take(keep))[1] for keep in others]
        fewer = descended(rows, lobes.take(others[int(np.argmin(costs))]), steps=STEPS, gain=GAIN, enough=enough)
        if not enough(fewer):
            return lobes
        lobes = fewer
    return lobes


def _with_energy(lobes: Lobes, cells: Cells) -> Lobes:
    """The lobes with each channel's amplitudes scaled so that their energy is the panorama's."""
    sharpness = np.exp(lobes.log_sharpness)
    energy = (-2.0 * np.pi * np.expm1(-2.0 * sharpness) / sharpness) @ lobes.amplitude
    gain = np.divide(cells.flux.sum(0), energy, out=np.zeros(3), where=energy > 0)
    return Lobes(lobes.axis, lobes.log_sharpness, lobes.amplitude * gain, lobes.start)


def irradiance_residual_on(envmap: EnvironmentMap, light: SGLight, normals: np.ndarray) -> tuple[float, float]:
    """RMS over unit normals (n, 3) of the lobes' irradiance less the panorama's, over its mean and over its largest.

    The panorama's is quadrature over the map; 0 and 0 for a black one.
    """
    exact = cells_irradiance(panorama_cells(envmap), normals)
    lobes = (torch.from_numpy(a.copy()) for a in (light.axis, light.sharpness, light.amplitude))
    ours = irradiance(torch.from_numpy(np.ascontiguousarray(normals, np.float64)), *lobes).numpy()
    rms = float(np.sqrt(((ours - exact) ** 2).mean()))
    return (rms / exact.mean(), rms / exact.max()) if exact.max() > 0 else (rms, rms)
