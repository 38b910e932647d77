"""Write the light beside the avatar: lights.json (exact) and envmap.exr (for programs that light by pictures)."""

import json
from pathlib import Path

import numpy as np

from sira_assets.atomic import write_text
from sira_assets.scene.envmap import envmap_from_sg, write_envmap
from sira_assets.scene.sg_light import SGLight

MIN_HEIGHT, MAX_HEIGHT = 64, 1024


def write_lights(light: SGLight, folder: str | Path, *, height: int | None = None) -> None:
    """Write `lights.json` and `envmap.exr` (lat-long, float32) into `folder`, both in the light's own frame.

    Parameters
    ----------
    height : rows of the environment map; default: `envmap_height(light)`
    """
    folder = Path(folder)
    write_text(folder / "lights.json", json.dumps(light.to_dict(), indent=1, allow_nan=False) + "\n")
    write_envmap(folder / "envmap.exr", envmap_from_sg(light, height or envmap_height(light)))


def envmap_height(light: SGLight) -> int:
    """Rows that resolve the sharpest lobe: the power of two, 64 to 1024, with at least two rows to its width.

    A lobe falls to 1/e at an angle of sqrt(2 / lambda) from its axis; rows are pi / height apart.
    """
    if not len(light):
        return MIN_HEIGHT
    wanted = np.pi * 2.0 / np.sqrt(2.0 / light.sharpness.max())
    return int(np.clip(2 ** np.ceil(np.log2(max(wanted, 1.0))), MIN_HEIGHT, MAX_HEIGHT))
