"""The canonical head frame: +Y up, +Z out of the face, origin midway between the eye centres, metres.

`canonical_from_world` is the least-squares similarity (Umeyama 1991, DOI 10.1109/34.88573) of a head's nine landmarks
onto `CANONICAL_LANDMARKS_M`; size is normalised by it, since one image cannot tell it.
"""

from collections.abc import Mapping

import numpy as np

from sira_assets.errors import InputError

# Nine landmarks of a population's mean head with eye centres 63 mm apart; measured on the template of ICT-FaceKit
# (MIT licence, copyright 2020 USC Institute for Creative Technologies), similarity-scaled. Subject's right is -X.
CANONICAL_LANDMARKS_M: Mapping[str, tuple[float, float, float]] = {
    "right_eye_outer": (-0.04396, -0.001811, 0.001595),
    "right_eye_inner": (-0.018177, -0.003587, 0.007439),
    "left_eye_inner": (0.018181, -0.003583, 0.007437),
    "left_eye_outer": (0.04396, -0.001811, 0.001595),
    "nose_tip": (0.0, -0.031645, 0.045626),
    "nose_base": (0.0, -0.04751, 0.030804),
    "mouth_right": (-0.024991, -0.070346, 0.017217),
    "mouth_left": (0.024991, -0.070346, 0.017217),
    "chin": (0.0, -0.110249, 0.019627),
}

# Where these nine stand among the iBUG 68 (0-based).
IBUG68_OF_CANONICAL: Mapping[str, int] = {
    "right_eye_outer": 36,
    "right_eye_inner": 39,
    "left_eye_inner": 42,
    "left_eye_outer": 45,
    "nose_tip": 30,
    "nose_base": 33,
    "mouth_right": 48,
    "mouth_left": 54,
    "chin": 8,
}


def similarity(source: np.ndarray, target: np.ndarray, *, with_scale: bool = True) -> np.ndarray:
    """Least-squares similarity (or rigid motion) that takes `source` points onto `target` points.

    Parameters
    ----------
    source, target : (N, 3) arrays, N >= 3, not all on one line
    with_scale : False gives a rigid motion.

    Returns
    -------
    (4, 4) array; its upper-left block is scale times a proper rotation (never a reflection).

    Raises
    ------
    InputError : fewer than three points, or points on one line.

    References
    ----------
    Umeyama 1991, DOI 10.1109/34.88573.
    """
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    mean_s, mean_t = source.mean(0), target.mean(0)
    s, t = source - mean_s, target - mean_t
    if len(source) < 3 or np.linalg.matrix_rank(s, tol=1e-9 * max(np.abs(s).max(initial=0.0), 1e-30)) < 2:
        raise InputError(
            expected="at least three landmarks that are not on one line",
            received=f"{len(source)} landmark(s)",
            remedy="give more of the nine canonical landmarks",
        )
    u, d, vt = np.linalg.svd(t.T @ s)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = float((d * sign).sum() / (s**2).sum()) if with_scale else 1.0
    out = np.eye(4)
    out[:3, :3] = scale * rotation
    out[:3, 3] = mean_t - scale * rotation @ mean_s
    return out


def canonical_from_landmarks(landmarks_world: Mapping[str, np.ndarray]) -> np.ndarray:
    """`canonical_from_world` (4, 4) from 3D landmarks, by whichever of the nine names are present.

    Raises
    ------
    InputError : fewer than three of the nine names.
    """
    names = [name for name in CANONICAL_LANDMARKS_M if name in landmarks_world]
    source = np.array([landmarks_world[name] for name in names], np.float64).reshape(-1, 3)
    return similarity(source, np.array([CANONICAL_LANDMARKS_M[name] for name in names]).reshape(-1, 3))


def similarity_scale(matrix: np.ndarray) -> float:
    """The scale of a similarity: canonical metres per world unit for `canonical_from_world`."""
    return float(np.cbrt(np.linalg.det(np.asarray(matrix, np.float64)[:3, :3])))


def similarity_fault(matrix: np.ndarray) -> str:
    """Why a (4, 4) matrix is no similarity without reflection, in words; "" where it is one to a thousandth.

    What is measured does not change when a rotation is put before or behind it.
    """
    matrix = np.asarray(matrix, np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return f"values that are not finite or not 4x4: {matrix.tolist()}"[:80]
    if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        return f"a last row of {matrix[3].tolist()}, not 0 0 0 1"
    if similarity_scale(matrix) <= 0:
        return f"determinant {np.linalg.det(matrix[:3, :3]):.3g}"
    stretch = np.linalg.svd(matrix[:3, :3], compute_uv=False) / similarity_scale(matrix)
    if np.abs(stretch**2 - 1.0).max() > 1e-3:
        return f"one that stretches by {stretch.min():.4g} to {stretch.max():.4g} of its scale"
    return ""


def transform_points(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Apply a (4, 4) affine map to points (..., 3)."""
    matrix = np.asarray(matrix, np.float64)
    return points @ matrix[:3, :3].T + matrix[:3, 3]
