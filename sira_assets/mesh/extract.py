"""From a signed distance to triangles: sparse marching cubes near the surface, then Newton to the zero set.

Notation: f the field's signed distance; h finest cell; L a bound on |grad f|. A cell of size c with centre m can hold
surface only where |f(m)| <= L c sqrt(3)/2, so cells are halved only there (Galin et al. 2020 call it a Lipschitz
octree, DOI 10.1111/cgf.13951). A neural f is only nearly a distance, hence three guards: L is at least 1.5 times the
steepest slope met on the coarse lattice; every coarse cell with a sign change at its corners is kept; and the finest
cells grow across any face the surface leaves through, until it leaves nowhere.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.fields.head_field import BOUNDS_M, HeadField, query
from sira_assets.mesh.project import ProjectConfig, project_mesh
from sira_assets.mesh.triangle_mesh import TriangleMesh

# Corner order that libigl's tables expect, as (x, y, z) steps.
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
# The corners of a cell's faces in that order, and the step to the neighbour behind each.
SIDES = (
    ((0, 3, 4, 7), (-1, 0, 0)),
    ((1, 2, 5, 6), (1, 0, 0)),
    ((0, 1, 4, 5), (0, -1, 0)),
    ((2, 3, 6, 7), (0, 1, 0)),
    ((0, 1, 2, 3), (0, 0, -1)),
    ((4, 5, 6, 7), (0, 0, 1)),
)


@dataclass(frozen=True)
class ExtractConfig:
    """How finely and how safely the surface is extracted.

    Parameters
    ----------
    cell_m : finest cell, metres
    levels : the coarsest cell is `cell_m * 2**levels`
    lipschitz : least bound assumed on |grad f|; 2 is safe for a field trained to |grad f| = 1 (its steepest parts
        reach about 1.3), and costs a band 2 cells thick on each side
    zero_m : |f| below this at a lattice point becomes +zero_m: exact zeros there make faces of no area and an open mesh
    polish : move the vertices onto the zero set, which takes the error from O(h^2) to rounding
    max_cells : refuse to go beyond this many finest cells (a field that is not a distance fills the box)
    """

    cell_m: float = 0.002
    levels: int = 2
    lipschitz: float = 2.0
    zero_m: float = 1e-6
    polish: bool = True
    max_cells: int = 20_000_000


@dataclass(frozen=True)
class _Lattice:
    """Integer lattice of step h over the head's box; index (i, j, k) stands at origin + h (i, j, k)."""

    origin: np.ndarray
    step: float
    points: np.ndarray  # lattice points per axis

    def key(self, index: np.ndarray) -> np.ndarray:
        return index[..., 0] + self.points[0] * (index[..., 1] + self.points[1] * index[..., 2])

    def index(self, key: np.ndarray) -> np.ndarray:
        rest, i = np.divmod(key, self.points[0])
        k, j = np.divmod(rest, self.points[1])
        return np.stack([i, j, k], -1)

    def position(self, index: np.ndarray) -> np.ndarray:
        return self.origin + self.step * index


def extract_mesh(field: HeadField, config: ExtractConfig = ExtractConfig(), *, device: str = "cpu") -> TriangleMesh:
    """The zero set of `field` inside the head's box, closed where the box cuts it.

    Parameters
    ----------
    field : see `HeadField`

    Returns
    -------
    TriangleMesh : canonical metres, watertight, outward; normals from the field, and from the box on the caps.
        All pieces are there; `clean_mesh` keeps the largest.

    Raises
    ------
    InputError : the field is not finite somewhere, or is nowhere zero in the box, or nearly everywhere.
    """
    import igl

    lattice = _lattice(config)
    cells = _surface_cells(field, lattice, config, device)
    cells, keys, values = _grow(field, lattice, cells, config, device)
    corner = np.searchsorted(keys, lattice.key(cells[:, None, :] + CORNERS))
    signs = values[corner] < 0.0
    crossing = signs.any(1) & ~signs.all(1)
    vertices, faces, _ = igl.marching_cubes(values, lattice.position(lattice.index(keys)), corner[crossing], 0.0)
    # A field negative all over the box gives the box itself: caps and nothing else.
    if not len(faces) or (bounds_sdf(vertices) > -config.cell_m).all():
        raise InputError(
            expected="a head whose signed distance changes sign inside the head's box",
            received="one sign everywhere (no surface)",
            remedy="check the fit, or the canonical frame it was made in",
        )
    return _finish(field, vertices, faces, config, device)


def bounds_sdf(points: np.ndarray) -> np.ndarray:
    """(N,) max-norm distance to the head's box, negative inside; it closes what the box cuts."""
    centre, half = (BOUNDS_M[0] + BOUNDS_M[1]) / 2, (BOUNDS_M[1] - BOUNDS_M[0]) / 2
    return (np.abs(points - centre) - half).max(-1)


def _closed_sdf(field: HeadField, points: np.ndarray, device: str) -> np.ndarray:
    """max(f, box): never asks the field for a point outside its box."""
    inside = np.clip(points, *BOUNDS_M)
    sdf = query(field, inside, device=device).sdf_m.astype(np.float64)
    bad = ~np.isfinite(sdf)
    if bad.any():
        raise InputError(
            expected="a finite signed distance everywhere in the head's box",
            received=f"{int(bad.sum())} of {len(sdf)} not finite, the first at {inside[bad][0].round(4).tolist()}",
            remedy="the weights are damaged or the fit diverged; fit again",
        )
    return np.maximum(sdf, bounds_sdf(points))


