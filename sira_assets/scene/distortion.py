"""Lens distortion of OpenCV's model, undone by resampling.

Notation: x, y normalised image coordinates (X/Z, Y/Z), r^2 = x^2 + y^2. The lens moves (x, y) to
  x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
  y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y       (Brown 1966; OpenCV's calib3d)
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError


@dataclass(frozen=True)
class Distortion:
    """Coefficients of OpenCV's radial and tangential model; all zero is a pinhole."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def __bool__(self) -> bool:
        return any((self.k1, self.k2, self.p1, self.p2, self.k3))

    def distorted(self, pixels: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
        """Where the lens puts ideal pinhole positions: pixels (..., 2) to pixels (..., 2)."""
        homogeneous = np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], -1)
        x, y = np.moveaxis((homogeneous @ np.linalg.inv(intrinsics).T)[..., :2], -1, 0)
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        x_lens = x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x)
        y_lens = y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y
        return np.stack([x_lens, y_lens, np.ones_like(x)], -1) @ intrinsics.T[:, :2]

    def ideal(self, pixels: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
        """The inverse of `distorted`, by fixed-point iteration.

        Raises
        ------
        InputError : it does not converge to 0.01 px: the distortion folds the picture over itself.
        """
        pixels = np.asarray(pixels, np.float64)
        ideal = pixels.copy()
        # The map contracts by about 3 |k1| r^2 a step, below 1/2 for any lens worth undistorting.
        for _ in range(50):
            error = pixels - self.distorted(ideal, intrinsics)
            if not np.abs(error).max(initial=0.0) < 1e6:
                break  # it runs away; the check below refuses
            ideal = ideal + error
        if not np.abs(error).max(initial=0.0) < 0.01:
            raise InputError(
                expected="a lens distortion that can be inverted over the picture",
                received=f"k1={self.k1:g}, k2={self.k2:g}, k3={self.k3:g}, p1={self.p1:g}, p2={self.p2:g}",
                remedy="undistort the picture with the calibration tool and set the coefficients to 0",
            )
        return ideal

    def undistorted(self, picture: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
        """Resample a picture (H, W[, C]) as the ideal pinhole with the same intrinsics sees it.

        Bool pictures by the nearest pixel, others bilinearly; beyond the picture's edge its nearest pixel is repeated.

        Raises
        ------
        InputError : as `ideal`.
        """
        from scipy.ndimage import map_coordinates

        height, width = picture.shape[:2]
        border = np.array([[0, 0], [width, 0], [0, height], [width, height], [width / 2, 0], [0, height / 2]], float)
        self.ideal(border, intrinsics)  # refuses what folds over
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        lens = self.distorted(np.stack([x, y], -1), intrinsics)
        where = np.stack([lens[..., 1] - 0.5, lens[..., 0] - 0.5])  # array indices: pixel centres at integers
        planes = picture.reshape(height, width, -1)
        order = 0 if picture.dtype == bool else 1
        out = [map_coordinates(planes[..., c], where, order=order, mode="nearest") for c in range(planes.shape[2])]
        return np.stack(out, -1).reshape(picture.shape)
