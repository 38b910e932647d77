"""Topology, cleaning, simplification, projection and ray casting on meshes whose answers are known."""

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.fields.analytic import EllipsoidHead, SphereHead
from sira_assets.mesh import simplify
from sira_assets.mesh.clean import CleanConfig, clean_mesh, clean_with_report
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.project import ProjectConfig, project_mesh, project_points
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.simplify import barycentric, flipped_faces, simplify_mesh
from sira_assets.mesh.topology import nonmanifold_vertices, topology
from sira_assets.mesh.triangle_mesh import TriangleMesh, vertex_normals

TETRAHEDRON = TriangleMesh(
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
)


@pytest.fixture(scope="module")
def ellipsoid():
    return extract_mesh(EllipsoidHead(), ExtractConfig(cell_m=0.005))


def join(*meshes):
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes])
    return TriangleMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=False)]),
    )


def torus(rings=24, sides=12):
    u, v = np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij")
    a, b = 2 * np.pi * u / rings, 2 * np.pi * v / sides
    reach = 0.1 + 0.03 * np.cos(b)
    points = np.stack([reach * np.cos(a), reach * np.sin(a), 0.03 * np.sin(b)], -1).reshape(-1, 3)
    here, over = u * sides + v, (u + 1) % rings * sides + v
    above, across = u * sides + (v + 1) % sides, (u + 1) % rings * sides + (v + 1) % sides
    faces = np.stack([here, over, across, here, across, above], -1).reshape(-1, 3)
    return TriangleMesh(points, faces)


def test_topology_of_known_shapes():
    assert (topology(TETRAHEDRON).watertight, topology(TETRAHEDRON).genus) == (True, 0)
    assert (topology(torus()).watertight, topology(torus()).genus) == (True, 1)
    assert topology(join(TETRAHEDRON, torus())).genus == 1
    opened = topology(TriangleMesh(TETRAHEDRON.vertices, TETRAHEDRON.faces[1:]))
    assert (opened.boundary_edges, opened.watertight) == (3, False)
    turned = TETRAHEDRON.faces.copy()
    turned[0] = turned[0][::-1]
    assert topology(TriangleMesh(TETRAHEDRON.vertices, turned)).misoriented_edges == 3


def test_two_fans_at_one_vertex_are_seen_and_split():
    mirrored = TriangleMesh(-TETRAHEDRON.vertices, TETRAHEDRON.faces[:, ::-1])
    vertices = np.concatenate([TETRAHEDRON.vertices, mirrored.vertices[1:]])
    touching = TriangleMesh(
        vertices, np.concatenate([TETRAHEDRON.faces, np.where(mirrored.faces, mirrored.faces + 3, 0)])
    )
    assert nonmanifold_vertices(touching).tolist() == [0]
    clean, report = clean_with_report(touching)
    assert report.repaired_nonmanifold
    assert topology(clean).nonmanifold_vertices == 0


def test_clean_leaves_a_clean_mesh_alone(ellipsoid):
    clean, report = clean_with_report(ellipsoid)
    assert np.array_equal(clean.vertices, ellipsoid.vertices)
    assert np.array_equal(clean.faces, ellipsoid.faces)
    assert (report.dropped_faces, report.dropped_pieces) == (0, 0)
    assert (report.repaired_nonmanifold, report.closed_holes) == (False, False)


def test_clean_drops_floaters_cavities_copies_and_flat_faces(ellipsoid):
    floater = TriangleMesh(0.01 * TETRAHEDRON.vertices + 0.2, TETRAHEDRON.faces)
    inner = extract_mesh(SphereHead(0.06, (0.0, -0.01, -0.07)), ExtractConfig(cell_m=0.01))
    cavity = TriangleMesh(inner.vertices, inner.faces[:, ::-1])
    dirty = join(ellipsoid, floater, cavity)
    dirty = TriangleMesh(dirty.vertices, np.concatenate([dirty.faces, dirty.faces[:5], [[3, 3, 4], [7, 8, 8]]]))
    clean, report = clean_with_report(dirty)
    assert len(clean.faces) == len(ellipsoid.faces)
    assert (report.dropped_faces, report.dropped_pieces) == (7, 2)
    assert report.result.watertight


def test_unwelded_soup_is_welded(ellipsoid):
    soup = TriangleMesh(
        ellipsoid.vertices[ellipsoid.faces].reshape(-1, 3), np.arange(ellipsoid.faces.size).reshape(-1, 3)
    )
    assert topology(clean_mesh(soup)).watertight


def test_holes_are_closed_or_left(ellipsoid):
    torn = TriangleMesh(ellipsoid.vertices, ellipsoid.faces[12:])
    assert topology(clean_mesh(torn)).watertight
    assert topology(clean_mesh(torn, CleanConfig(close_holes_of=0))).boundary_edges > 0


