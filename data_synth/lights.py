"""Light on a portrait as spherical gaussians, before and after the camera's choices: white balance and exposure.

Notation: directions are in the canonical head frame until the end (+Z out of the face, +Y up, +X the subject's left);
azimuth turns from +Z towards +X, elevation rises from the horizontal plane. A lobe's *power* here is the irradiance
that it brings to a surface that faces it, amplitude times `irradiance_table(sharpness)[0]`.
"""

from dataclasses import dataclass, replace

import numpy as np

from data_synth.light_colour import balanced
from data_synth.render_irradiance import irradiance_table
from data_synth.render_source import LUMINANCE, LightSource, SGSource
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.sg_light import SGLight


@dataclass(frozen=True)
class Lamp:
    """One lobe before exposure: azimuth and elevation in degrees, sharpness, power, colour (3,).

    `gel`: its colour is meant, so that a camera does not take it for white.
    """

    azimuth_deg: float
    elevation_deg: float
    sharpness: float
    power: float
    colour: np.ndarray
    gel: bool = False

    @property
    def axis(self) -> np.ndarray:
        """(3,) unit, canonical frame."""
        azimuth, elevation = np.radians(self.azimuth_deg), np.radians(self.elevation_deg)
        flat = np.cos(elevation)
        return np.array([flat * np.sin(azimuth), np.sin(elevation), flat * np.cos(azimuth)])


@dataclass(frozen=True)
class Rig:
    """A named set of lamps, in the canonical head frame."""

    name: str
    lamps: tuple[Lamp, ...]

    def light(self) -> SGLight:
        """The rig as spherical gaussians in the canonical frame, at its own arbitrary exposure."""
        amplitudes = [
            lamp.colour / (lamp.colour @ LUMINANCE) * (lamp.power / irradiance_table(lamp.sharpness)[0])
            for lamp in self.lamps
        ]
        sharpness = np.array([lamp.sharpness for lamp in self.lamps])
        return SGLight(np.array([lamp.axis for lamp in self.lamps]), sharpness, np.array(amplitudes))

    def white(self) -> np.ndarray:
        """(3,) the colour of what falls on the face, gels aside: luminance 1."""
        # A lamp behind the head still tints what a camera sees of the room, by a quarter.
        weights = [0.0 if lamp.gel else lamp.power * (0.25 + max(lamp.axis[2], 0.0)) for lamp in self.lamps]
        if not any(weights):
            return np.ones(3)
        colours = np.array([lamp.colour / (lamp.colour @ LUMINANCE) for lamp in self.lamps])
        return np.average(colours, axis=0, weights=weights)

    def white_balanced(self, adaptation: float) -> "Rig":
        """The rig as a camera records it; see `light_colour.balanced`."""
        white = self.white()
        return replace(
            self, lamps=tuple(replace(lamp, colour=balanced(lamp.colour, white, adaptation)) for lamp in self.lamps)
        )


def face_luminance(mesh: TriangleMesh, diffuse: np.ndarray, light: SGLight | LightSource, face: np.ndarray) -> float:
    """Mean luminance of the unshadowed diffuse radiance over the vertices marked by `face` (V,) bool.

    Parameters
    ----------
    mesh : in the light's frame
    diffuse : (V, 3) linear albedo
    """
    source = SGSource(light) if isinstance(light, SGLight) else light
    irradiance = source.irradiance(mesh.normals[face]) @ source.colour
    return float(((diffuse[face] / np.pi * irradiance) @ LUMINANCE).mean())


def sample_white_balance(rng: np.random.Generator) -> float:
    """How far a camera's white balance goes: most of the way, seldom all of it, sometimes not at all (fixed gains)."""
    if rng.random() < 0.1:
        return 0.0
    return float(np.clip(rng.normal(0.85, 0.12), 0.4, 1.0))


def sample_exposure(rng: np.random.Generator, face_albedo_luminance: float) -> float:
    """The linear luminance that the face gets on average.

    0.13 to 0.36 for mid skin (0.40 to 0.64 once encoded); one picture in six is up to a stop darker or 0.4 of a stop
    brighter than that. Photographers, and cameras, expose dark skin darker than light skin but by less than it
    differs: exponent 0.4.
    """
    level = np.exp(rng.uniform(np.log(0.13), np.log(0.36)))
    off = rng.random()
    if off < 0.10:
        level = 0.13 * 2.0 ** -rng.uniform(0.0, 1.0)
    elif off > 0.94:
        level = 0.36 * 2.0 ** rng.uniform(0.0, 0.4)
    return float(level * (np.clip(face_albedo_luminance, 0.03, 0.6) / 0.3) ** 0.4)
