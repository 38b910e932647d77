"""Sparse search against a dense one, tolerances against exact distances, splitting, weights, self-intersections."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.fields.analytic import EllipsoidHead, SphereHead
from sira_assets.fields.fitted import FittedHead
from sira_assets.fields.prior import load_prior
from sira_assets.mesh.asset_mesh import asset_mesh, level_of_detail
from sira_assets.mesh.clean import clean_with_report
from sira_assets.mesh.extract import CountedField, ExtractConfig, cell_for, extract_mesh, extract_with_report
from sira_assets.mesh.field_distance import field_distance, mesh_distance, surface_samples
from sira_assets.mesh.importance import head_importance
from sira_assets.mesh.lattice import CORNERS, LatticeValues, closed_sdf, lattice_over_box, surface_cells
from sira_assets.mesh.refine import refine_mesh
from sira_assets.mesh.self_intersection import self_intersecting_faces
from sira_assets.mesh.simplify import simplify_mesh, simplify_to_tolerance
from sira_assets.mesh.topology import topology
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

SPHERE = SphereHead()


@dataclass(frozen=True)
class Field:
    """Any signed distance, without a material."""

    function: object

    def sdf(self, x):
        return self.function(x)


@dataclass
class Remembering:
    """A field that remembers the points it was asked for."""

    function: object
    asked: list

    def sdf(self, x):
        self.asked.append(x.double().numpy())
        return self.function(x)


def two_balls(x):
    """Two overlapping balls, the crease between them rounded to a radius of about 4 mm; |grad f| = 0.7 to 1 there."""
    a, b = (SphereHead(r, c).sdf(x) for r, c in ((0.08, (0.0, -0.05, -0.05)), (0.06, (0.0, 0.06, -0.05))))
    return -0.002 * torch.logsumexp(torch.stack([a, b]) / -0.002, 0)


def rough(x):
    return SPHERE.sdf(x) + 0.003 * torch.sin(150 * x).prod(-1)


@pytest.fixture(scope="module")
def ball():
    return extract_mesh(SPHERE, ExtractConfig(cell_m=0.006))


def test_lattice_values_are_the_fields_and_each_corner_is_asked_once_at_whatever_size_of_cell():
    lattice, field, rng = lattice_over_box(0.004, 0.016), Remembering(SPHERE.sdf, []), np.random.default_rng(0)
    values = LatticeValues(field, lattice, 0.0, "cpu", 4)
    for size in (4, 2, 1):
        for _ in range(3):  # an eighth of the lattice, so that corners repeat within a call, between calls and sizes
            index = 8 + size * rng.integers(0, (lattice.points - 1) // (2 * size), (9000, 2, 3))
            expected = closed_sdf(SPHERE, lattice.position(index.reshape(-1, 3)), "cpu").reshape(9000, 2)
            np.testing.assert_array_equal(values.at(lattice.key(index)), expected)
        values = values.finer() if size > 1 else values
    asked = np.concatenate(field.asked)
    assert len(np.unique(asked, axis=0)) == len(asked)


def test_places_tell_keys_apart_as_sorting_does():
    lattice = lattice_over_box(0.002, 0.016)
    values, index = (
        LatticeValues(SPHERE, lattice, 0.0, "cpu", 1),
        np.random.default_rng(1).integers(0, 60, (100_000, 3)),
    )
    index[0], index[1] = 0, lattice.points - 1
    keys = lattice.key(index)
    np.testing.assert_array_equal(lattice.index(keys), index)
    chosen, number = values.distinct(values.places(keys))
    np.testing.assert_array_equal(np.sort(keys[chosen]), np.unique(keys))
    np.testing.assert_array_equal(keys[chosen][number], keys)


@pytest.mark.parametrize("steps", [(0.008, 0.016), (0.004, 0.032)])
@pytest.mark.parametrize("function", [SPHERE.sdf, EllipsoidHead().sdf, two_balls, rough])
def test_the_sparse_search_finds_the_cells_a_dense_one_finds(function, steps):
    field, lattice = Field(function), lattice_over_box(*steps)
    found = surface_cells(field, lattice, lipschitz=2.0, zero_m=1e-6, max_cells=10**7)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in lattice.points), indexing="ij"), -1)
    value = closed_sdf(field, lattice.position(grid.reshape(-1, 3)), "cpu")
    negative = (np.where(np.abs(value) < 1e-6, 1e-6, value) < 0).reshape(lattice.points)
    n = lattice.points - 1
    corner = np.stack([negative[i : i + n[0], j : j + n[1], k : k + n[2]] for i, j, k in CORNERS], -1)
    dense = np.sort(lattice.key(np.argwhere(corner.any(-1) & ~corner.all(-1))))
    low = found.points[found.corners[:, 0]]
    sparse = np.sort(lattice.key(np.round((low - lattice.origin) / lattice.step).astype(np.int64)))
    assert np.array_equal(sparse, dense)


@pytest.mark.slow
def test_the_report_counts_every_question_and_they_are_few():
    counted = CountedField(EllipsoidHead())
    # The box holds 512^3 cells of this size.
    _, report = extract_with_report(counted, ExtractConfig(cell_m=0.00093259))
    assert counted.evaluations == report.evaluations
    assert report.dense == pytest.approx(512**3, rel=0.01)
    assert report.evaluations < 512**3 / 50


@pytest.mark.parametrize("tolerance_mm", [0.08, pytest.param(0.02, marks=pytest.mark.slow)])
def test_the_tolerance_holds_where_the_cell_alone_does_not(tolerance_mm):
    config = ExtractConfig(tolerance_mm=tolerance_mm)
    mesh, report = extract_with_report(Field(two_balls), config)
    plain = extract_mesh(Field(two_balls), ExtractConfig(cell_m=cell_for(config)))
    # Where the slope is 0.7, |f| is that much less than the distance.
    limit = 0.7e-3 * tolerance_mm
    assert two_balls(torch.tensor(surface_samples(mesh, 50_000))).abs().max() <= limit
    assert two_balls(torch.tensor(surface_samples(plain, 50_000))).abs().max() > limit
    assert field_distance(Field(two_balls), mesh, samples=20_000).greatest <= 1e-3 * tolerance_mm
    assert report.split_vertices > 0
    shape = topology(mesh)
    assert shape.watertight
    assert (shape.pieces, shape.genus, shape.zero_area_faces, shape.nonmanifold_vertices) == (1, 0, 0, 0)


def septum(x):
    """A ball with two hollows 1.2 mm apart, a 2 mm lattice's planes on either side of the wall between them."""
    lattice = lattice_over_box(0.002, 0.016)
    middle = float(lattice.position(lattice.points // 2 + 0.5)[0])
    hollows = torch.stack([SphereHead(0.012, (middle + side * 0.0126, -0.03, 0.012)).sdf(x) for side in (-1, 1)])
    return torch.maximum(SPHERE.sdf(x), -hollows.amin(0))


def test_a_wall_thinner_than_the_cell_is_found_by_a_finer_one():
    coarse = extract_mesh(Field(septum), ExtractConfig(cell_m=0.002))
    assert topology(coarse).pieces == 2  # the ball and both hollows as one
    fine, lost = refine_mesh(Field(septum), coarse, 2e-4)
    assert lost > 0
    # What is lost is not split again and again: eight passes of it made 10,000 faces here.
    assert len(fine.faces) < 1.05 * len(coarse.faces)
    mesh, report = extract_with_report(Field(septum), ExtractConfig(tolerance_mm=0.2))
    assert (report.cell_m, report.lost_faces) == (0.001, 0)
    assert topology(mesh).pieces == 3
    assert field_distance(Field(septum), mesh).greatest <= 2e-4


@pytest.mark.slow
def test_what_no_cell_resolves_is_counted():
    def pinched(x):
        """Two hollows and the thinnest of walls."""
        return septum(x) + 0.00055

    report = extract_with_report(Field(pinched), ExtractConfig(tolerance_mm=0.2))[1]
    assert report.cell_m == 0.001
    assert report.lost_faces > 0


@pytest.mark.slow
def test_the_tolerance_holds_on_the_shipped_network():
    models = load_prior()
    head = FittedHead(models.shape, models.appearance, models.z_sdf.mean, models.z_a.mean, models.z_s.mean)
    mesh, report = extract_with_report(head, ExtractConfig(tolerance_mm=0.5))
    assert report.lost_faces == 0
    assert field_distance(head, mesh).greatest <= 5e-4
    assert topology(mesh).watertight


def test_tolerances_that_cannot_be_are_refused():
    for tolerance_mm in (0.0, -1.0, 1e-4, 10.0, float("nan")):
        with pytest.raises(InputError, match="tolerance"):
            ExtractConfig(tolerance_mm=tolerance_mm)
    with pytest.raises(InputError, match="larger tolerance"):
        refine_mesh(SPHERE, extract_mesh(SPHERE, ExtractConfig(cell_m=0.02)), 1e-5, max_triangles=3000)


@pytest.mark.parametrize("gain", [0.2, 1.0])
def test_splitting_knows_how_flat_the_field_is(ball, gain):
    # Half of 40 micrometres at a slope of 0.2 are 4 in |f|, the least that float32 lets be asked.
    fine, lost = refine_mesh(Field(lambda x: gain * SPHERE.sdf(x)), ball, 4e-5)
    assert not lost
    assert np.array_equal(fine.vertices[: len(ball.vertices)], ball.vertices)
    radius = np.linalg.norm(surface_samples(fine, 50_000) - SPHERE.centre_m, axis=1)
    assert np.abs(radius - 0.1).max() <= 4e-5
    assert topology(fine).watertight
    assert len(fine.faces) > len(ball.faces)


def test_a_surface_through_lattice_points_and_along_lattice_planes_is_sound():
    lattice = lattice_over_box(0.008, 0.016)
    low, high = lattice.position(np.array([[20, 20, 20], [36, 38, 34]]))
    centre, half = torch.tensor(0.5 * (low + high)), torch.tensor(0.5 * (high - low))

    def block(x):
        q = (x - centre).abs() - half
        return q.clamp_min(0).norm(dim=-1) + q.amax(-1).clamp_max(0)

    for config in (ExtractConfig(cell_m=0.008), ExtractConfig(cell_m=0.008, polish=False)):
        shape = topology(extract_mesh(Field(block), config))
        assert shape.watertight
        assert (shape.pieces, shape.genus, shape.zero_area_faces) == (1, 0, 0)


def test_distances_of_surfaces_a_millimetre_apart(ball):
    centre = np.array(SPHERE.centre_m)
    larger = TriangleMesh(centre + 1.01 * (ball.vertices - centre), ball.faces)
    # Triangles of edges up to e = sqrt(2) 6 mm lie e^2 / (6 r) = 0.12 mm within the sphere in their middle.
    gap = field_distance(SPHERE, larger, samples=5000)
    assert gap.mean_there == pytest.approx(1e-3, abs=1.2e-4)
    assert gap.greatest == pytest.approx(1e-3, abs=2e-6)  # at the vertices, by the polish's own tolerance
    both = mesh_distance(ball, larger, samples=5000)
    assert both.greatest == pytest.approx(1e-3, rel=0.01)  # vertices, radially
    assert both.mean_there == pytest.approx(1e-3, rel=0.01)


def test_distance_along_a_slanted_field_is_the_nearest_one():
    """A field whose normals do not point at the nearest surface: steps along them overshoot."""

    def sheared(x):
        return (x[:, 2] + 0.05) / (1 + 40 * x[:, 0].abs())

    corners = np.array([[-0.1, -0.1, -0.049], [0.1, -0.1, -0.049], [0.1, 0.1, -0.049], [-0.1, 0.1, -0.049]])
    sheet = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    # The zero set is the plane z = -50 mm, a millimetre below the sheet.
    assert field_distance(Field(sheared), sheet, samples=5000).greatest == pytest.approx(1e-3, abs=2e-5)


def test_simplified_to_a_tolerance_it_holds_with_far_fewer_triangles(ball):
    simple, gap = simplify_to_tolerance(ball, 4e-4)
    assert mesh_distance(ball, simple, seed=5).greatest <= 4.2e-4  # other random points: 5 % for what lies between
    assert gap.greatest <= 4e-4
    assert len(simple.faces) < 0.35 * len(ball.faces)
    assert topology(simple).watertight
    with pytest.raises(InputError, match="above 0"):
        simplify_to_tolerance(ball, 0.0)


def head_like():
    """A ball of radius 10 cm with waves of a millimetre, its front where the face is."""
    wavy = Field(lambda x: SphereHead(0.1, (0.0, -0.03, -0.08)).sdf(x) + 0.001 * torch.sin(400 * x).sum(-1))
    return extract_mesh(wavy, ExtractConfig(cell_m=0.004))


def test_weights_spend_triangles_on_eyes_and_lips():
    mesh = head_like()
    weight = head_importance(mesh)
    assert weight.min() >= 1.0
    eye = np.mean([CANONICAL_LANDMARKS_M["left_eye_inner"], CANONICAL_LANDMARKS_M["left_eye_outer"]], axis=0)
    mouth = np.mean([CANONICAL_LANDMARKS_M["mouth_left"], CANONICAL_LANDMARKS_M["mouth_right"]], axis=0)

    def near(vertices):
        return np.minimum(*(np.linalg.norm(vertices - at, axis=1) for at in (eye, mouth))) < 0.02

    assert near(mesh.vertices).sum() > 50
    error, count = [], []
    for importance in (np.ones_like(weight), weight):
        simple = simplify_mesh(mesh, 3000, importance=importance)
        assert len(simple.faces) <= 3000
        assert topology(simple).watertight
        gap = mesh_distance(TriangleMesh(mesh.vertices, mesh.faces[near(mesh.vertices)[mesh.faces].all(1)]), simple)
        error.append(gap.mean_there)
        count.append(near(simple.vertices).sum())
    assert count[1] > 1.3 * count[0]
    assert error[1] < 0.9 * error[0]


def test_levels_of_detail_have_a_quarter_of_the_triangles_each(ball):
    full = asset_mesh(ball, 4000)
    first, second = (level_of_detail(ball, full, k) for k in (1, 2))
    assert len(first.faces) == pytest.approx(1000, rel=0.05)
    assert len(second.faces) == pytest.approx(250, rel=0.05)
    assert topology(second).watertight


def test_faces_through_faces_are_counted(ball):
    assert not self_intersecting_faces(ball).any()
    apart = TriangleMesh(ball.vertices + np.array([0.05, 0.0, 0.0]), ball.faces)
    both = TriangleMesh(
        np.concatenate([ball.vertices, apart.vertices]), np.concatenate([ball.faces, apart.faces + len(ball.vertices)])
    )
    found = self_intersecting_faces(both)
    # They meet along a circle of radius sqrt(0.1^2 - 0.025^2): 0.6 m, through some 100 faces of 6 mm of each.
    assert 100 < found.sum() < 1000
    bent = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.02, 0.02, -0.05], [0.03, 0.02, 0.05], [0.02, 0.03, 0.05]])
    _, report = clean_with_report(ball)
    assert report.self_intersecting_faces == 0
    assert self_intersecting_faces(TriangleMesh(bent, np.array([[0, 1, 2], [3, 4, 5]]))).all()