def test_a_fin_on_an_edge_is_removed(ellipsoid):
    a, b = ellipsoid.faces[100, :2]
    fin = np.array([[a, b, len(ellipsoid.vertices)]])
    tip = ellipsoid.vertices[a] + 0.001 * ellipsoid.normals[a]
    clean, report = clean_with_report(
        TriangleMesh(np.vstack([ellipsoid.vertices, tip]), np.concatenate([ellipsoid.faces, fin]))
    )
    assert report.repaired_nonmanifold
    assert report.result.watertight
    assert report.result.nonmanifold_vertices == 0
    assert len(clean.faces) == pytest.approx(len(ellipsoid.faces), abs=4)


def test_open_bust_opens_only_the_cap():
    cut = extract_mesh(SphereHead(0.15, (0.0, -0.25, -0.05)), ExtractConfig(cell_m=0.01))
    opened = clean_mesh(cut, CleanConfig(open_bust=True))
    assert topology(cut).watertight
    assert 0 < topology(opened).boundary_edges < 150
    assert topology(opened).pieces == 1


def test_a_mesh_of_nothing_is_refused():
    with pytest.raises(InputError, match="none usable"):
        clean_mesh(TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))


@pytest.mark.parametrize("target", [6000, 1000])
def test_simplified_mesh_keeps_shape_topology_and_normals(ellipsoid, target):
    simple = simplify_mesh(ellipsoid, target)
    assert len(simple.faces) <= target
    shape = topology(simple)
    assert shape.watertight
    assert (shape.genus, shape.zero_area_faces, shape.nonmanifold_vertices) == (0, 0, 0)
    distance = Raycaster(ellipsoid).closest(simple.vertices).distance
    # A chord of edge e on radius r sags e^2/(8 r): 1000 faces on 0.11 m^2 have e = 16 mm, so 0.4 mm; twice for shape.
    assert distance.max() < 0.8e-3
    exact = EllipsoidHead()
    gradient = (simple.vertices - np.array(exact.centre_m)) / np.array(exact.radii_m) ** 2
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert (simple.normals * gradient).sum(1).min() > 0.98


@pytest.mark.parametrize("weighed", [False, True])
def test_an_open_mesh_stays_open(ellipsoid, weighed):
    upper = ellipsoid.vertices[ellipsoid.faces].mean(1)[:, 1] > -0.06
    opened = clean_mesh(TriangleMesh(ellipsoid.vertices, ellipsoid.faces[upper]), CleanConfig(close_holes_of=0))
    simple = simplify_mesh(opened, 600, importance=np.ones(len(opened.vertices)) if weighed else None)
    assert len(simple.faces) <= 660
    shape = topology(simple)
    # A disc: one rim, of no more edges than before.
    assert (shape.pieces, shape.euler) == (1, 1)
    assert 0 < shape.boundary_edges <= topology(opened).boundary_edges
    down = Raycaster(simple).occluded(np.array([[0.0, 0.0, -0.07]]), np.array([0.0, -1.0, 0.0]))
    assert not down.any()


def test_many_times_the_triangles_are_worse_than_a_face_that_looks_aside(ellipsoid, monkeypatch):
    simple = simplify_mesh(ellipsoid, 1000)
    # A corner pushed through the far wall of the ellipsoid: its faces look back, the mesh stays one closed surface.
    vertices = simple.vertices.copy()
    vertices[0] = -0.9 * vertices[0]
    aside, gentle = (vertices, simple.faces), (ellipsoid.vertices, ellipsoid.faces)
    monkeypatch.setattr(simplify, "_fast", lambda aggressiveness: lambda mesh, count: aside)
    monkeypatch.setattr(simplify, "_open3d", lambda mesh, count: gentle)
    coarse = TriangleMesh(*aside)
    assert flipped_faces(coarse, ellipsoid, Raycaster(ellipsoid)).any()
    assert len(simplify_mesh(ellipsoid, 1000).faces) == len(simple.faces)


def test_simplify_returns_small_meshes_as_they_are_and_refuses_nonsense(ellipsoid):
    assert simplify_mesh(TETRAHEDRON, 100) is TETRAHEDRON
    with pytest.raises(InputError, match="at least 4"):
        simplify_mesh(ellipsoid, 3)


