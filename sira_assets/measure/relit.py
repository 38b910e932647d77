"""An exported avatar under another light, against what the scene's path tracer saw; and what the presets give.

Notation: a scene holds the truth as `relight/image.exr` under `relight/lights.json`, seen by the portrait's camera,
inside `mask.png`. Figures are PSNR inside the mask, sRGB-encoded, raw and after the one gain that linear least squares
gives: a single photo leaves the brightness of skin and of light to be divided between them.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.measure.image_metrics import score_image
from sira_assets.relight.glb_model import GlbModel
from sira_assets.relight.light_source import read_light_source
from sira_assets.relight.turntable import QUALITIES, Quality, Turn, render_turn
from sira_assets.scene.camera import Camera
from sira_assets.scene.image import read_image, read_mask
from sira_assets.scene.sg_light import SGLight
from sira_assets.scene.transforms_json import read_camera

# What presets are measured against: more samples and rays than any of them.
REFERENCE = Quality(4, 8192)


@dataclass(frozen=True)
class RelitScore:
    """One relit picture against the truth.

    Parameters
    ----------
    shadows : whether the picture has cast shadows
    psnr_db, scale_invariant_psnr_db, gain : as in the module's notation
    radiance : (H, W, 3) the picture
    """

    shadows: bool
    psnr_db: float
    scale_invariant_psnr_db: float
    gain: float
    radiance: np.ndarray


@dataclass(frozen=True)
class PresetScore:
    """A preset of the renderer against `REFERENCE`, with its time as a share of the reference's."""

    name: str
    psnr_db: float
    share_of_time: float


def measure_relit(
    model: GlbModel, scene: str | Path, quality: Quality = QUALITIES["standard"]
) -> tuple[RelitScore, ...]:
    """Relight `model` as `scene` was relit, without and with shadows.

    Raises
    ------
    InputError : the scene has no relit truth.
    """
    camera, light, truth, mask = relit_truth(scene)
    out = []
    for shadows in (False, True):
        picture = _rendered(model, camera, light, quality, shadows=shadows)
        raw = score_image(picture, truth, mask)
        free = score_image(picture, truth, mask, scale_invariant=True)
        out.append(RelitScore(shadows, raw.psnr_db, free.psnr_db, free.gain, picture))
    return tuple(out)


def measure_presets(model: GlbModel, scene: str | Path) -> tuple[PresetScore, ...]:
    """Each preset's picture of `model` under the scene's other light, with shadows, against the reference's."""
    camera, light, _, mask = relit_truth(scene)
    started = time.perf_counter()
    reference = _rendered(model, camera, light, REFERENCE, shadows=True)
    whole = time.perf_counter() - started
    out = []
    for name, quality in QUALITIES.items():
        started = time.perf_counter()
        picture = _rendered(model, camera, light, quality, shadows=True)
        share = (time.perf_counter() - started) / whole
        out.append(PresetScore(name, score_image(picture, reference, mask).psnr_db, share))
    return tuple(out)


def relit_truth(scene: str | Path) -> tuple[Camera, SGLight, np.ndarray, np.ndarray]:
    """Camera, other light, linear truth (H, W, 3) and mask (H, W) of a scene.

    Raises
    ------
    InputError : no relight/ folder, or pictures of different sizes.
    """
    scene = Path(scene)
    if not (scene / "relight" / "image.exr").is_file():
        raise InputError(
            expected=f"relight/image.exr and relight/lights.json in {scene}",
            received="no such file",
            remedy="give a scene with a relit truth",
        )
    camera = read_camera(scene / "transforms.json")
    light = read_light_source(scene / "relight" / "lights.json").light
    truth, mask = read_image(scene / "relight" / "image.exr").linear, read_mask(scene / "mask.png")
    if truth.shape[:2] != mask.shape or mask.shape != (camera.height, camera.width):
        raise InputError(
            expected=f"a truth and a mask of {camera.width}x{camera.height} pixels",
            received=f"{truth.shape[1]}x{truth.shape[0]} and {mask.shape[1]}x{mask.shape[0]}",
            remedy="render the scene again",
        )
    return camera, light, truth, mask


def _rendered(model: GlbModel, camera: Camera, light: SGLight, quality: Quality, *, shadows: bool) -> np.ndarray:
    (frame,) = render_turn(model, camera, light, Turn(), quality, shadows=shadows)
    return frame.render.radiance
