"""Write the light beside the avatar: exact, as pictures, and as spherical harmonics.

Notation: Y_k real spherical harmonics of bands 0 to 2 as in `numerics.sg_sh`; f_k = int G Y_k dw the light's
coefficients; A_l = pi, 2 pi / 3, pi / 4 what the clamped cosine multiplies each band by (Ramamoorthi and Hanrahan 2001,
doi:10.1145/383259.383317).
"""

import json
from pathlib import Path

import numpy as np

from sira_assets.asset.exr_header import colour_header
from sira_assets.atomic import write_text
from sira_assets.scene.envmap import envmap_from_sg, write_envmap
from sira_assets.scene.exr import write_exr
from sira_assets.scene.sg_light import SGLight

MIN_HEIGHT, MAX_HEIGHT = 64, 1024


def write_lights(light: SGLight, folder: str | Path, *, height: int | None = None) -> None:
    """Write lights.json (exact), envmap.exr and .hdr (lat-long) and sh.json into `folder`, in the light's own frame.

    Parameters
    ----------
    height : rows of the environment map; default: `envmap_height(light)`
    """
    folder = Path(folder)
    write_text(folder / "lights.json", json.dumps(light.to_dict(), indent=1, allow_nan=False) + "\n")
    write_text(folder / "sh.json", json.dumps(sh_dict(light), indent=1, allow_nan=False) + "\n")
    envmap = envmap_from_sg(light, height or envmap_height(light))
    import OpenEXR

    said = colour_header("radiance from all around, estimated from one photo, not captured; scene's world, +Y up")
    write_exr(folder / "envmap.exr", envmap.radiance, header={**said, "envmap": OpenEXR.ENVMAP_LATLONG})
    write_envmap(folder / "envmap.hdr", envmap)


def sh_dict(light: SGLight) -> dict:
    """Spherical harmonics of the light, bands 0 to 2, exact for spherical gaussians; what sh.json holds.

    `radiance` are the f_k, `irradiance` the A_l f_k, (9, 3) each: the irradiance on a normal n is then the sum of
    irradiance_k Y_k(n), within 1.4 % for lobes of sharpness 5, 9.4 % for a point of light.
    """
    import torch

    from sira_assets.numerics.sg_sh import sh_from_sg

    lobes = (torch.tensor(np.array(a), dtype=torch.float64) for a in (light.axis, light.sharpness, light.amplitude))
    radiance = sh_from_sg(*lobes).numpy() if len(light) else np.zeros((9, 3))
    gain = np.repeat(np.pi * np.array([1.0, 2.0 / 3.0, 0.25]), [1, 3, 5])[:, None]
    return {
        "frame": "scene world",
        "basis": "real, orthonormal, no Condon-Shortley phase, polar axis z",
        "order": ["1", "y", "z", "x", "xy", "yz", "3z^2-1", "xz", "x^2-y^2"],
        "radiance": radiance.tolist(),
        "irradiance": (gain * radiance).tolist(),
    }


def envmap_height(light: SGLight) -> int:
    """Rows that resolve the sharpest lobe: the power of two, 64 to 1024, with at least two rows to its width.

    A lobe falls to 1/e at an angle of sqrt(2 / lambda) from its axis; rows are pi / height apart.
    """
    if not len(light):
        return MIN_HEIGHT
    wanted = np.pi * 2.0 / np.sqrt(2.0 / light.sharpness.max())
    return int(np.clip(2 ** np.ceil(np.log2(max(wanted, 1.0))), MIN_HEIGHT, MAX_HEIGHT))
