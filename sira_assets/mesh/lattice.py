"""Where on a fine lattice a field's surface runs, from as few values as it takes.

Notation: h finest step; a cell of size s has edges of s h, s a power of two; f the field's signed distance closed by
the head's box; L a bound on |grad f|. No point of a cell's eighth is further than s h sqrt(3)/2 from the corner they
share, so an eighth whose corner has |f| > L s h sqrt(3)/2 holds no surface (Galin et al. 2020 call such a tree a
Lipschitz octree, DOI 10.1111/cgf.13951). L is local: 1.5 times the steepest slope met on the coarsest lattice within
one of its cells, so that one steep fold does not make the whole head expensive. Down to cells of two steps every
eighth that may hold surface is kept, and all eighths of a cell whose corners differ in sign. The last halving costs
most, so there only the eighths are asked through which the trilinear interpolant of the cell's corners runs; from
these, cells are added across every face the surface leaves through, until it leaves nowhere (continuation; Wyvill et
al. 1986, DOI 10.1007/BF01900346). Cells near no surface found so far but with small |f| are asked whole. What this can
miss is a closed piece of its own smaller than two steps' lattice sees, within four steps of other surface: a floater,
cleaned away anyhow.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.fields.head_field import BOUNDS_M, HeadField, query

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
# A key holds an index in so many bits an axis; the box is 540,000 of the finest steps long.
AXIS_BITS, FINEST_STEP_M = 20, 1e-6
# Lattice points are kept by blocks of 8 x 8 x 8: small enough that few are far from the surface, large enough that the
# table of blocks is small beside them.
BLOCK_BITS = 3
# Numbers at a time in arithmetic of many steps, so that what lies between the steps stays in a core's cache.
IN_CACHE = 1 << 14
# Points at a time on a processor: activations of a 128-wide network and their gradients then stay in a core's cache
# (measured: twice as many gradients a second as with 16384). A GPU wants more.
CPU_CHUNK, GPU_CHUNK = 4096, 262_144


@dataclass(frozen=True)
class Lattice:
    """Integer lattice over the head's box; index (i, j, k) stands at origin + step (i, j, k).

    Parameters
    ----------
    origin : (3,) metres
    step : h, metres
    points : (3,) int64, lattice points per axis; points - 1 is a multiple of `coarsest`
    coarsest : size of the coarsest cells, a power of two
    """

    origin: np.ndarray
    step: float
    points: np.ndarray
    coarsest: int

    def key(self, index: np.ndarray) -> np.ndarray:
        """One int64 for each (..., 3) index; the key of a sum is the sum of the keys."""
        return index[..., 0] + (index[..., 1] << AXIS_BITS) + (index[..., 2] << 2 * AXIS_BITS)

    def index(self, key: np.ndarray) -> np.ndarray:
        """The inverse of `key`."""
        below = (1 << AXIS_BITS) - 1
        return np.stack([key & below, (key >> AXIS_BITS) & below, key >> 2 * AXIS_BITS], -1)

    def position(self, index: np.ndarray) -> np.ndarray:
        """(..., 3) metres."""
        return self.origin + self.step * index


def lattice_over_box(step_m: float, coarsest_m: float) -> Lattice:
    """A lattice of `step_m` that covers the head's box, its coarsest cells at most `coarsest_m` (or one step).

    Raises
    ------
    InputError : a step that is not 0.001 to 40 mm.
    """
    if not FINEST_STEP_M <= step_m <= 0.04:
        raise InputError(
            expected="a cell of 0.001 to 40 mm", received=f"{step_m * 1e3:g} mm", remedy="choose another cell"
        )
    size = 2 ** max(0, int(np.floor(np.log2(max(coarsest_m / step_m, 1.0) * (1 + 1e-9)))))
    coarse = size * step_m
    # Half a cell of offset keeps lattice planes off the box's own planes (exact zeros); what is beyond them closes it.
    origin = BOUNDS_M[0] - (size // 2 + 0.5) * step_m
    cells = np.ceil((BOUNDS_M[1] + 0.5 * coarse - origin) / coarse).astype(np.int64)
    return Lattice(origin, step_m, cells * size + 1, size)


def bounds_sdf(points: np.ndarray) -> np.ndarray:
    """(N,) max-norm distance to the head's box, negative inside; it closes what the box cuts."""
    centre, half = (BOUNDS_M[0] + BOUNDS_M[1]) / 2, (BOUNDS_M[1] - BOUNDS_M[0]) / 2
    return (np.abs(points - centre) - half).max(-1)


