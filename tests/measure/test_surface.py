"""Point-to-triangle distances: exact cases, closed forms, invariance, and no floor from tessellation or sampling."""

import numpy as np
import pytest
from shapes import sagitta, sphere

from sira_assets.errors import InputError
from sira_assets.measure.surface import Surface, nearest_on_triangles, sample_surface, summarise
from sira_assets.mesh.triangle_mesh import TriangleMesh


def test_nearest_point_is_nearest_of_a_dense_grid_on_the_triangle():
    rng = np.random.default_rng(0)
    p, a, b, c = rng.normal(size=(4, 200, 3))
    q = nearest_on_triangles(p, a, b, c)
    w = rng.dirichlet([0.5, 0.5, 0.5], size=4000)
    grid = np.einsum("kw,wnx->nkx", w, np.stack([a, b, c]))
    best = np.linalg.norm(grid - p[:, None], axis=2).min(1)
    found = np.linalg.norm(q - p, axis=1)
    assert (found <= best + 1e-12).all()  # nothing on the triangle is nearer
    # q is a point of the triangle: its barycentric coordinates are inside (rounding of a 3x3 solve).
    for i in range(200):
        weights = np.linalg.lstsq(np.c_[np.stack([a[i], b[i], c[i]], 1).T, np.ones(3)].T, np.r_[q[i], 1], rcond=None)[0]
        assert weights.min() > -1e-9
        assert weights.sum() == pytest.approx(1, abs=1e-9)


def test_degenerate_triangles_are_segments_and_points():
    zero, one = np.zeros((1, 3)), np.array([[1.0, 0, 0]])
    p = np.array([[0.25, 3.0, 0.0]])
    assert nearest_on_triangles(p, zero, one, one) == pytest.approx(np.array([[0.25, 0, 0]]), abs=1e-15)
    assert nearest_on_triangles(p, zero, zero, zero) == pytest.approx(zero, abs=0)


def test_identical_meshes_are_at_distance_zero():
    mesh = sphere(level=3)
    points = sample_surface(mesh, 5000, seed=0).points
    # Coordinates of 0.1 m are rounded to 1e-17 m; a few of those roundings, in millimetres.
    assert summarise(Surface(mesh).distance(points)).max_mm < 1e-12
    assert summarise(Surface(mesh).distance(mesh.vertices)).max_mm < 1e-12


def test_one_sphere_at_two_levels_differs_by_the_sagitta_only():
    coarse, fine = sphere(0.1, 2), sphere(0.1, 5)
    bound = sagitta(0.1, coarse)
    for a, b in ((coarse, fine), (fine, coarse)):
        d = Surface(b).distance(sample_surface(a, 4000, seed=1).points)
        assert d.max() <= bound * (1 + 1e-6)
    # Depth under a sphere falls off with the square of the distance from a face's centre: its mean over an equilateral
    # triangle is 3/4 of the sagitta. Between samples of equal meshes at this density one would read 2.8 mm instead.
    assert summarise(d).mean_mm < 0.75 * bound * 1e3


def test_concentric_sphere_is_away_by_the_difference_of_radii():
    inner, outer = sphere(0.1, 5), sphere(0.103, 5)
    there = summarise(Surface(outer).distance(sample_surface(inner, 4000, seed=0).points))
    slack = 1e3 * (sagitta(0.1, inner) + sagitta(0.103, outer))
    assert there.mean_mm == pytest.approx(3.0, abs=slack)
    assert there.max_mm <= 3.0 + slack
    assert there.std_mm < slack


def test_shifted_sphere_has_the_closed_form_mean():
    # |R - |R n - e|| over the sphere: for a small shift e the mean of |e cos t| is e / 2, up to e^2 / R.
    shift = 1e-3
    mesh = sphere(0.1, 5)
    moved = sphere(0.1, 5, centre=(0, 0, shift))
    d = summarise(Surface(moved).distance(sample_surface(mesh, 20_000, seed=0).points))
    tolerance = shift**2 / 0.1 + 2 * sagitta(0.1, mesh) + 4 * 0.29 * shift / np.sqrt(20_000)  # + 4 sigma of the mean
    assert d.mean_mm * 1e-3 == pytest.approx(shift / 2, abs=tolerance)


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (1e4, 1.0), (0.0, 1e-4), (0.0, 1e5)])
def test_distance_does_not_depend_on_place_or_unit(offset, scale):
    a, b = sphere(0.1, 3), sphere(0.11, 3)
    points = sample_surface(a, 1000, seed=0).points
    expected = Surface(b).distance(points)
    moved = Surface(TriangleMesh(b.vertices * scale + offset, b.faces))
    # float64 spacing at 1e4 is 2e-12; relative 1e-6 allows a float32 choice between neighbouring faces.
    np.testing.assert_allclose(moved.distance(points * scale + offset), expected * scale, rtol=1e-6, atol=1e-11)


def test_samples_are_uniform_by_area_and_seeded():
    # Two squares, one of four times the area: the counts are 1 : 4 to one sample, since they are stratified.
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    vertices = np.concatenate([square, 2 * square + [5, 0, 0]])
    mesh = TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    samples = sample_surface(mesh, 10_000, seed=3)
    assert abs((samples.points[:, 0] < 2).sum() - 2000) <= 1
    # The mean of uniform points is the centroid; 4 sigma of 8000 points on a side of 2.
    big = samples.points[samples.points[:, 0] > 2]
    assert big.mean(0) == pytest.approx([6, 1, 0], abs=4 * 2 / np.sqrt(12 * 8000))
    assert np.array_equal(samples.points, sample_surface(mesh, 10_000, seed=3).points)
    assert not np.array_equal(samples.points, sample_surface(mesh, 10_000, seed=4).points)


def test_no_surface_is_said():
    flat = TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="no area"):
        sample_surface(flat, 10, seed=0)
    with pytest.raises(InputError, match="triangles"):
        Surface(TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), int)))
    assert summarise(np.zeros(0)) is None
