"""Statistics of a face's surface beyond its landmarks, the same for a generated head and for a scan.

Notation: the face is seen from the front as heights ``z(x, y)`` on a grid in the canonical frame (millimetres): rays
along -Z, first hit. ``G_s`` is a Gaussian of spread ``s``. Relief is ``z - G_15 z`` (what is smaller than about 30 mm),
detail ``z - G_4 z``; mean curvature is ``div(grad z / sqrt(1 + |grad z|^2)) / 2`` of ``G_3 z``, in 1/m. Regions are
rectangles.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.mesh.triangle_mesh import TriangleMesh

STEP_MM = 1.0
X_MM, Y_MM = 60.0, (-112.0, 62.0)
# name: |x| from, to; y from, to (mm, canonical frame)
REGIONS = {
    "forehead": (0, 32, 34, 56),
    "orbit": (16, 48, -14, 16),
    "nose": (0, 15, -42, 0),
    "cheek": (28, 48, -60, -22),
    "mouth": (0, 28, -86, -54),
    "chin": (0, 18, -102, -90),
}
# named heights of the midline: y (mm)
PROFILE = {"glabella": 18.0, "nasion": 3.0, "bridge": -14.0, "upper lip": -62.0, "labiomental": -87.0, "chin": -102.0}


@dataclass(frozen=True)
class FaceHeights:
    """``z`` (rows along y, columns along x) in millimetres, NaN where no ray hits."""

    x_mm: np.ndarray
    y_mm: np.ndarray
    z_mm: np.ndarray


def face_heights(mesh: TriangleMesh) -> FaceHeights:
    """Heights of a mesh in the canonical frame (metres)."""
    from sira_assets.measure.surface import Surface

    x = np.arange(-X_MM, X_MM + STEP_MM / 2, STEP_MM)
    y = np.arange(*Y_MM, STEP_MM)
    origin = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), 200.0)], -1).reshape(-1, 3) * 1e-3
    t = Surface(mesh).first_hit(origin, np.broadcast_to([0.0, 0.0, -1.0], origin.shape))
    z = 200.0 - 1e3 * t
    # beyond the face's outline the ray falls past it
    return FaceHeights(x, y, np.where(np.isfinite(z) & (z > -70.0), z, np.nan).reshape(len(y), len(x)))


def blurred(z: np.ndarray, spread_mm: float) -> np.ndarray:
    """Gaussian blur that ignores NaN."""
    from scipy.ndimage import gaussian_filter

    there = np.isfinite(z)
    weight = gaussian_filter(there.astype(float), spread_mm / STEP_MM)
    out = gaussian_filter(np.where(there, z, 0.0), spread_mm / STEP_MM) / np.maximum(weight, 1e-9)
    return np.where(there, out, np.nan)


def mean_curvature(z: np.ndarray) -> np.ndarray:
    """Of heights already smooth, 1/m; positive where the surface is hollow."""
    gy, gx = np.gradient(z, STEP_MM)
    norm = np.sqrt(1.0 + gx**2 + gy**2)
    return 500.0 * (np.gradient(gx / norm, STEP_MM, axis=1) + np.gradient(gy / norm, STEP_MM, axis=0))


def statistics(heights: FaceHeights) -> dict[str, float]:
    """Figures by name: relief, detail and curvature of each region (root mean square), profile, asymmetry."""
    z = heights.z_mm
    relief, detail, curvature = z - blurred(z, 15.0), z - blurred(z, 4.0), mean_curvature(blurred(z, 3.0))
    x, y = np.meshgrid(heights.x_mm, heights.y_mm)
    out = {}
    for name, (x0, x1, y0, y1) in REGIONS.items():
        inside = (np.abs(x) >= x0) & (np.abs(x) <= x1) & (y >= y0) & (y <= y1)
        for what, field in (("relief mm", relief), ("detail mm", detail), ("curvature 1/m", curvature)):
            v = field[inside & np.isfinite(field)]
            out[f"{name} {what}"] = float(np.sqrt((v**2).mean())) if len(v) else np.nan
    middle = z[:, np.abs(heights.x_mm) < 1.5].mean(1)
    for name, at in PROFILE.items():
        out[f"profile {name} mm"] = float(np.interp(at, heights.y_mm, middle))
    cheeks = (np.abs(x) > 20) & (np.abs(x) < 50) & (y > -90) & (y < 45)
    v = (z - z[:, ::-1])[cheeks]
    out["asymmetry mm"] = float(np.sqrt(np.nanmean(v**2)) / 2)
    return out
