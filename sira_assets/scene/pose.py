"""Where a head stands before a camera, from its 2D landmarks (the perspective-n-point problem).

Notation: X_l canonical landmarks (metres), u_l their pixels, K the intrinsics; sought are the rotation vector w and
the translation t of `camera_from_canonical` (OpenCV axes, metres). Size is fixed to the canonical one, as one picture
cannot tell it.

The person's shape is what is unknown: on real heads with true pixels and intrinsics, nine mean landmarks still leave
about 4 degrees and 2 % of the distance. The fit refines both.
"""

from collections.abc import Mapping

import numpy as np

from sira_assets.errors import InputError
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

MIN_LANDMARKS = 6  # 12 equations for 6 unknowns; with fewer, one wrong point goes unnoticed

# A detector's expected miss, in canonical metres: 6 mm at the chin, which detectors place worst, and at the corners of
# the mouth 4 mm of expression besides, as a photo smiles.
LANDMARK_NOISE_M: Mapping[str, float] = {
    "right_eye_outer": 0.002,
    "right_eye_inner": 0.002,
    "left_eye_inner": 0.002,
    "left_eye_outer": 0.002,
    "nose_tip": 0.002,
    "nose_base": 0.002,
    "mouth_right": 0.0045,
    "mouth_left": 0.0045,
    "chin": 0.006,
}

# What a landmark of the mean head misses by: that and, in quadrature, the spread of people (root mean square over the
# axes, 2000 identities of ICT-FaceKit brought to the canonical frame: 1.1 to 2.2 mm).
LANDMARK_SPREAD_M: Mapping[str, float] = {
    "right_eye_outer": 0.0024,
    "right_eye_inner": 0.0023,
    "left_eye_inner": 0.0023,
    "left_eye_outer": 0.0024,
    "nose_tip": 0.0029,
    "nose_base": 0.0024,
    "mouth_right": 0.0050,
    "mouth_left": 0.0050,
    "chin": 0.0063,
}

# A fit that misses by more than this many spreads (root mean square) is a wrong set of landmarks, not another face.
WORST_RMS_SPREADS = 6.0


def camera_from_canonical(pixels: Mapping[str, np.ndarray], intrinsics: np.ndarray) -> np.ndarray:
    """Rigid pose of the canonical head before the camera, by robust Levenberg-Marquardt from several starts.

    Parameters
    ----------
    pixels : canonical name to (2,) pixel position; at least six of the nine names
    intrinsics : (3, 3) array K, pixels

    Returns
    -------
    (4, 4) array, metres, OpenCV axes (+Z forward): takes canonical points into the camera's frame.

    Raises
    ------
    InputError : too few landmarks, or landmarks that no head before this camera shows (such as swapped right and left).

    References
    ----------
    Levenberg-Marquardt on the reprojection error with a soft-L1 loss; Hartley and Zisserman, Multiple View Geometry,
    2nd ed., sections 7.2 and A6.
    """
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    names = [name for name in CANONICAL_LANDMARKS_M if name in pixels]
    if len(names) < MIN_LANDMARKS:
        raise InputError(
            expected=f"at least {MIN_LANDMARKS} of the nine canonical landmarks in 2D",
            received=f"{len(names)}",
            remedy=f"add {', '.join(n for n in CANONICAL_LANDMARKS_M if n not in pixels)}",
        )
    x = np.array([CANONICAL_LANDMARKS_M[name] for name in names])
    u = np.array([pixels[name] for name in names], np.float64)
    spread = np.array([LANDMARK_SPREAD_M[name] for name in names])
    k = np.asarray(intrinsics, np.float64)
    focal = float(np.sqrt(k[0, 0] * k[1, 1]))
    rays = np.concatenate([u, np.ones((len(u), 1))], 1) @ np.linalg.inv(k).T
    extent = np.linalg.norm(u - u.mean(0), axis=1).mean() / focal
    depth = np.linalg.norm((x - x.mean(0))[:, :2], axis=1).mean() / max(extent, 1e-6)
    # Misses are counted in spreads seen from the head's rough distance: dimensionless, so no pixel scale enters.
    per_spread = (depth / spread)[:, None]

    def residuals(pose: np.ndarray) -> np.ndarray:
        x_camera = Rotation.from_rotvec(pose[:3]).apply(x) + pose[3:]
        # A floor keeps points that wander behind the camera finite; none stays there, as the miss is then huge.
        projected = x_camera[:, :2] / np.maximum(x_camera[:, 2:], 1e-3)
        return ((projected - rays[:, :2]) * per_spread).ravel()

    # Upright in the camera is y down: half a turn about x. Starts cover profiles, and heads tilted or upside down.
    centre = np.append(rays[:, :2].mean(0), 1.0) * depth
    best = None
    for roll in (0.0, 90.0, 180.0, 270.0):
        for yaw in (0.0, -50.0, 50.0):
            turn = Rotation.from_euler("zx", [roll, 180.0], degrees=True) * Rotation.from_euler("y", yaw, degrees=True)
            start = np.concatenate([turn.as_rotvec(), centre - turn.apply(x.mean(0))])
            found = least_squares(residuals, start, loss="soft_l1", f_scale=2.0, x_scale="jac", max_nfev=200)
            if best is None or found.cost < best.cost:
                best = found
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(best.x[:3]).as_matrix()
    pose[:3, 3] = best.x[3:]
    rms = float(np.sqrt(np.mean(residuals(best.x) ** 2)))
    ahead = (x @ pose[2, :3] + pose[2, 3]).min() > 0 and best.x[5] > 1e-3
    # A face seen from behind explains swapped landmarks: the canonical +Z must point at the camera.
    if not ahead or rms > WORST_RMS_SPREADS or pose[:3, 2] @ pose[:3, 3] > 0:
        raise InputError(
            expected="2D landmarks of a face that looks at the camera",
            received=f"points that miss the mean face by {rms:.1f} times its spread",
            remedy="exchange right and left: they are the subject's, not the viewer's"
            if _looks_swapped(pixels)
            else "check the landmarks' names, the picture's size and the focal length",
        )
    return pose


def _looks_swapped(pixels: Mapping[str, np.ndarray]) -> bool:
    """Whether, going from the eyes to the mouth, the points named right lie on the picture's right."""
    need = ("right_eye_outer", "left_eye_outer", "mouth_right", "mouth_left")
    if any(name not in pixels for name in need):
        return False
    right_eye, left_eye, right_mouth, left_mouth = (np.asarray(pixels[name], np.float64) for name in need)
    across = left_eye - right_eye
    down = 0.5 * (right_mouth + left_mouth) - 0.5 * (right_eye + left_eye)
    return bool(across[0] * down[1] - across[1] * down[0] < 0)
