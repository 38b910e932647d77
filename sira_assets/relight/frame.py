"""A rendered asset as a picture to show: background, exposure, encoding.

Notation: C radiance premultiplied by alpha a; B the background's radiance; over is C + (1 - a) B, in linear light;
exposure is in stops: values are multiplied by 2^EV before sRGB.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.numerics.colour import linear_from_srgb, srgb_from_linear
from sira_assets.relight.render import AssetRender
from sira_assets.relight.turntable import Frame
from sira_assets.scene.envmap import EnvironmentMap
from sira_assets.scene.envmap_resample import envmap_sampled

# sRGB 50 %: what a viewer shows around a picture.
GREY = float(linear_from_srgb(np.array(0.5)))


@dataclass(frozen=True)
class Backdrop:
    """What stands behind the asset.

    Parameters
    ----------
    colour : one linear value for R, G and B, in the picture's own exposure; None leaves the picture transparent
    panorama : radiance all around, in the asset's world before the light turned, in place of the colour; or None
    """

    colour: float | None = None
    panorama: EnvironmentMap | None = None


def linear_rgba(render: AssetRender) -> np.ndarray:
    """(H, W, 4) float32: premultiplied linear RGB and alpha, as OpenEXR has it."""
    return np.concatenate([render.radiance, render.alpha[..., None]], -1)


def encode_frame(frame: Frame, backdrop: Backdrop = Backdrop(), *, exposure: float = 0.0) -> np.ndarray:
    """(H, W, 3) uint8 sRGB, or (H, W, 4) with straight alpha where the backdrop is transparent.

    Parameters
    ----------
    exposure : stops
    """
    render, camera = frame.render, frame.camera
    gain, alpha = 2.0**exposure, render.alpha[..., None].astype(np.float64)
    colour = gain * render.radiance.astype(np.float64)
    if backdrop.panorama is not None:
        # The panorama turns with its light: look where the ray pointed before the turn.
        directions = camera.rays_world()[1] @ frame.light_rotation
        colour += (1.0 - alpha) * gain * envmap_sampled(backdrop.panorama, directions).reshape(colour.shape)
    elif backdrop.colour is not None:
        colour += (1.0 - alpha) * backdrop.colour
    else:
        straight = np.where(alpha > 0, colour / np.maximum(alpha, 1e-6), 0.0)
        colour = np.concatenate([np.clip(straight, 0, 1), alpha], -1)
        return np.concatenate([_code(srgb_from_linear(colour[..., :3])), _code(alpha)], -1)
    return _code(srgb_from_linear(np.clip(colour, 0.0, 1.0)))


def _code(values: np.ndarray) -> np.ndarray:
    return np.round(255.0 * values).astype(np.uint8)
