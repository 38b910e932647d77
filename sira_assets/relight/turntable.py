"""One relit picture or a turn of them: the light goes round the head, or the camera does.

Notation: angles in degrees about the asset's up axis (see `cameras`); frame i of n stands at start + 360 i / n.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.relight.cameras import orbit_centre, orbited, rotation_about, up_axis
from sira_assets.relight.glb_model import GlbModel
from sira_assets.relight.render import AssetRender, light_asset, see_asset, visibility_of
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight


@dataclass(frozen=True)
class Quality:
    """How much is spent on a picture: k x k samples a pixel, and shadow rays for every pixel, lobes sharing them."""

    supersample: int = 2
    rays: int = 512


# 42, 53 and 58 dB against 4 x 4 samples and 8192 rays, at 2, 6 and 22 % of their time (measure_relight.py --presets).
QUALITIES = {"draft": Quality(1, 128), "standard": Quality(2, 512), "high": Quality(3, 2048)}


@dataclass(frozen=True)
class Turn:
    """What moves, and where it starts.

    Parameters
    ----------
    frames : 1 for a still
    moves : "light" or "camera"
    light_degrees : the light's turn in the first frame
    """

    frames: int = 1
    moves: str = "light"
    light_degrees: float = 0.0

    def __post_init__(self):
        if self.frames < 1 or self.moves not in ("light", "camera") or not np.isfinite(self.light_degrees):
            raise InputError(
                expected="at least one frame of a moving light or camera",
                received=f"{self.frames} frames, {self.moves}, {self.light_degrees} degrees",
                remedy="correct the turn",
            )


@dataclass(frozen=True)
class Frame:
    """One rendered frame, with the camera and the light's rotation (3, 3) it was made by."""

    render: AssetRender
    camera: Camera
    light_rotation: np.ndarray


def render_turn(
    model: GlbModel,
    camera: Camera,
    light: SGLight,
    turn: Turn = Turn(),
    quality: Quality = QUALITIES["standard"],
    *,
    shadows: bool = True,
    gltf_weighting: bool = True,
    seed: int = 0,
    report: Callable[[float], None] = lambda done: None,
) -> Iterator[Frame]:
    """Render the frames one after the other; under a turning light the asset is traced once.

    Parameters
    ----------
    report : called with the frames done so far, in fractions

    Raises
    ------
    InputError : the camera sees nothing of the asset.
    """
    up, seen = up_axis(model), None
    for i in range(turn.frames):
        degrees = 360.0 * i / turn.frames
        rotation = rotation_about(up, turn.light_degrees + (degrees if turn.moves == "light" else 0.0))
        if seen is None or turn.moves == "camera":
            placed = orbited(camera, orbit_centre(model), up, degrees) if turn.moves == "camera" else camera
            seen = see_asset(model, placed, supersample=quality.supersample)
        lit = light.rotated(rotation)
        visibility = None
        if shadows:
            # Shadow rays are most of the work; shading is the last tenth.
            partly = lambda done, of, first=i: report(first + 0.9 * done / of)  # noqa: E731
            visibility = visibility_of(seen, lit, rays=quality.rays, seed=seed, report=partly)
        render = light_asset(seen, lit, visibility=visibility, gltf_weighting=gltf_weighting)
        report(i + 1)
        yield Frame(render, seen.camera, rotation)
