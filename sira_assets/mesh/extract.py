"""From a signed distance to triangles: sparse marching cubes, Newton to the zero set, splitting where it curves.

Notation: f the field's signed distance; h the lattice's step (`cell_m`); t a tolerance; r a radius of curvature. A
triangle of edges h with its corners on the surface stands off it by h^2/(8 r) in the middle of an edge. So for a
tolerance h = sqrt(8 t r) with r = `TYPICAL_RADIUS_M`, and where the surface curves more, triangles are split until t
holds.
"""

from dataclasses import dataclass

import numpy as np

from sira_assets.errors import InputError
from sira_assets.fields.head_field import BOUNDS_M, HeadField, query
from sira_assets.mesh.lattice import bounds_sdf, chunk_for, lattice_over_box, surface_cells
from sira_assets.mesh.project import ProjectConfig, project_mesh
from sira_assets.mesh.refine import refine_mesh
from sira_assets.mesh.triangle_mesh import TriangleMesh

# Most of a head is flatter than this (cheeks 40 mm, nose tip 10 mm); lids, lips and ear rims, of 1 to 5 mm, are split.
TYPICAL_RADIUS_M = 0.01
# The lattice alone decides which parts hang together: nostrils and the gap between ear and skull are 3 mm wide.
COARSEST_CELL_M, FINEST_CELL_M = 0.002, 0.0005


@dataclass(frozen=True)
class ExtractConfig:
    """How finely and how safely the surface is extracted.

    Parameters
    ----------
    cell_m : finest cell, metres
    tolerance_mm : greatest distance of the surface from the zero set, mm; it decides the cell then (`cell_for`), and
        triangles are split where the cell alone leaves more. Where a wall or gap is thinner than the cell, such as a
        septum, all of it is done again with half the cell. None: the cell decides.
    coarsest_m : coarsest cell of the search, metres
    lipschitz : least bound assumed on |grad f|; more is taken where the coarsest lattice is steep (mesh/lattice.py).
        The shipped models reach 1.6 between points of that lattice, 2.2 at single points
    zero_m : |f| below this at a lattice point becomes +zero_m: exact zeros there make faces of no area and an open mesh
    polish : move the vertices onto the zero set, which takes their error from O(h^2) to rounding
    max_cells : refuse to go beyond this many finest cells (a field that is not a distance fills the box)
    """

    cell_m: float = 0.002
    tolerance_mm: float | None = None
    coarsest_m: float = 0.016
    lipschitz: float = 1.5
    zero_m: float = 1e-6
    polish: bool = True
    max_cells: int = 20_000_000

    def __post_init__(self):
        if self.tolerance_mm is not None and not 0.01 <= self.tolerance_mm <= 5.0:
            raise InputError(
                expected="a tolerance of 0.01 to 5 mm (a float32 network resolves micrometres)",
                received=f"{self.tolerance_mm:g} mm",
                remedy="choose one in that range",
            )


@dataclass(frozen=True)
class ExtractReport:
    """What an extraction took.

    Parameters
    ----------
    cell_m : the finest cell
    evaluations : points at which the field was asked, all stages together
    gradients : those of them at which its gradient was asked as well
    dense : points of that lattice in the head's box, which a dense evaluation asks
    slope : the steepest |difference of f| / distance met on the coarsest lattice
    split_vertices : vertices added for the tolerance's sake
    lost_faces : faces that the tolerance could not be kept at, for a wall or gap there is much thinner than `cell_m`
        (0 without a tolerance)
    """

    cell_m: float
    evaluations: int
    gradients: int
    dense: int
    slope: float
    split_vertices: int
    lost_faces: int


def cell_for(config: ExtractConfig) -> float:
    """h in metres: `cell_m`, or what `tolerance_mm` asks for (module docstring)."""
    if config.tolerance_mm is None:
        return config.cell_m
    wanted = np.sqrt(8.0 * 1e-3 * config.tolerance_mm * TYPICAL_RADIUS_M)
    return float(np.clip(wanted, FINEST_CELL_M, COARSEST_CELL_M))


class CountedField:
    """A field that counts the points it is asked for."""

    def __init__(self, field: HeadField):
        self._field = field
        self.evaluations = self.gradients = 0

    def sdf(self, x_canonical):
        """The field's own."""
        self.evaluations += len(x_canonical)
        self.gradients += len(x_canonical) if x_canonical.requires_grad else 0
        return self._field.sdf(x_canonical)

    def material(self, x_canonical):
        """The field's own, not counted."""
        return self._field.material(x_canonical)


