"""The exported file as its own proof: read back, rendered by glTF's BRDF where the portrait was taken from.

Notation: final is the neural render; every figure is a PSNR inside the portrait's mask, sRGB-encoded. A mistake of
colour space, axis, flip, unit or metallic in the file, which no figure of the field can show, shows here.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.measure.image_metrics import ImageScore, score_image
from sira_assets.relight.cameras import portrait_camera
from sira_assets.relight.glb_model import read_glb
from sira_assets.relight.light_source import own_light
from sira_assets.relight.render import AssetRender, light_asset, see_asset, visibility_of

# As many as the neural render casts: what noise they leave is then of one size on both sides.
RAYS_PER_LOBE = 64


@dataclass(frozen=True)
class ExportedView:
    """What the exported file shows from its portrait's camera under its own light.

    Parameters
    ----------
    render : at pixel centres, as the neural render is
    against_final : the file against the neural render
    against_photo : the file against the photo
    unweighted_psnr_db : against the neural render, without glTF's 1 - F on the diffuse lobe, which the model has not
    """

    render: AssetRender
    against_final: ImageScore
    against_photo: ImageScore
    unweighted_psnr_db: float


def measure_exported(
    glb: str | Path, final: np.ndarray, photo: np.ndarray, mask: np.ndarray, *, shadows: bool
) -> ExportedView:
    """Render `glb` by the camera and the light in its own extras and compare.

    Parameters
    ----------
    final, photo : (H, W, 3) linear, of the portrait's size
    mask : (H, W) bool
    shadows : as in `final`

    Raises
    ------
    InputError : no GLB, one without camera or light, or a camera that sees nothing of it.
    """
    model = read_glb(glb)
    camera, own = portrait_camera(model)
    if not own or (camera.height, camera.width) != mask.shape:
        raise InputError(
            expected="the portrait's camera in the file's extras",
            received="none" if not own else f"one of {camera.width}x{camera.height} pixels",
            remedy="export the avatar again",
        )
    light = own_light(model)

    seen = see_asset(model, camera, supersample=1)
    visibility = visibility_of(seen, light, rays=RAYS_PER_LOBE * len(light)) if shadows else None
    view = light_asset(seen, light, visibility=visibility)
    plain = light_asset(seen, light, visibility=visibility, gltf_weighting=False)
    return ExportedView(
        view,
        score_image(view.radiance, final, mask),
        score_image(view.radiance, photo, mask),
        score_image(plain.radiance, final, mask).psnr_db,
    )
