"""Which faces see the outside."""

import numpy as np
from shapes import sphere

from sira_assets.measure.outer_surface import OuterSurfaceConfig, fibonacci_directions, outer_faces, outer_surface
from sira_assets.mesh.triangle_mesh import TriangleMesh


def _joined(a, b):
    return TriangleMesh(np.r_[a.vertices, b.vertices], np.r_[a.faces, b.faces + len(a.vertices)])


def test_directions_are_unit_and_balanced():
    w = fibonacci_directions(96)
    assert np.abs(np.linalg.norm(w, axis=1) - 1).max() < 1e-12
    # The mean of evenly spread directions vanishes, and their second moment is a third of the identity; 96 points.
    assert np.linalg.norm(w.mean(0)) < 0.01
    assert np.abs(w.T @ w / 96 - np.eye(3) / 3).max() < 0.01


def test_a_shell_inside_a_shell_is_left_out():
    outside, inside = sphere(0.1, 3), sphere(0.05, 3)
    keep = outer_faces(_joined(outside, inside))
    assert keep[: len(outside.faces)].all()
    assert not keep[len(outside.faces) :].any()
    left = outer_surface(_joined(outside, inside))
    assert np.array_equal(left.vertices[left.faces], outside.vertices[outside.faces])


def test_orientation_and_size_do_not_matter():
    mesh = sphere(0.1, 2)
    assert outer_faces(TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])).all()
    assert outer_faces(TriangleMesh(mesh.vertices * 1e4 + 5e4, mesh.faces)).all()


def test_an_open_sheet_keeps_every_face():
    mesh = sphere(0.1, 3)
    cap = mesh.faces[mesh.vertices[mesh.faces][:, :, 2].min(1) > 0]
    assert outer_faces(TriangleMesh(mesh.vertices, cap)).all()


def test_a_bag_seen_through_an_open_bottom_is_inner():
    """An open-bottomed ball with a ball inside: the inner one sees out through the hole, until the hole is closed."""
    outside = sphere(0.1, 3)
    centroid = outside.vertices[outside.faces].mean(1)
    bust = TriangleMesh(outside.vertices, outside.faces[centroid[:, 1] > -0.08])
    inside = sphere(0.03, 2)
    joined = _joined(bust, inside)
    inner = np.arange(len(joined.faces)) >= len(bust.faces)
    closed = outer_faces(joined)
    assert closed[~inner].all()
    assert not closed[inner].any()
    assert outer_faces(joined, OuterSurfaceConfig(close_openings=False))[inner].any()
