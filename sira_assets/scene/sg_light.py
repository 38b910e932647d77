"""Distant light as a sum of spherical gaussians.

Notation: G(w) = sum_i mu_i exp(lambda_i (w . xi_i - 1)), with w a unit direction towards the light, xi unit axes,
lambda > 0 sharpness, mu >= 0 linear Rec. 709 radiance.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError


@dataclass(frozen=True)
class SGLight:
    """M spherical gaussians in the scene's world frame.

    Parameters
    ----------
    axis : (M, 3), normalised on construction
    sharpness : (M,), > 0
    amplitude : (M, 3), >= 0, linear radiance
    """

    axis: np.ndarray
    sharpness: np.ndarray
    amplitude: np.ndarray

    def __post_init__(self):
        axis = np.array(self.axis, np.float64).reshape(-1, 3)
        sharpness = np.array(self.sharpness, np.float64).reshape(-1)
        amplitude = np.array(self.amplitude, np.float64).reshape(-1, 3)
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        finite = all(np.isfinite(a).all() for a in (axis, sharpness, amplitude))
        same = len(axis) == len(sharpness) == len(amplitude)
        if not (same and finite) or (length <= 0).any() or (sharpness <= 0).any() or (amplitude < 0).any():
            raise InputError(
                expected="as many axes, sharpnesses > 0 and amplitudes >= 0 as lobes, all finite",
                received=f"axis {axis.shape}, sharpness {sharpness.tolist()[:4]}, amplitude {amplitude.tolist()[:4]}",
                remedy="check lights.json",
            )
        axis = axis / length
        for name, array in (("axis", axis), ("sharpness", sharpness), ("amplitude", amplitude)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.sharpness)

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """Radiance (..., 3) arriving from unit directions (..., 3)."""
        return np.exp(self.sharpness * (directions @ self.axis.T - 1.0)) @ self.amplitude

    def rotated(self, rotation: np.ndarray) -> "SGLight":
        """The light with its axes turned by a (3, 3) rotation."""
        return SGLight(self.axis @ np.asarray(rotation, np.float64).T, self.sharpness, self.amplitude)

    def scaled(self, gain: float) -> "SGLight":
        """The light with its radiance multiplied by `gain` >= 0."""
        return SGLight(self.axis, self.sharpness, self.amplitude * gain)

    def to_dict(self) -> dict:
        """The form of `lights.json`: {"sgs": [{"axis", "sharpness", "amplitude"}]}."""
        rows = zip(self.axis.tolist(), self.sharpness.tolist(), self.amplitude.tolist(), strict=True)
        return {"sgs": [{"axis": a, "sharpness": s, "amplitude": m} for a, s, m in rows]}

    @staticmethod
    def from_dict(data: dict | list) -> "SGLight":
        """Read the form of `lights.json`, or a bare list of lobes.

        Raises
        ------
        InputError : the form is another.
        """
        try:
            rows = data["sgs"] if isinstance(data, dict) else data
            amplitude = [np.broadcast_to(np.asarray(row["amplitude"], np.float64), 3) for row in rows]
            return SGLight(
                np.array([row["axis"] for row in rows], np.float64).reshape(-1, 3),
                np.array([row["sharpness"] for row in rows], np.float64),
                np.array(amplitude).reshape(-1, 3),
            )
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(
                expected='{"sgs": [{"axis", "sharpness", "amplitude"}]}',
                received=f"{type(error).__name__}: {error}",
                remedy="write the lights in that form",
            ) from None