def chunk_for(device: str) -> int:
    """Points of one query."""
    return CPU_CHUNK if str(device) == "cpu" else GPU_CHUNK


def closed_sdf(field: HeadField, points: np.ndarray, device: str) -> np.ndarray:
    """(N,) max(f, box) in metres; never asks the field for a point outside its box.

    Raises
    ------
    InputError : f is not finite; says where.
    """
    inside = np.clip(points, *BOUNDS_M)
    sdf = query(field, inside, device=device, chunk=chunk_for(device)).sdf_m.astype(np.float64)
    bad = ~np.isfinite(sdf)
    if bad.any():
        raise InputError(
            expected="a finite signed distance everywhere in the head's box",
            received=f"{int(bad.sum())} of {len(sdf)} not finite, the first at {inside[bad][0].round(4).tolist()}",
            remedy="the weights are damaged or the fit diverged; fit again",
        )
    return np.maximum(sdf, bounds_sdf(points))


class LatticeValues:
    """f at the corners of cells of one size, each asked once; |f| below `zero_m` becomes +zero_m (see `ExtractConfig`).

    Every corner asked for gets a place of its own, and so do the others of its block. A place is found in a few
    integer operations, and equal keys are told from unequal ones by it, which takes ten times as long by sorting.

    Parameters
    ----------
    coarser : values at the corners of the cells of twice the size, which are not asked again
    """

    def __init__(
        self, field: HeadField, lattice: Lattice, zero_m: float, device: str, size: int, coarser: "LatticeValues" = None
    ):
        self._field, self._lattice, self._zero, self._device = field, lattice, zero_m, device
        self._shift, self._coarser = size.bit_length() - 1, coarser
        self._blocks = (((lattice.points - 1) // size) >> BLOCK_BITS) + 1
        self._first = np.full(np.prod(self._blocks), -1, np.int64)  # place of a block's first corner, -1 for none
        self._values = np.empty(0)  # by place; NaN where not asked yet
        self._rank = np.empty(0, np.int64)  # by place; what `distinct` marks them with

    def finer(self) -> "LatticeValues":
        """Values at the corners of cells of half the size."""
        size = 1 << self._shift >> 1
        return LatticeValues(self._field, self._lattice, self._zero, self._device, size, self)

    @property
    def room(self) -> int:
        """Places given so far."""
        return len(self._values)

    def places(self, keys: np.ndarray) -> np.ndarray:
        """A number below `room` for each key, the same for the same key from now on."""
        block, within = self._block(keys)
        first = self._first[block]
        if (first < 0).any():
            new = np.unique(block[first < 0])
            each = 1 << 3 * BLOCK_BITS
            self._first[new] = self.room + each * np.arange(len(new))
            self._values = np.concatenate([self._values, np.full(each * len(new), np.nan)])
            self._rank = np.concatenate([self._rank, np.empty(each * len(new), np.int64)])
            first = self._first[block]
        return first + within

    def distinct(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(D,) positions in `places` (P,), one for each distinct place, and (P,) numbers below D of all places."""
        order = np.arange(len(places))
        self._rank[places] = order
        chosen = np.flatnonzero(self._rank[places] == order)
        self._rank[places[chosen]] = np.arange(len(chosen))
        return chosen, self._rank[places]

    def at(self, keys: np.ndarray) -> np.ndarray:
        """Values at corners of any shape."""
        places = self.places(keys)
        values = self._values[places]
        missing = np.isnan(values)
        if missing.any():
            places = places[missing]
            chosen, _ = self.distinct(places)
            self._values[places[chosen]] = self._asked(keys[missing][chosen])
            values[missing] = self._values[places]
        return values

    def _block(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The number of each key's block, and its number within it."""
        block, within = np.empty(keys.shape, np.int64), np.empty(keys.shape, np.int64)
        flat = (keys.ravel(), block.reshape(-1), within.reshape(-1))
        axis, inside, size = (1 << AXIS_BITS) - 1, (1 << BLOCK_BITS) - 1, self._blocks
        for start in range(0, keys.size, IN_CACHE):
            key, to_block, to_within = (a[start : start + IN_CACHE] for a in flat)
            i, j, k = (
                (key & axis) >> self._shift,
                (key >> AXIS_BITS & axis) >> self._shift,
                key >> 2 * AXIS_BITS + self._shift,
            )
            to_within[:] = i & inside | (j & inside) << BLOCK_BITS | (k & inside) << 2 * BLOCK_BITS
            to_block[:] = (i >> BLOCK_BITS) + size[0] * ((j >> BLOCK_BITS) + size[1] * (k >> BLOCK_BITS))
        return block, within

    def _known(self, keys: np.ndarray) -> np.ndarray:
        """Values (N,) at keys (N,), NaN where none was asked."""
        values = np.full(len(keys), np.nan)
        mine = np.flatnonzero((self._lattice.index(keys) & ((1 << self._shift) - 1) == 0).all(-1))
        block, within = self._block(keys[mine])
        there = self._first[block] >= 0
        values[mine[there]] = self._values[(self._first[block] + within)[there]]
        missing = mine[np.isnan(values[mine])]
        if self._coarser is not None and len(missing):
            values[missing] = self._coarser._known(keys[missing])
        return values

    def _asked(self, keys: np.ndarray) -> np.ndarray:
        """Values (N,) at different keys (N,)."""
        values = self._known(keys)
        new = np.isnan(values)
        points = self._lattice.position(self._lattice.index(keys[new]))
        fresh = closed_sdf(self._field, points, self._device)
        values[new] = np.where(np.abs(fresh) < self._zero, self._zero, fresh)
        return values


@dataclass(frozen=True)
class SurfaceCells:
    """The finest cells the surface runs through.

    Parameters
    ----------
    corners : (C, 8) int64 into `points`
    points : (P, 3) metres
    values : (P,) f there
    slope : the steepest |difference of f| / distance between neighbours of the coarsest lattice
    """

    corners: np.ndarray
    points: np.ndarray
    values: np.ndarray
    slope: float


def surface_cells(
    field: HeadField, lattice: Lattice, *, lipschitz: float, zero_m: float, max_cells: int, device: str = "cpu"
) -> SurfaceCells:
    """Find the cells of `lattice` that have a change of sign among their corners.

    Parameters
    ----------
    lipschitz : least bound L assumed; more where the coarsest lattice is steep (module docstring)
    max_cells : refuse a field that may have surface in more cells than these

    Raises
    ------
    InputError : f is not finite somewhere, or small nearly everywhere.
    """
    size = lattice.coarsest
    values = LatticeValues(field, lattice, zero_m, device, size)
    grid = np.stack(np.meshgrid(*(np.arange(0, n, size) for n in lattice.points), indexing="ij"), -1)
    corners = values.at(lattice.key(grid))
    slopes = _slopes(corners) / (size * lattice.step)
    bounds = np.maximum(lipschitz, 1.5 * _around(slopes))
    cells = lattice.key(grid[:-1, :-1, :-1].reshape(-1, 3))  # keys of low corners, here and below
    while size > 1:
        at = values.at(cells[:, None] + lattice.key(CORNERS * size))
        crossing = _changes_sign(at)
        bound = bounds[tuple((lattice.index(cells) // lattice.coarsest).T)]
        possible = crossing[:, None] | (np.abs(at) <= (bound * size * lattice.step * np.sqrt(0.75))[:, None])
        if possible.sum() * (1 if size > 2 else 0.5) > max_cells:
            raise InputError(
                expected=f"a surface within {max_cells} cells of {lattice.step * 1e3:g} mm",
                received=f"{int(possible.any(1).sum())} cells of {size} times that may hold surface "
                f"(|grad f| up to {slopes.max():.3g})",
                remedy="the field is far from a distance: fit again, or use a larger cell or tolerance",
            )
        eighths = lattice.key(CORNERS * (size // 2))
        if size == 2:
            alone = cells[possible.any(1) & ~crossing]
            alone = alone[~_beside(lattice, alone, cells[crossing], size)]
            likely = _likely_eighths(at[crossing])
            cells = np.concatenate([(cells[crossing][:, None] + eighths)[likely], (alone[:, None] + eighths).ravel()])
        else:
            cells = (cells[:, None] + eighths)[possible]
        size //= 2
        values = values.finer()
    keys = (_grow(lattice, values, cells)[:, None] + lattice.key(CORNERS)).ravel()
    chosen, number = values.distinct(values.places(keys))
    points = lattice.position(lattice.index(keys[chosen]))
    return SurfaceCells(number.reshape(-1, 8), points, values.at(keys[chosen]), float(slopes.max(initial=0.0)))


def _slopes(corners: np.ndarray) -> np.ndarray:
    """(X - 1, Y - 1, Z - 1) greatest |difference| along the edges of each cell, of values (X, Y, Z) at corners."""
    steepest = np.zeros(np.array(corners.shape) - 1)
    for axis in range(3):
        edges = np.abs(np.diff(corners, axis=axis))
        for other in {0, 1, 2} - {axis}:
            low, high = (np.take(edges, range(i, edges.shape[other] - 1 + i), other) for i in (0, 1))
            edges = np.maximum(low, high)
        steepest = np.maximum(steepest, edges)
    return steepest


def _around(cells: np.ndarray) -> np.ndarray:
    """The greatest value of each cell and of the 26 around it."""
    from scipy.ndimage import maximum_filter

    return maximum_filter(cells, 3, mode="nearest")


def _changes_sign(corner_values: np.ndarray) -> np.ndarray:
    negative = corner_values < 0.0
    return negative.any(1) & ~negative.all(1)


def _likely_eighths(corner_values: np.ndarray) -> np.ndarray:
    """(C, 8) bool: eighths of cells in which the trilinear interpolant of the corner values (C, 8) changes sign."""
    cube = np.zeros((len(corner_values), 3, 3, 3))
    for corner, (i, j, k) in enumerate(CORNERS * 2):
        cube[:, i, j, k] = corner_values[:, corner]
    cube[:, 1] = 0.5 * (cube[:, 0] + cube[:, 2])
    cube[:, :, 1] = 0.5 * (cube[:, :, 0] + cube[:, :, 2])
    cube[:, :, :, 1] = 0.5 * (cube[:, :, :, 0] + cube[:, :, :, 2])
    negative = cube < 0.0
    eighths = (negative[:, i : i + 2, j : j + 2, k : k + 2].reshape(-1, 8) for i, j, k in CORNERS)
    return np.stack([e.any(1) & ~e.all(1) for e in eighths], 1)


def _beside(lattice: Lattice, cells: np.ndarray, others: np.ndarray, size: int) -> np.ndarray:
    """(C,) bool: whether one of the cells `others` (keys) is within two cells of `size` along every axis."""
    taken = np.zeros((lattice.points - 1) // size + 4, bool)  # two cells of margin all round
    taken[tuple((lattice.index(others) // size).T + 2)] = True
    for axis in range(3):  # a box is what its axes make one after the other
        along = np.moveaxis(taken, axis, 0)
        along[2:-2] = along[:-4] | along[1:-3] | along[2:-2] | along[3:-1] | along[4:]
    return taken[tuple((lattice.index(cells) // size).T + 2)]


def _grow(lattice: Lattice, values: LatticeValues, cells: np.ndarray) -> np.ndarray:
    """Sorted keys of all finest cells with a change of sign that are linked to `cells` through faces with one."""
    fresh, crossing = np.unique(cells), []
    places = values.places(fresh)
    seen = np.zeros(values.room, bool)
    seen[places] = True
    while len(fresh):
        negative = values.at(fresh[:, None] + lattice.key(CORNERS)) < 0.0
        cut = negative.any(1) & ~negative.all(1)
        crossing.append(fresh[cut])
        wanted = []
        for side, step in SIDES:
            through = negative[:, side].any(1) & ~negative[:, side].all(1)
            wanted.append(fresh[through] + lattice.key(np.array(step)))
        wanted = np.concatenate(wanted)
        places = values.places(wanted)
        seen = np.concatenate([seen, np.zeros(values.room - len(seen), bool)])
        unseen = ~seen[places]
        fresh = np.unique(wanted[unseen])
        seen[places[unseen]] = True
    return np.sort(np.concatenate(crossing)) if crossing else np.empty(0, np.int64)