def _lattice(config: ExtractConfig) -> _Lattice:
    coarse = config.cell_m * 2**config.levels
    if not (0 < coarse <= 0.04 and config.levels >= 0):
        raise InputError(
            expected="a coarsest cell (cell_m * 2**levels) above 0 and at most 40 mm",
            received=f"{coarse * 1e3:g} mm",
            remedy="choose a smaller cell or fewer levels",
        )
    # Half a cell of offset keeps lattice planes off the box's own planes (exact zeros), one cell of margin closes it.
    origin = BOUNDS_M[0] - 0.5 * coarse - 0.5 * config.cell_m
    cells = np.ceil((BOUNDS_M[1] + 0.5 * coarse - origin) / coarse).astype(np.int64)
    return _Lattice(origin, config.cell_m, cells * 2**config.levels + 1)


def _surface_cells(field: HeadField, lattice: _Lattice, config: ExtractConfig, device: str) -> np.ndarray:
    """(C, 3) lattice indices of the low corners of the finest cells that may hold surface."""
    size = 2**config.levels
    shape = (lattice.points - 1) // size + 1
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1)
    corners = _closed_sdf(field, lattice.position(grid.reshape(-1, 3) * size), device).reshape(grid.shape[:3])
    slope = max(np.abs(np.diff(corners, axis=axis)).max(initial=0.0) for axis in range(3)) / (size * lattice.step)
    bound = max(config.lipschitz, 1.5 * slope)
    low = corners[:-1, :-1, :-1] < 0
    change = np.zeros_like(low)
    for step in CORNERS[1:]:
        i, j, k = step
        change |= low != (corners[i : i + shape[0] - 1, j : j + shape[1] - 1, k : k + shape[2] - 1] < 0)
    cells, sure = grid[:-1, :-1, :-1].reshape(-1, 3) * size, change.reshape(-1)
    while True:
        centre = lattice.position(cells + 0.5 * size)
        near = np.abs(_closed_sdf(field, centre, device)) <= bound * size * lattice.step * np.sqrt(0.75)
        cells, sure = cells[near | sure], sure[near | sure]
        if size == 1:
            return cells
        size //= 2
        if len(cells) * 8 > config.max_cells:
            raise InputError(
                expected=f"a surface within {config.max_cells} cells of {config.cell_m * 1e3:g} mm",
                received=f"{len(cells) * 8} cells that may hold surface (|grad f| up to {slope:.3g})",
                remedy="the field is far from a distance: fit again, or use a larger cell_m",
            )
        cells = (cells[:, None, :] + CORNERS * size).reshape(-1, 3)
        sure = np.zeros(len(cells), bool)


def _grow(
    field: HeadField, lattice: _Lattice, cells: np.ndarray, config: ExtractConfig, device: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add cells until no sign change touches a face behind which there is none; give cells, corner keys and values."""
    keys, values = np.empty(0, np.int64), np.empty(0)
    have = np.unique(lattice.key(cells))
    while True:
        cells = lattice.index(have)
        corner_keys = lattice.key(cells[:, None, :] + CORNERS)
        new = np.setdiff1d(corner_keys, keys)
        fresh = _closed_sdf(field, lattice.position(lattice.index(new)), device)
        fresh = np.where(np.abs(fresh) < config.zero_m, config.zero_m, fresh)
        keys, values = np.concatenate([keys, new]), np.concatenate([values, fresh])
        order = np.argsort(keys)
        keys, values = keys[order], values[order]
        negative = values[np.searchsorted(keys, corner_keys)] < 0
        wanted = []
        for side, step in SIDES:
            crossed = negative[:, side].any(1) & ~negative[:, side].all(1)
            wanted.append(lattice.key(cells[crossed] + np.array(step)))
        missing = np.setdiff1d(np.concatenate(wanted), have)
        if not len(missing):
            return cells, keys, values
        have = np.union1d(have, missing)


def _finish(
    field: HeadField, vertices: np.ndarray, faces: np.ndarray, config: ExtractConfig, device: str
) -> TriangleMesh:
    """Polish vertices onto the zero set and take normals from the field; caps keep their place and the box's normal."""
    # Where the box cut the field, marching cubes reproduces the box's planes to rounding, for they are linear.
    on_cap = bounds_sdf(vertices) > -1e-7
    mesh = TriangleMesh(np.clip(vertices, *BOUNDS_M), faces)
    if config.polish:
        # More than half a cell would let neighbouring vertices pass each other; and none may pass the box.
        steps = ProjectConfig(max_distance_m=0.5 * config.cell_m)
        return project_mesh(field, mesh, steps, fixed=bounds_sdf(vertices) > -0.5 * config.cell_m, device=device)
    normals = query(field, mesh.vertices, normals=True, device=device).normals
    flat = np.linalg.norm(normals, axis=1) < 0.5  # the gradient vanishes: a network's kink
    return TriangleMesh(mesh.vertices, faces, np.where((on_cap | flat)[:, None], mesh.normals, normals))
