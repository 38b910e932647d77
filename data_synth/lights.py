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
    return NEUTRAL + (WARM - NEUTRAL) * max(-t, 0.0) ** 1.5 + (COOL - NEUTRAL) * max(t, 0.0) ** 1.5


def _ambient(rng: np.random.Generator, low: float, high: float) -> Lamp:
    """A weak lobe so broad that it has next to no direction."""
    return Lamp(rng.uniform(-180, 180), rng.uniform(0, 90), _log_uniform(rng, 0.05, 1.0), rng.uniform(low, high), _white(rng))  # fmt: skip


def _studio(rng: np.random.Generator) -> tuple[Lamp, ...]:
    side, colour = rng.choice([-1.0, 1.0]), _white(rng)
    key = Lamp(side * rng.uniform(10, 65), rng.uniform(10, 50), _log_uniform(rng, 8, 80), 1.0, colour)
    fill = Lamp(-side * rng.uniform(15, 70), rng.uniform(-10, 30), _log_uniform(rng, 2, 12), rng.uniform(0.15, 0.6), _white(rng))  # fmt: skip
    lamps = [key, fill, _ambient(rng, 0.05, 0.25)]
    if rng.random() < 0.7:
        lamps.append(Lamp(-side * rng.uniform(120, 170), rng.uniform(10, 50), _log_uniform(rng, 20, 120), rng.uniform(0.4, 1.5), _white(rng)))  # fmt: skip
    return tuple(lamps)


def _window(rng: np.random.Generator) -> tuple[Lamp, ...]:
    side = rng.choice([-1.0, 1.0])
    window = Lamp(side * rng.uniform(25, 95), rng.uniform(0, 35), _log_uniform(rng, 2, 12), 1.0, COOL ** rng.uniform(0, 1))  # fmt: skip
    bounce = Lamp(-side * rng.uniform(30, 110), rng.uniform(-20, 20), _log_uniform(rng, 1, 3), rng.uniform(0.1, 0.35), WARM ** rng.uniform(0, 0.8))  # fmt: skip
    return window, bounce, _ambient(rng, 0.05, 0.2)


def _sun_and_sky(rng: np.random.Generator) -> tuple[Lamp, ...]:
    sun = Lamp(rng.uniform(-100, 100), rng.uniform(15, 70), _log_uniform(rng, 150, 800), 1.0, WARM ** rng.uniform(0.1, 0.7))  # fmt: skip
    sky = Lamp(rng.uniform(-180, 180), rng.uniform(60, 90), _log_uniform(rng, 0.7, 1.6), rng.uniform(0.25, 0.8), COOL)
    ground = Lamp(0.0, -90.0, _log_uniform(rng, 0.8, 2.0), rng.uniform(0.05, 0.25), WARM**0.5)
    return sun, sky, ground


def _overcast(rng: np.random.Generator) -> tuple[Lamp, ...]:
    dome = Lamp(rng.uniform(-180, 180), rng.uniform(50, 90), _log_uniform(rng, 0.8, 2.5), 1.0, COOL ** rng.uniform(0, 0.6))  # fmt: skip
    front = Lamp(rng.uniform(-60, 60), rng.uniform(0, 40), _log_uniform(rng, 1, 4), rng.uniform(0.2, 0.7), _white(rng))
    return dome, front, Lamp(0.0, -90.0, 1.2, rng.uniform(0.05, 0.2), WARM**0.3)


def _coloured(rng: np.random.Generator) -> tuple[Lamp, ...]:
    lamps = [_ambient(rng, 0.1, 0.3), Lamp(rng.uniform(-50, 50), rng.uniform(0, 40), _log_uniform(rng, 3, 20), rng.uniform(0.3, 0.8), NEUTRAL)]  # fmt: skip
    for side in (-1.0, 1.0):
        colour = 0.25 + rng.dirichlet(np.full(3, 0.8)) * 2.0
        lamps.append(Lamp(side * rng.uniform(25, 130), rng.uniform(-15, 45), _log_uniform(rng, 5, 40), rng.uniform(0.4, 1.0), colour))  # fmt: skip
    return tuple(lamps)


def _harsh(rng: np.random.Generator) -> tuple[Lamp, ...]:
    lamps = [Lamp(rng.uniform(-75, 75), rng.uniform(-5, 60), _log_uniform(rng, 80, 600), 1.0, _white(rng)), _ambient(rng, 0.02, 0.1)]  # fmt: skip
    if rng.random() < 0.5:
        lamps.append(Lamp(rng.uniform(-150, 150), rng.uniform(-10, 50), _log_uniform(rng, 60, 400), rng.uniform(0.2, 0.9), _white(rng)))  # fmt: skip
    return tuple(lamps)


def _anywhere(rng: np.random.Generator) -> tuple[Lamp, ...]:
    lamps = [_ambient(rng, 0.05, 0.3), Lamp(rng.uniform(-60, 60), rng.uniform(-10, 50), _log_uniform(rng, 3, 60), 0.8, _white(rng))]  # fmt: skip
    for _ in range(rng.integers(1, 7)):
        lamps.append(Lamp(rng.uniform(-180, 180), rng.uniform(-30, 80), _log_uniform(rng, 1.5, 100), rng.uniform(0.05, 0.7), _white(rng)))  # fmt: skip
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
    """The linear luminance that the face gets on average: 0.11 to 0.32 for mid skin (0.37 to 0.60 once encoded).

    Photographers, and cameras, expose dark skin darker than light skin but by less than it differs: exponent 0.4.
    """
    return float(_log_uniform(rng, 0.11, 0.32) * (np.clip(face_albedo_luminance, 0.03, 0.6) / 0.3) ** 0.4)
