"""The maps that a bake makes.

Notation: S texels a side; row 0 is the top of the picture (v = 1), column 0 its left (u = 0); texel (r, c) has its
centre at u = (c + 0.5)/S, v = 1 - (r + 0.5)/S.
"""

from dataclasses import dataclass, fields

import numpy as np

from sira_assets.errors import InputError

# Names under which maps are asked for, and the attribute each becomes.
MAPS = ("diffuse", "specular", "normal", "occlusion", "position", "irradiance", "visibility", "radiance")
DEFAULT_MAPS = ("diffuse", "specular", "normal", "irradiance")


@dataclass(frozen=True)
class TextureSet:
    """Maps over one atlas; every texel is filled, those of no triangle with their nearest neighbour's value.

    A map that was not asked for is None.

    Parameters
    ----------
    diffuse : (S, S, 3) float32 linear Rec. 709 albedo in [0, 1]
    specular_f0 : (S, S) float32 specular albedo at normal incidence (0.04 ks)
    normal_tangent : (S, S, 3) float32 unit, in the frame of `texture.tangents` (glTF's: +X along u, +Y along v)
    irradiance : (S, S, 3) float32 linear irradiance of the SG light, under the shadows that the bake was given
    coverage : (S, S) bool, texels that some triangle touches
    occlusion : (S, S) float32, the share of a constant light's irradiance that arrives; 1 is open
    position : (S, S, 3) float32 point of the surface, the scene's world
    visibility : (S, S, M) float32, the share of each of the light's lobes that arrives
    radiance : (S, S, 3) float32 linear radiance, diffuse and specular, seen along the normal
    """

    diffuse: np.ndarray | None
    specular_f0: np.ndarray | None
    normal_tangent: np.ndarray | None
    irradiance: np.ndarray | None
    coverage: np.ndarray
    occlusion: np.ndarray | None = None
    position: np.ndarray | None = None
    visibility: np.ndarray | None = None
    radiance: np.ndarray | None = None

    def __post_init__(self):
        size = self.coverage.shape[0]
        flat = ("specular_f0", "occlusion", "coverage")
        for field in fields(self):
            array = getattr(self, field.name)
            if array is None:
                continue
            lobes = array.shape[-1] if field.name == "visibility" else 3
            shape = (size, size) if field.name in flat else (size, size, lobes)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(
                    expected=f"a finite {field.name} map of shape {shape}",
                    received=f"shape {array.shape}, {int((~np.isfinite(array)).sum())} values not finite",
                    remedy="bake again",
                )

    @property
    def size(self) -> int:
        """Texels a side."""
        return self.coverage.shape[0]


def check_maps(names: tuple[str, ...]) -> None:
    """Refuse names that are no map's.

    Raises
    ------
    InputError
    """
    wrong = [name for name in names if name not in MAPS]
    if wrong:
        raise InputError(
            expected="maps among " + ", ".join(MAPS), received=", ".join(wrong), remedy="ask for some of them"
        )


@dataclass(frozen=True)
class ConstantMap:
    """A map that says one thing everywhere, so that a factor does.

    Parameters
    ----------
    value : float64 array of the channels, () for one
    """

    value: np.ndarray


def constant_map(texels: np.ndarray, coverage: np.ndarray, *, step: float = 1.0 / 255.0) -> ConstantMap | None:
    """The middle of a map's values, if they lie within `step` of each other on the atlas; else None.

    Parameters
    ----------
    texels : (S, S) or (S, S, C), as encoded in the file (0 to 1), since that is where a step of 1/255 is one code
    coverage : (S, S) bool; all texels count where none is covered
    """
    used = texels[coverage] if coverage.any() else texels.reshape(-1, *texels.shape[2:])
    low, high = used.min(0).astype(np.float64), used.max(0).astype(np.float64)
    # Single precision rounds a range of exactly one step either way.
    return ConstantMap(0.5 * (low + high)) if (high - low <= step + 1e-6).all() else None
