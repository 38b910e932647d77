"""Extraction: convergence, topology, and the inputs that break marching cubes."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.fields.analytic import EllipsoidHead, SphereHead
from sira_assets.fields.head_field import BOUNDS_M
from sira_assets.mesh.extract import CountedField, ExtractConfig, extract_mesh
from sira_assets.mesh.lattice import lattice_over_box, surface_cells
from sira_assets.mesh.topology import topology


@dataclass(frozen=True)
class Field:
    """Any signed distance, without a material."""

    function: object

    def sdf(self, x):
        return self.function(x)


def error_m(field, mesh):
    return np.abs(field.sdf(torch.tensor(mesh.vertices)).numpy()).max()


@pytest.mark.parametrize("field", [SphereHead(), EllipsoidHead()])
def test_unpolished_error_falls_as_the_square_of_the_cell(field):
    coarse, fine = (error_m(field, extract_mesh(field, ExtractConfig(cell_m=h, polish=False))) for h in (0.008, 0.004))
    # Linear interpolation of a smooth field errs by h^2 |f''| / 8: halving h divides by 4; 3.2 leaves room for where
    # the lattice falls.
    assert coarse / fine > 3.2


@pytest.mark.parametrize("field", [SphereHead(), EllipsoidHead()])
def test_polished_surface_is_closed_simple_and_on_the_zero_set(field):
    mesh = extract_mesh(field, ExtractConfig(cell_m=0.006))
    shape = topology(mesh)
    assert shape.watertight
    assert (shape.pieces, shape.genus, shape.zero_area_faces, shape.nonmanifold_vertices) == (1, 0, 0, 0)
    # ProjectConfig's tolerance is 2e-6 m; float32 evaluation of 0.1 m adds a few 1e-8.
    assert error_m(field, mesh) < 2.5e-6
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = (a * np.cross(b, c)).sum() / 6
    expected = 4 / 3 * np.pi * (0.1**3 if isinstance(field, SphereHead) else np.prod(field.radii_m))
    # Inscribed triangles lose about h^2 / (8 r) in radius, three times that in relative volume: 0.14 % at h = 6 mm.
    assert volume == pytest.approx(expected, rel=3e-3)
    assert volume > 0  # outward


def test_normals_are_the_fields():
    mesh = extract_mesh(SphereHead(), ExtractConfig(cell_m=0.008))
    exact = (mesh.vertices - SphereHead().centre_m) / 0.1
    # Float32 gradients: 1e-7 each.
    assert np.abs(mesh.normals - exact).max() < 1e-4


def test_exact_zeros_on_the_lattice_leave_no_flat_faces_and_no_holes():
    sphere = SphereHead()

    def snapped(x):
        sdf = sphere.sdf(x)
        return torch.where(sdf.abs() < 3e-3, torch.zeros_like(sdf), sdf)

    # A shell of exact zeros more than half a cell thick covers thousands of lattice points.
    shape = topology(extract_mesh(Field(snapped), ExtractConfig(cell_m=0.004, polish=False)))
    assert shape.watertight
    assert shape.zero_area_faces == 0


def test_every_floater_is_found_however_small_the_gradient():
    centre = torch.tensor([0.15, 0.1, 0.1])

    def two(x):
        return torch.minimum(SphereHead().sdf(x), torch.linalg.norm(x - centre, dim=-1) - 0.006)

    for gain in (0.4, 1.0, 3.0):  # a field flatter, as steep and three times steeper than a distance
        shape = topology(extract_mesh(Field(lambda x, gain=gain: gain * two(x)), ExtractConfig(cell_m=0.004)))
        assert shape.pieces == 2
        assert shape.watertight


def test_a_steep_fold_costs_nothing_elsewhere_and_loses_nothing():
    """A field eight times steeper around one ear only: the same cells as with that bound everywhere, for far less."""
    ear = torch.tensor([0.1, 0.0, -0.064])

    def steep(x):
        f = SphereHead().sdf(x)
        return f * (1 + 7 * torch.exp(-0.5 * ((x - ear) / 0.02).square().sum(-1)))

    found, asked = [], []
    for lipschitz in (2.0, 12.0):
        field = CountedField(Field(steep))
        cells = surface_cells(
            field, lattice_over_box(0.002, 0.016), lipschitz=lipschitz, zero_m=1e-6, max_cells=10_000_000
        )
        found.append(cells.points)
        asked.append(field.evaluations)
    assert cells.slope > 4
    np.testing.assert_array_equal(*found)
    # Twelve times the bound keeps the whole band of 0.1 m around the surface at the coarser levels.
    assert asked[0] < 0.5 * asked[1]


def test_a_head_cut_by_the_box_is_closed_within_it():
    mesh = extract_mesh(SphereHead(0.28), ExtractConfig(cell_m=0.008))
    assert topology(mesh).watertight
    assert (mesh.vertices >= BOUNDS_M[0]).all()
    assert (mesh.vertices <= BOUNDS_M[1]).all()


def test_a_rough_field_stays_watertight():
    rough = Field(lambda x: SphereHead().sdf(x) + 0.004 * torch.sin(300 * x).prod(-1))
    assert topology(extract_mesh(rough, ExtractConfig(cell_m=0.004))).watertight


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_field_that_is_not_finite_is_refused(value):
    def broken(x):
        return torch.where(x[:, 0] > 0.05, torch.full_like(x[:, 0], value), SphereHead().sdf(x))

    with pytest.raises(InputError, match="not finite"):
        extract_mesh(Field(broken), ExtractConfig(cell_m=0.008))


@pytest.mark.parametrize("value", [0.2, 1e-3, -0.1])
def test_a_field_without_surface_is_refused(value):
    with pytest.raises(InputError, match="no surface"):
        extract_mesh(Field(lambda x: torch.full_like(x[:, 0], value)), ExtractConfig(cell_m=0.008))


def test_the_same_field_gives_the_same_mesh():
    first, second = (extract_mesh(EllipsoidHead(), ExtractConfig(cell_m=0.008)) for _ in range(2))
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.faces, second.faces)
