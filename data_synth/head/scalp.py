"""Distance from the scalp: the template without its ears, which hair and hats do not follow.

Notation: ``D`` the distance in millimetres at template points in millimetres, negative inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.head.grid import evaluate_template, graded_axis
from data_synth.head.template import Primitives, Template, load_template
from data_synth.one_thread import one_thread
from sira_assets.mesh.open3d_core import open3d_core

EAR_NAMES = (
    "ear",
    "helix",
    "tragus",
    "concha",
    "cymba",
    "scapha",
    "antihelix",
    "crus",
    "antitragus",
    "intertragic",
)


def _without_ears(t: Template) -> Template:
    def drop(p: Primitives) -> Primitives:
        keep = [i for i, n in enumerate(p.name) if not n.startswith(EAR_NAMES)]
        return Primitives(
            tuple(p.name[i] for i in keep),
            p.paired[keep],
            p.centre_mm[keep],
            p.log_size[keep],
            p.rotation[keep],
            p.weight[keep],
        )

    return Template(drop(t.masses), drop(t.strokes), t.eyeball, t.lids, t.floor_mm)


def without_crumbs(field: np.ndarray, least: float = 2e-3) -> np.ndarray:
    """The field with only its largest connected inside; that of others becomes at least ``least`` (same unit)."""
    from scipy.ndimage import label

    piece, count = label(field < 0)
    if count < 2:
        return field
    size = np.bincount(piece.ravel())
    crumb = (piece > 0) & (piece != 1 + size[1:].argmax())
    return np.where(crumb, np.maximum(np.abs(field), field.dtype.type(least)), field)


@dataclass(frozen=True)
class ScalpDistance:
    """Distance from the earless head (mm) on a coarse regular grid: axes in mm and values ``d[i, j, k]``."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    d: np.ndarray


@lru_cache(maxsize=1)
@one_thread
def scalp_distance(step_mm: float = 5.0) -> ScalpDistance:
    """Computed once per process; linear interpolation of it errs by about step^2 / (8 * 70 mm) on the skull."""
    from skimage.measure import marching_cubes

    o3d = open3d_core()
    half = graded_axis((0.0, 200.0), (step_mm,))
    x = np.concatenate([-half[:0:-1], half])
    y, z = graded_axis((-235.0, 165.0), (step_mm,)), graded_axis((-235.0, 70.0), (step_mm,))
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1)
    right = len(half) - 1
    bare = _without_ears(load_template())
    f_half = evaluate_template(nodes[right:].reshape(-1, 3) * 1e-3, bare).reshape(nodes[right:].shape[:3]) * 1e3
    f = without_crumbs(np.concatenate([f_half[:0:-1], f_half]), 2.0)
    v, tri, _, _ = marching_cubes(np.where(np.abs(f) < 1e-4, 1e-4, f), 0.0)
    v = v * step_mm + [x[0], y[0], z[0]]
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(v.astype(np.float32)), o3d.core.Tensor(tri.astype(np.uint32)))
    d_half = scene.compute_distance(o3d.core.Tensor(nodes[right:].astype(np.float32))).numpy()
    d = np.concatenate([d_half[:0:-1], d_half])
    return ScalpDistance(x, y, z, (np.sign(f) * d).astype(np.float32))


def interpolate_scalp(x_mm: np.ndarray) -> np.ndarray:
    """``D`` at points (N, 3) in mm."""
    from scipy.ndimage import map_coordinates

    s = scalp_distance()
    step = s.x[1] - s.x[0]
    index = [(x_mm[:, 0] - s.x[0]) / step, (x_mm[:, 1] - s.y[0]) / step, (x_mm[:, 2] - s.z[0]) / step]
    return map_coordinates(s.d, index, order=1, mode="nearest").astype(np.float64)
