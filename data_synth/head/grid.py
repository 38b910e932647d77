"""A rectilinear grid around the head, and the template's field on it.

Notation: node ``(i, j, k)`` lies at ``(x[i], y[j], z[k])`` in metres; spacing is finest on the face. The field is
evaluated exactly in a band around the surface and by interpolation of a coarse grid elsewhere, where only its sign
and size matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from data_synth.head.template import Template, load_template, strokes_near, template_field
from data_synth.one_thread import one_thread


@dataclass(frozen=True)
class HeadGrid:
    """Grid axes (metres) and the template's field (metres) at the nodes, ``field[i, j, k]``."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    field: np.ndarray


def graded_axis(stops: tuple[float, ...], steps: tuple[float, ...]) -> np.ndarray:
    """Ascending nodes with spacing near ``steps[i]`` between ``stops[i]`` and ``stops[i + 1]`` (same unit)."""
    parts = [
        np.linspace(a, b, max(int(np.ceil((b - a) / s)), 1), endpoint=False)
        for a, b, s in zip(stops[:-1], stops[1:], steps, strict=True)
    ]
    return np.concatenate([*parts, [stops[-1]]])


def evaluate_template(x_m: np.ndarray, template: Template | None = None, chunk: int = 16_384) -> np.ndarray:
    """The template's field in metres at points (N, 3) in metres; (N,) float64, negative inside."""
    t = load_template() if template is None else template
    out = np.empty(len(x_m))
    with torch.no_grad():
        for a in range(0, len(x_m), chunk):
            x_mm = torch.tensor(np.asarray(x_m[a : a + chunk]) * 1e3, dtype=t.eyeball.dtype)
            out[a : a + chunk] = template_field(t, x_mm).double().numpy() * 1e-3
    return out


def evaluate_in_cells(template: Template, x_mm: np.ndarray, cell_mm: float = 22.0) -> np.ndarray:
    """The field in millimetres at many points in millimetres, cell by cell with the strokes that reach each cell."""
    key = np.floor(x_mm / cell_mm).astype(np.int64) + 64
    code = (key[:, 0] * 128 + key[:, 1]) * 128 + key[:, 2]
    order = np.argsort(code, kind="stable")
    starts = np.flatnonzero(np.diff(code[order], prepend=-1))
    out = np.empty(len(x_mm), np.float32)
    x = torch.tensor(x_mm, dtype=template.eyeball.dtype)
    with torch.no_grad():
        for a, b in zip(starts, [*starts[1:], len(order)], strict=True):
            own = torch.from_numpy(order[a:b])
            low, high = x[own].min(0).values, x[own].max(0).values
            near = strokes_near(template, (low + high) / 2, float((high - low).norm()) / 2)
            out[order[a:b]] = template_field(near, x[own]).numpy()
    return out


def refine_axis_values(coarse: np.ndarray, axes: tuple[np.ndarray, ...], fine: tuple[np.ndarray, ...]) -> np.ndarray:
    """Separable linear interpolation of ``coarse`` (on ``axes``) at the product of ``fine`` axes."""
    out = coarse
    for k, (a, b) in enumerate(zip(axes, fine, strict=True)):
        i = np.clip(np.searchsorted(a, b, side="right") - 1, 0, len(a) - 2)
        w = ((b - a[i]) / (a[i + 1] - a[i])).astype(np.float32)
        shape = [1, 1, 1]
        shape[k] = len(b)
        w = w.reshape(shape)
        out = np.take(out, i, axis=k) * (1 - w) + np.take(out, i + 1, axis=k) * w
    return out


def sample_grid(template: Template, fine_mm: float = 1.3, coarse_mm: float = 2.6, band_mm: float = 5.0) -> HeadGrid:
    """The template's field on a graded grid; exact within ``band_mm`` of the surface (more where |f| is small)."""
    f, c = fine_mm, coarse_mm
    x_half = graded_axis((0.0, 55.0, 72.0, 92.0, 190.0), (f, c, f, 2 * c))
    x = np.concatenate([-x_half[:0:-1], x_half])
    # finest across the lips and the eyes' openings
    y = graded_axis(
        (template.floor_mm - 4.0, -118.0, -80.0, -58.0, -10.0, 8.0, 30.0, 180.0), (c, f, 0.65 * f, f, 0.65 * f, f, c)
    )
    z = graded_axis((-230.0, -108.0, -5.0, 62.0), (c, 0.5 * (f + c), f))
    stride = 7.0
    axes = tuple(graded_axis((a[0], a[-1]), (stride,)) for a in (x, y, z))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    coarse = evaluate_template(nodes * 1e-3, template).reshape([len(a) for a in axes]) * 1e3
    field = refine_axis_values(coarse.astype(np.float32), axes, (x, y, z))
    i, j, k = np.nonzero(np.abs(field) < band_mm + 0.5 * stride)
    # the half that is mirrored need not be evaluated twice
    left = x[i] >= -1e-9
    i, j, k = i[left], j[left], k[left]
    value = evaluate_in_cells(template, np.stack([x[i], y[j], z[k]], 1))
    field[i, j, k] = value
    field[len(x) - 1 - i, j, k] = value
    return HeadGrid(x * 1e-3, y * 1e-3, z * 1e-3, field * np.float32(1e-3))


@lru_cache(maxsize=1)
@one_thread
def template_grid() -> HeadGrid:
    """The shipped template on its grid; computed once per process."""
    return sample_grid(load_template())


def extract(grid: HeadGrid, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest closed surface ``field = 0``: vertices (V, 3) metres and faces (F, 3) int64, outward.

    Values within 1e-7 m of zero are moved off it, as marching cubes makes zero-area triangles there.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from skimage.measure import marching_cubes

    safe = np.where(np.abs(field) < 1e-7, np.float32(1e-7), field.astype(np.float32))
    for axis in range(3):
        edge = [slice(None)] * 3
        for side in (0, -1):
            edge[axis] = side
            safe[tuple(edge)] = np.maximum(safe[tuple(edge)], 1e-4)
    v, f, _, _ = marching_cubes(safe, 0.0, allow_degenerate=False, gradient_direction="ascent")
    index = np.arange(len(grid.x)), np.arange(len(grid.y)), np.arange(len(grid.z))
    axes = (grid.x, grid.y, grid.z)
    v = np.stack([np.interp(v[:, a].astype(np.float64), index[a], axes[a]) for a in range(3)], 1)
    f = f.astype(np.int64)
    edges = np.r_[f[:, [0, 1]], f[:, [1, 2]]]
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(v), len(v)))
    _, label = connected_components(graph, directed=False)
    keep = label == np.bincount(label).argmax()
    f = f[keep[f[:, 0]]]
    renumber = np.cumsum(keep) - 1
    v, f = v[keep], renumber[f]
    corner = v[f] - v.mean(0)
    if np.einsum("ni,ni->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) < 0:
        f = f[:, ::-1]
    return v, np.ascontiguousarray(f)