def test_vertex_normals_weigh_faces_by_their_angles():
    """A box's corner, its sides split either way, has the diagonal; what has no normal gets (0, 0, 1)."""
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [9, 9, 9], [2, 0, 0]], float)
    faces = np.array([[0, 1, 4], [0, 4, 2], [0, 2, 3], [0, 3, 1], [0, 1, 6]])  # the last of no area
    expected = np.full(3, 3**-0.5)
    for scale in (1.0, 1e-9, 1e-50):  # in any unit of length
        normals = vertex_normals(scale * corner, faces)
        np.testing.assert_allclose(normals[0], expected, atol=1e-14)
        np.testing.assert_array_equal(normals[5:], [[0, 0, 1]] * 2)
    np.testing.assert_array_equal(vertex_normals(corner, faces[:0]), [[0, 0, 1]] * 7)
    np.testing.assert_allclose(vertex_normals(corner, faces[:, ::-1])[0], -expected, atol=1e-14)


def test_projection_reaches_the_zero_set_within_its_limit():
    rng = np.random.default_rng(0)
    direction = rng.standard_normal((500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    sphere = SphereHead()
    start = np.array(sphere.centre_m) + direction * rng.uniform(0.098, 0.102, (500, 1))
    moved = project_points(sphere, start)
    assert np.abs(moved.residual_m).max() < 2.1e-6
    assert np.abs(moved.normals - direction).max() < 1e-4
    far = project_points(sphere, np.array(sphere.centre_m) + 0.12 * direction)
    # 20 mm away and allowed 3 mm: 17 mm stay.
    assert np.abs(far.residual_m - 0.017).max() < 1e-5


@pytest.mark.parametrize("gain", [0.5, 2.5])
def test_projection_copes_with_a_field_that_is_not_a_distance(gain):
    class Scaled:
        def sdf(self, x):
            return gain * SphereHead().sdf(x)

    rng = np.random.default_rng(1)
    direction = rng.standard_normal((200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    start = np.array(SphereHead().centre_m) + 0.101 * direction
    moved = project_points(Scaled(), start, ProjectConfig(iterations=6))
    assert np.abs(SphereHead().sdf(torch.tensor(moved.points)).numpy()).max() < 5e-6


def test_projected_mesh_keeps_fixed_vertices_and_orientation(ellipsoid):
    simple = simplify_mesh(ellipsoid, 800)
    fixed = np.zeros(len(simple.vertices), bool)
    fixed[:10] = True
    moved = project_mesh(EllipsoidHead(), simple, fixed=fixed)
    assert np.array_equal(moved.vertices[:10], simple.vertices[:10])
    assert topology(moved).watertight
    residual = np.abs(EllipsoidHead().sdf(torch.tensor(moved.vertices[10:])).numpy())
    assert residual.max() < 2.1e-5  # ten times the projection's tolerance, beyond which a vertex stays behind


def test_rays_and_closest_points_on_a_tetrahedron():
    caster = Raycaster(TETRAHEDRON)
    origins = np.array([[0.2, 0.3, -1.0], [0.2, 0.3, 5.0], [2.0, 2.0, 2.0]])
    hits = caster.cast(origins, np.array([0.0, 0.0, 2.0]))
    assert hits.hit.tolist() == [True, False, False]
    assert hits.t[0] == pytest.approx(0.5, abs=1e-6)  # in units of |direction|; single precision
    point = (hits.barycentric[0, :, None] * TETRAHEDRON.vertices[TETRAHEDRON.faces[hits.face[0]]]).sum(0)
    assert np.abs(point - [0.2, 0.3, 0.0]).max() < 1e-6
    assert caster.occluded(origins, np.array([0.0, 0.0, 1.0])).tolist() == [True, False, False]
    near = caster.closest(np.array([[-0.5, 0.2, 0.2], [1.0, 1.0, 1.0]]))
    assert np.abs(near.points - [[0.0, 0.2, 0.2], [1 / 3, 1 / 3, 1 / 3]]).max() < 1e-6
    assert near.distance == pytest.approx([0.5, 2 / np.sqrt(3)], abs=1e-6)


def test_ray_casting_is_as_exact_far_from_the_origin():
    away = TriangleMesh(TETRAHEDRON.vertices + 1000.0, TETRAHEDRON.faces)
    hits = Raycaster(away).cast(np.array([[1000.2, 1000.3, 999.0]]), np.array([0.0, 0.0, 1.0]))
    assert hits.t[0] == pytest.approx(1.0, abs=1e-6)


def test_barycentric_weights_rebuild_the_point():
    rng = np.random.default_rng(2)
    triangles, weights = rng.standard_normal((100, 3, 3)), rng.dirichlet(np.ones(3), 100)
    points = (triangles * weights[..., None]).sum(1)
    assert np.abs(barycentric(points, triangles) - weights).max() < 1e-9
    assert barycentric(np.zeros((1, 3)), np.zeros((1, 3, 3))) == pytest.approx(1 / 3)
