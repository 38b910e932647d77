"""A viewer scene as the numbers its page computes with: JSON, and bytes in base64.

Notation: as in numerics.sg_irradiance and numerics.sg_specular. Every fitted constant of the closed form is written
from there into the page, so that the page's shader holds none of its own: per lobe the eight numbers of
`lobe_constants`, per roughness GGX's directional albedo R = f0 scale + bias at equidistant sqrt(nv).
"""

import base64
import gzip
import json

import numpy as np

from sira_assets.asset.encoding import F0_OF_IOR_1_5, KS_RANGE
from sira_assets.numerics import sg_irradiance
from sira_assets.numerics.ggx_albedo import directional_albedo
from sira_assets.numerics.sg_irradiance import lobe_constants
from sira_assets.numerics.sg_specular import COSINE_FLOOR
from sira_assets.relight.gltf_shading import COSINE_SHARPNESS
from sira_assets.scene.sg_light import SGLight
from sira_assets.viewer.scene import ViewerScene

# As many as the table that `directional_albedo` interpolates in, so that the page's interpolation is the same.
KNOTS = 64


def form_json(scene: ViewerScene) -> str:
    """What the page's script reads; safe inside a script element."""
    camera, shadows = scene.camera, scene.shadows
    form = {
        "name": scene.name,
        "camera": {
            "intrinsics": camera.intrinsics.tolist(),
            "world_from_camera": camera.world_from_camera.tolist(),
            "width": camera.width,
            "height": camera.height,
        },
        "up": scene.up.tolist(),
        "pivot": scene.pivot.tolist(),
        "radius": scene.radius,
        "white_f0": F0_OF_IOR_1_5 * KS_RANGE,
        "white_light": scene.brightest,
        "lobes": _lobes(scene.light),
        "albedo": [_albedo(r) for r in scene.roughness],
        "mean": {
            "tau_scale": sg_irradiance.MEAN_TAU_SCALE,
            "edge": sg_irradiance.MEAN_EDGE,
            "tail": sg_irradiance.MEAN_TAIL,
            "floor": sg_irradiance.MEAN_SHARPNESS_FLOOR,
        },
        "cosine_floor": COSINE_FLOOR,
        "cosine_sharpness": COSINE_SHARPNESS,
        "shadows": None
        if shadows is None
        # Six digits: what single precision can tell apart.
        else {"directions": np.round(shadows.directions, 6).astype(float).tolist(), "sharpest": shadows.sharpest},
    }
    return json.dumps(form, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def packed_text(data: bytes) -> str:
    """Bytes as gzip in base64; the same bytes give the same text."""
    return base64.b64encode(gzip.compress(data, compresslevel=9, mtime=0)).decode()


def _lobes(light: SGLight) -> list[dict]:
    import torch

    edge, odd, root, tail = lobe_constants(torch.as_tensor(np.array(light.sharpness), dtype=torch.float64))
    columns = torch.stack([edge, odd, root, *tail], -1).tolist()
    rows = zip(light.axis.tolist(), light.sharpness.tolist(), light.amplitude.tolist(), columns, strict=True)
    return [{"axis": a, "sharpness": s, "amplitude": m, "irradiance": c} for a, s, m, c in rows]


def _albedo(roughness: float) -> dict:
    import torch

    n_dot_v = torch.linspace(0.0, 1.0, KNOTS, dtype=torch.float64) ** 2
    bias = directional_albedo(n_dot_v, torch.zeros_like(n_dot_v), roughness)
    whole = directional_albedo(n_dot_v, torch.ones_like(n_dot_v), roughness)
    return {"roughness": roughness, "scale": (whole - bias).tolist(), "bias": bias.tolist()}
