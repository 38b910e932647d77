"""The bald template as a surface: its mesh, where the population's mean landmarks lie on it, and the anchors.

Notation: lengths in metres, canonical frame. Everything is computed once per process from the shipped parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.head.grid import extract, template_grid
from data_synth.head.population import load_population
from data_synth.one_thread import one_thread
from sira_assets.mesh.open3d_core import open3d_core

ANCHOR_COUNT = 400


@dataclass(frozen=True)
class BaldSurface:
    """Bald template: vertices (V, 3), outward faces (F, 3), landmarks (68, 3) and anchors (A, 3) on the surface."""

    vertices_m: np.ndarray
    faces: np.ndarray
    landmarks_m: np.ndarray
    anchors_m: np.ndarray


def closest_on_mesh(vertices_m: np.ndarray, faces: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Closest surface points (N, 3)."""
    o3d = open3d_core()

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(vertices_m.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32)))
    found = scene.compute_closest_points(o3d.core.Tensor(points_m.astype(np.float32)))
    return found["points"].numpy().astype(np.float64)


def spread_points(points_m: np.ndarray, density: np.ndarray, count: int) -> np.ndarray:
    """Indices of ``count`` points by farthest-point selection, distances scaled by ``density`` (N,)."""
    chosen = [int(np.argmax(points_m[:, 2]))]
    left = np.full(len(points_m), np.inf)
    for _ in range(count - 1):
        d = np.linalg.norm(points_m - points_m[chosen[-1]], axis=1) * density
        left = np.minimum(left, d)
        chosen.append(int(left.argmax()))
    return np.array(chosen)


@lru_cache(maxsize=1)
@one_thread
def bald_surface() -> BaldSurface:
    """The shipped template, meshed."""
    grid = template_grid()
    v, f = extract(grid, grid.field)
    landmarks = closest_on_mesh(v, f, load_population().mean_m)
    inside_neck = v[:, 1] > -0.16
    # hollows of the ears, nostrils and lips carry no anchors: a smooth skin around them does
    near_face = np.exp(-0.5 * (np.linalg.norm(v - [0.0, -0.035, 0.02], axis=1) / 0.05) ** 2)
    candidates = np.flatnonzero(inside_neck)[::7]
    pick = spread_points(v[candidates], 1.0 + 1.6 * near_face[candidates], ANCHOR_COUNT)
    return BaldSurface(v, f, landmarks, v[candidates][pick])
