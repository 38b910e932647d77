"""Lighting rigs made of spherical gaussians, drawn by seed.

Notation: directions are in the canonical head frame until the end (+Z out of the face, +Y up, +X the subject's left);
azimuth turns from +Z towards +X, elevation rises from the horizontal plane. A lobe's *power* here is the irradiance
that it brings to a surface that faces it, amplitude times `irradiance_table(sharpness)[0]`.
"""

from dataclasses import dataclass

import numpy as np

from data_synth.render_irradiance import irradiance_per_lobe, irradiance_table
from data_synth.render_light import LUMINANCE
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.sg_light import SGLight

# Colours of light with luminance 1, by kind; roughly Planckian radiators in linear Rec. 709.
WARM, NEUTRAL, COOL = np.array([1.45, 0.92, 0.52]), np.ones(3), np.array([0.78, 1.0, 1.32])


@dataclass(frozen=True)
class Lamp:
    """One lobe before exposure: azimuth and elevation in degrees, sharpness, power, colour (3,)."""

    azimuth_deg: float
    elevation_deg: float
    sharpness: float
    power: float
    colour: np.ndarray


@dataclass(frozen=True)
class Rig:
    """A named set of lamps, in the canonical head frame."""

    name: str
    lamps: tuple[Lamp, ...]

    def light(self) -> SGLight:
        """The rig as spherical gaussians in the canonical frame, at its own arbitrary exposure."""
        axes, amplitudes = [], []
        for lamp in self.lamps:
            azimuth, elevation = np.radians(lamp.azimuth_deg), np.radians(lamp.elevation_deg)
            flat = np.cos(elevation)
            axes.append([flat * np.sin(azimuth), np.sin(elevation), flat * np.cos(azimuth)])
            colour = lamp.colour / (lamp.colour @ LUMINANCE)
            amplitudes.append(colour * lamp.power / irradiance_table(lamp.sharpness)[0])
        return SGLight(np.array(axes), np.array([lamp.sharpness for lamp in self.lamps]), np.array(amplitudes))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _white(rng: np.random.Generator) -> np.ndarray:
    """A white between tungsten and skylight."""
    t = rng.uniform(-1.0, 1.0)
    return WARM ** (-t) if t < 0 else COOL**t


def _tint(rng: np.random.Generator, colour: np.ndarray, most: float) -> np.ndarray:
    """White, tinted towards `colour` by up to `most` of its saturation."""
    return colour ** rng.uniform(0.0, most)


def _lamp(rng, azimuth, elevation, sharpness, power, colour, *, side: float = 1.0) -> Lamp:
    """Draw a lamp from (low, high) ranges; sharpness is drawn on a logarithmic scale, `side` mirrors the azimuth."""
    return Lamp(
        side * rng.uniform(*azimuth),
        rng.uniform(*elevation),
        _log_uniform(rng, *sharpness),
        rng.uniform(*power),
        colour,
    )


def _ambient(rng: np.random.Generator, low: float, high: float) -> Lamp:
    """A weak lobe so broad that it has next to no direction."""
    return _lamp(rng, (-180, 180), (0, 90), (0.05, 1.0), (low, high), _white(rng))


def _ground(rng: np.random.Generator, low: float, high: float) -> Lamp:
    """What the floor throws back."""
    return _lamp(rng, (0, 0), (-90, -80), (0.8, 2.0), (low, high), _tint(rng, WARM, 0.6))


def _studio(rng: np.random.Generator) -> tuple[Lamp, ...]:
    side = rng.choice([-1.0, 1.0])
    lamps = [
        _lamp(rng, (10, 65), (10, 50), (8, 80), (1, 1), _white(rng), side=side),
        _lamp(rng, (15, 70), (-10, 30), (2, 12), (0.15, 0.6), _white(rng), side=-side),
        _ambient(rng, 0.05, 0.25),
    ]
    if rng.random() < 0.7:
        lamps.append(_lamp(rng, (120, 170), (10, 50), (20, 120), (0.4, 1.5), _white(rng), side=-side))
    return tuple(lamps)


def _window(rng: np.random.Generator) -> tuple[Lamp, ...]:
    side = rng.choice([-1.0, 1.0])
    return (
        _lamp(rng, (25, 95), (0, 35), (2, 12), (1, 1), _tint(rng, COOL, 1.0), side=side),
        _lamp(rng, (30, 110), (-20, 20), (1, 3), (0.1, 0.35), _tint(rng, WARM, 0.8), side=-side),
        _ambient(rng, 0.05, 0.2),
    )


