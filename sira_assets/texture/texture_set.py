"""The maps that a bake makes.

Notation: S texels a side; row 0 is the top of the picture (v = 1), column 0 its left (u = 0); texel (r, c) has its
centre at u = (c + 0.5)/S, v = 1 - (r + 0.5)/S.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError


@dataclass(frozen=True)
class TextureSet:
    """Maps over one atlas; every texel is filled, those of no triangle with their nearest neighbour's value.

    Parameters
    ----------
    diffuse : (S, S, 3) float32 linear Rec. 709 albedo in [0, 1]
    specular_f0 : (S, S) float32 specular albedo at normal incidence (0.04 ks)
    normal_tangent : (S, S, 3) float32 unit, in the frame of `texture.tangents` (glTF's: +X along u, +Y along v)
    irradiance : (S, S, 3) float32 linear irradiance of the SG light, under the shadows that the bake was given
    coverage : (S, S) bool, texels that some triangle touches
    occlusion : (S, S) float32 in [0, 1], share of the sky that nothing of the head hides, weighted by the cosine; None
        where it was not baked
    """

    diffuse: np.ndarray
    specular_f0: np.ndarray
    normal_tangent: np.ndarray
    irradiance: np.ndarray
    coverage: np.ndarray
    occlusion: np.ndarray | None = None

    def __post_init__(self):
        size = self.coverage.shape[0]
        expected = {
            "diffuse": (size, size, 3),
            "specular_f0": (size, size),
            "normal_tangent": (size, size, 3),
            "irradiance": (size, size, 3),
            "coverage": (size, size),
            **({} if self.occlusion is None else {"occlusion": (size, size)}),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(
                    expected=f"a finite {name} map of shape {shape}",
                    received=f"shape {array.shape}, {int((~np.isfinite(array)).sum())} values not finite",
                    remedy="bake again",
                )

    @property
    def size(self) -> int:
        """Texels a side."""
        return self.coverage.shape[0]
