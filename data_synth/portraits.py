"""Pictures of procedural heads for the eye: one soft light, chosen views and close-ups, many heads on one sheet.

Notation: canonical frame, metres; azimuth turns the camera from the front (+Z) towards the subject's left (+X).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.cameras import look_at, rotation_xyz
from data_synth.head.build import SynthHead, build_head
from data_synth.head.params import HeadParams, sample_params
from data_synth.lights import Lamp, Rig
from data_synth.render import RayScene, RenderConfig, Surface, render
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.scene.camera import Camera


@dataclass(frozen=True)
class View:
    """Where a camera looks: a target (metres), azimuth and elevation (degrees), width of what it sees (metres)."""

    target_m: tuple[float, float, float]
    azimuth_deg: float
    elevation_deg: float
    width_m: float


HEAD = (0.0, -0.035, -0.04)
VIEWS = {
    "front": View(HEAD, 0.0, 0.0, 0.36),
    "three_quarter": View(HEAD, 38.0, 4.0, 0.36),
    "side": View((0.0, -0.035, -0.07), 90.0, 0.0, 0.38),
    "back": View((0.0, -0.035, -0.07), 180.0, 0.0, 0.38),
    "above": View((0.0, 0.02, -0.05), 15.0, 50.0, 0.34),
    "eyes": View((0.0, 0.002, 0.0), 0.0, 0.0, 0.13),
    "mouth": View((0.0, -0.065, 0.02), 0.0, -4.0, 0.09),
    "hairline": View((0.02, 0.06, 0.0), 25.0, 12.0, 0.2),
    "ear": View((0.08, -0.03, -0.07), 75.0, 0.0, 0.13),
    "chin": View((0.0, -0.095, 0.0), 25.0, -12.0, 0.17),
    "collar": View((0.0, -0.15, -0.04), 20.0, 8.0, 0.3),
}

# a window-like key, a broad fill, light from behind and the sky
PORTRAIT_RIG = Rig(
    "portrait",
    (
        Lamp(35.0, 30.0, 10.0, 1.0, np.array([1.06, 0.99, 0.91])),
        Lamp(-45.0, 5.0, 3.0, 0.45, np.array([0.95, 1.0, 1.06])),
        Lamp(-150.0, 35.0, 20.0, 0.5, np.ones(3)),
        Lamp(0.0, 80.0, 1.0, 0.35, np.ones(3)),
    ),
)
FOCUS_M = 1.1  # a portrait's distance
BACKGROUND = 0.035  # linear grey


def camera_of(view: View, size: int) -> Camera:
    """A square camera of ``size`` pixels that sees ``view.width_m`` at its target."""
    target = np.array(view.target_m)
    direction = rotation_xyz(-view.elevation_deg, view.azimuth_deg, 0.0) @ np.array([0.0, 0.0, 1.0])
    pose = look_at(target + FOCUS_M * direction, target, np.array([0.0, 1.0, 0.0]), 0.0)
    focal = FOCUS_M / view.width_m * size
    return Camera(np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]]), pose, size, size)


def draw_head(
    head: SynthHead, views: list[View], size: int, *, samples: int = 16, supersample: int = 4, exposure: float = 0.55
) -> list[np.ndarray]:
    """Pictures of a head, (size, size, 3) uint8 sRGB each; the light is fixed to the head."""
    surface = Surface(
        TriangleMesh(head.vertices_m, head.faces), head.template_positions_m, head.material, roughness=0.45
    )
    rays, light = RayScene(surface), PORTRAIT_RIG.light()
    out = []
    for view in views:
        rng = np.random.default_rng(0)
        shot = render(rays, camera_of(view, size), light, rng, RenderConfig(samples, supersample))
        linear = exposure * np.pi * shot.image + BACKGROUND * (1 - shot.alpha[..., None])
        out.append(np.round(255 * srgb_from_linear(np.clip(linear, 0.0, 1.0))).astype(np.uint8))
    return out


def random_params(seed: int, index: int) -> HeadParams:
    """Head ``index`` of the sheet drawn with ``seed``."""
    return sample_params(np.random.default_rng([seed, index]))


def contact_sheet(params: list[HeadParams], views: list[View], size: int, columns: int) -> np.ndarray:
    """Heads one after another, each with its views side by side; (H, W, 3) uint8."""
    tiles = [tile for p in params for tile in draw_head(build_head(p), views, size)]
    tiles += [np.zeros((size, size, 3), np.uint8)] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[k : k + columns], axis=1) for k in range(0, len(tiles), columns)]
    return np.concatenate(rows)
