"""The light an asset is relit by: its own, the lobes of a lights.json, or a panorama turned into lobes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sira_assets.errors import InputError
from sira_assets.relight.glb_model import GlbModel
from sira_assets.scene.envmap import EnvironmentMap, read_envmap
from sira_assets.scene.landmarks import read_json
from sira_assets.scene.sg_light import SGLight

PANORAMA_SUFFIXES = (".exr", ".hdr")


@dataclass(frozen=True)
class LightSource:
    """Lobes to shade by, and what they were made from.

    Parameters
    ----------
    light : in the asset's world
    panorama : the panorama itself, for the background, or None
    note : where the light came from, one line
    """

    light: SGLight
    panorama: EnvironmentMap | None
    note: str

    def scaled(self, gain: float) -> "LightSource":
        """The same light, `gain` >= 0 times as strong."""
        panorama = None if self.panorama is None else EnvironmentMap(self.panorama.radiance * np.float32(gain))
        return LightSource(self.light.scaled(gain), panorama, self.note)


def own_light(model: GlbModel) -> SGLight:
    """The light that was found in the asset's photo.

    Raises
    ------
    InputError : the asset carries none.
    """
    said = model.extras.get("light")
    if not isinstance(said, dict):
        raise InputError(
            expected="scene.extras.light in the avatar, as its exporter writes it",
            received="none",
            remedy="give --lights",
        )
    return SGLight.from_dict(said)


def read_light_source(path: str | Path) -> LightSource:
    """Read `lights.json` (or any .json of its form), or a lat-long panorama (.exr, .hdr), in the asset's world.

    Raises
    ------
    InputError : no such file, another form, or no light in it.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(
            expected=f"lights.json or a panorama at {path}", received="no such file", remedy="check the path"
        )
    if path.suffix.lower() in PANORAMA_SUFFIXES:
        return _panorama(path)
    if path.suffix.lower() != ".json":
        raise InputError(
            expected="lights as .json, .exr or .hdr", received=f"{path.name}", remedy="convert it to one of these"
        )
    light = SGLight.from_dict(read_json(path))
    if not len(light) or not light.amplitude.any():
        raise InputError(expected=f"at least one lobe of light in {path}", received="none", remedy="add one")
    return LightSource(light, None, f"{path.name}: {len(light)} lobes")


def _panorama(path: Path) -> LightSource:
    from sira_assets.fit.panorama import PanoramaFitConfig, fit_panorama

    panorama = read_envmap(path)
    made = fit_panorama(panorama, PanoramaFitConfig())
    if not len(made.light):
        raise InputError(expected=f"a panorama with light in it at {path}", received="a black one", remedy="check it")
    left = f"irradiance within {made.irradiance_residual:.1%}, glossy within {made.glossy_residual:.1%} (RMS)"
    return LightSource(made.light, panorama, f"{path.name}: {len(made.light)} lobes, {left}")