def extract_mesh(field: HeadField, config: ExtractConfig = ExtractConfig(), *, device: str = "cpu") -> TriangleMesh:
    """`extract_with_report` without the report."""
    return extract_with_report(field, config, device=device)[0]


def extract_with_report(
    field: HeadField, config: ExtractConfig = ExtractConfig(), *, device: str = "cpu"
) -> tuple[TriangleMesh, ExtractReport]:
    """The zero set of `field` inside the head's box, closed where the box cuts it.

    Parameters
    ----------
    field : see `HeadField`

    Returns
    -------
    TriangleMesh : canonical metres, watertight, outward; normals from the field, and from the box on the caps.
        All pieces are there; `clean_mesh` keeps the largest.
    ExtractReport

    Raises
    ------
    InputError : the field is not finite somewhere, or is nowhere zero in the box, or nearly everywhere; or the
        tolerance takes more triangles than `max_cells`.
    """
    counted = CountedField(field)
    cell = first = cell_for(config)
    while True:
        mesh, slope = _marched(counted, cell, config, device)
        before, lost = len(mesh.vertices), 0
        if config.tolerance_mm is None:
            break
        mesh, lost = refine_mesh(
            counted, mesh, 1e-3 * config.tolerance_mm, max_triangles=config.max_cells, margin_m=cell, device=device
        )
        # The lattice joined what the zero set keeps apart, or the other way round, and half the cell may see it. A
        # quarter would take sixteen times the triangles, everywhere, for what is left in the depth of a nostril.
        if not lost or cell < first or cell == FINEST_CELL_M:
            break
        cell = max(0.5 * cell, FINEST_CELL_M)
    dense = int(np.prod(np.ceil((BOUNDS_M[1] - BOUNDS_M[0]) / cell)))
    split = len(mesh.vertices) - before
    return mesh, ExtractReport(cell, counted.evaluations, counted.gradients, dense, slope, split, lost)


def _marched(field: HeadField, cell_m: float, config: ExtractConfig, device: str) -> tuple[TriangleMesh, float]:
    """The zero set by one lattice, on the field's own zero set if polished; and the slope met on the coarsest one."""
    import igl

    found = surface_cells(
        field,
        lattice_over_box(cell_m, config.coarsest_m),
        lipschitz=config.lipschitz,
        zero_m=config.zero_m,
        max_cells=config.max_cells,
        device=device,
    )
    faces = np.empty((0, 3), np.int64)
    if len(found.corners):
        vertices, faces, _ = igl.marching_cubes(found.values, found.points, found.corners, 0.0)
    # A field negative all over the box gives the box itself: caps and nothing else.
    if not len(faces) or (bounds_sdf(vertices) > -cell_m).all():
        raise InputError(
            expected="a head whose signed distance changes sign inside the head's box",
            received="one sign everywhere (no surface)",
            remedy="check the fit, or the canonical frame it was made in",
        )
    return _finish(field, vertices, faces, cell_m, config.polish, device), found.slope


def _finish(
    field: HeadField, vertices: np.ndarray, faces: np.ndarray, cell_m: float, polish: bool, device: str
) -> TriangleMesh:
    """Polish vertices onto the zero set and take normals from the field; caps keep their place and the box's normal."""
    # Where the box cut the field, marching cubes reproduces the box's planes to rounding, for they are linear.
    on_cap = bounds_sdf(vertices) > -1e-7
    mesh = TriangleMesh(np.clip(vertices, *BOUNDS_M), faces)
    if polish:
        # More than half a cell would let neighbouring vertices pass each other; and none may pass the box.
        steps = ProjectConfig(max_distance_m=0.5 * cell_m)
        return project_mesh(field, mesh, steps, fixed=bounds_sdf(vertices) > -0.5 * cell_m, device=device)
    normals = query(field, mesh.vertices, normals=True, device=device, chunk=chunk_for(device)).normals
    flat = np.linalg.norm(normals, axis=1) < 0.5  # the gradient vanishes: a network's kink
    return TriangleMesh(mesh.vertices, faces, np.where((on_cap | flat)[:, None], mesh.normals, normals))