def _sun_and_sky(rng: np.random.Generator) -> tuple[Lamp, ...]:
    return (
        _lamp(rng, (-100, 100), (15, 70), (150, 800), (1, 1), _tint(rng, WARM, 0.7)),
        _lamp(rng, (-180, 180), (60, 90), (0.7, 1.6), (0.25, 0.8), COOL),
        _ground(rng, 0.05, 0.25),
    )


def _overcast(rng: np.random.Generator) -> tuple[Lamp, ...]:
    return (
        _lamp(rng, (-180, 180), (50, 90), (0.8, 2.5), (1, 1), _tint(rng, COOL, 0.6)),
        _lamp(rng, (-60, 60), (0, 40), (1, 4), (0.2, 0.7), _white(rng)),
        _ground(rng, 0.05, 0.2),
    )


def _coloured(rng: np.random.Generator) -> tuple[Lamp, ...]:
    lamps = [_ambient(rng, 0.1, 0.3), _lamp(rng, (-50, 50), (0, 40), (3, 20), (0.3, 0.8), NEUTRAL)]
    for side in (-1.0, 1.0):
        colour = 0.25 + 2.0 * rng.dirichlet(np.full(3, 0.8))
        lamps.append(_lamp(rng, (25, 130), (-15, 45), (5, 40), (0.4, 1.0), colour, side=side))
    return tuple(lamps)


def _harsh(rng: np.random.Generator) -> tuple[Lamp, ...]:
    lamps = [_lamp(rng, (-75, 75), (-5, 60), (80, 600), (1, 1), _white(rng)), _ambient(rng, 0.02, 0.1)]
    if rng.random() < 0.5:
        lamps.append(_lamp(rng, (-150, 150), (-10, 50), (60, 400), (0.2, 0.9), _white(rng)))
    return tuple(lamps)


def _anywhere(rng: np.random.Generator) -> tuple[Lamp, ...]:
    lamps = [_ambient(rng, 0.05, 0.3), _lamp(rng, (-60, 60), (-10, 50), (3, 60), (0.8, 0.8), _white(rng))]
    lamps += [
        _lamp(rng, (-180, 180), (-30, 80), (1.5, 100), (0.05, 0.7), _white(rng)) for _ in range(rng.integers(1, 7))
    ]
    return tuple(lamps)


# Names and how often each is drawn. Soft rigs prevail: they are what portraits are taken in.
RIGS = (
    ("studio", _studio, 0.26),
    ("window", _window, 0.16),
    ("sun and sky", _sun_and_sky, 0.12),
    ("overcast", _overcast, 0.14),
    ("coloured", _coloured, 0.08),
    ("harsh", _harsh, 0.10),
    ("anywhere", _anywhere, 0.14),
)


def sample_rig(rng: np.random.Generator) -> Rig:
    """Draw a rig: 2 to 8 lobes with sharpness 0.05 to 800, one of them weak and nearly without direction."""
    name, lamps, _ = RIGS[rng.choice(len(RIGS), p=[share for *_, share in RIGS])]
    return Rig(name, lamps(rng))


def face_luminance(mesh: TriangleMesh, diffuse: np.ndarray, light: SGLight, face: np.ndarray) -> float:
    """Mean luminance of the unshadowed diffuse radiance over the vertices marked by `face` (V,) bool.

    Parameters
    ----------
    mesh : in the light's frame
    diffuse : (V, 3) linear albedo
    """
    irradiance = irradiance_per_lobe(mesh.normals[face], light.axis, light.sharpness) @ light.amplitude
    return float(((diffuse[face] / np.pi * irradiance) @ LUMINANCE).mean())


def sample_exposure(rng: np.random.Generator, face_albedo_luminance: float) -> float:
    """The linear luminance that the face gets on average: 0.13 to 0.36 for mid skin (0.40 to 0.64 once encoded).

    Photographers, and cameras, expose dark skin darker than light skin but by less than it differs: exponent 0.4.
    """
    return float(_log_uniform(rng, 0.13, 0.36) * (np.clip(face_albedo_luminance, 0.03, 0.6) / 0.3) ** 0.4)
