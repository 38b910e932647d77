"""Known motions come back; failures are noticed."""

import numpy as np
import pytest
from shapes import bumpy, motion, sphere

from sira_assets.measure.alignment import AlignmentConfig, align, landmark_start
from sira_assets.measure.surface import sample_surface
from sira_assets.mesh.triangle_mesh import TriangleMesh


@pytest.fixture(scope="module")
def gt() -> TriangleMesh:
    return bumpy(4)


@pytest.fixture(scope="module")
def targets(gt) -> np.ndarray:
    points = sample_surface(gt, 12_000, seed=0).points
    return points[points[:, 2] > 0]  # a face, not the whole head


def test_none_moves_nothing_and_never_fails(gt, targets):
    found = align(gt.transformed(motion([0, 0, 1], [0.5, 0, 0])), targets, AlignmentConfig("none"))
    assert np.array_equal(found.gt_from_pred, np.eye(4))
    assert found.ok


@pytest.mark.parametrize(
    ("kind", "scale"), [("rigid", 1.0), ("similarity", 1.0), ("similarity", 1.08), ("similarity", 0.93)]
)
def test_known_motion_is_recovered(gt, targets, kind, scale):
    known = motion([0.05, -0.08, 0.04], [0.004, -0.006, 0.003], scale)
    found = align(gt.transformed(np.linalg.inv(known)), targets, AlignmentConfig(kind))
    assert found.ok, found.problems
    # Convergence is declared at 0.1 micrometre of rms; the basin is quadratic, so the motion is good to about that.
    np.testing.assert_allclose(found.gt_from_pred, known, atol=1e-5)
    assert found.rms_mm < 1e-3
    assert found.scale == pytest.approx(scale, abs=1e-5)


def test_rigid_keeps_the_size(gt, targets):
    found = align(TriangleMesh(gt.vertices * 1.03, gt.faces), targets, AlignmentConfig("rigid"))
    assert found.scale == pytest.approx(1.0, abs=1e-12)
    assert found.rms_mm < found.rms_given_mm


def test_residual_never_grows_and_outliers_are_trimmed(gt, targets):
    known = motion([0.03, 0.05, -0.02], [0.003, 0.002, -0.004])
    spoiled = targets.copy()
    spoiled[::20] += 0.05  # 5 % of wild points, within the 10 % that `keep` leaves out
    found = align(gt.transformed(np.linalg.inv(known)), spoiled, AlignmentConfig("rigid"))
    assert found.rms_mm <= found.rms_start_mm
    np.testing.assert_allclose(found.gt_from_pred, known, atol=2e-4)  # trimmed, so bias stays under 0.2 mm


def test_landmarks_bring_a_far_prediction_home(gt, targets):
    known = motion([0.2, 2.5, 0.1], [0.3, -1.0, 2.0], 1.1)
    pred = gt.transformed(np.linalg.inv(known))
    index = np.linspace(0, len(gt.vertices) - 1, 7).astype(int)
    start = landmark_start(pred.vertices[index], gt.vertices[index], "similarity")
    found = align(pred, targets, AlignmentConfig("similarity"), start=start, start_name="landmarks (7)")
    assert found.ok, found.problems
    np.testing.assert_allclose(found.gt_from_pred, known, atol=1e-5)


def test_vertices_as_the_target(gt, targets):
    known = motion([0.01, 0.02, 0.0], [0.001, 0.0, 0.001])
    found = align(
        gt.transformed(np.linalg.inv(known)), gt.vertices, AlignmentConfig("rigid", nearest="vertex", keep=1.0)
    )
    np.testing.assert_allclose(found.gt_from_pred, known, atol=1e-9)  # pairs become exact, so the last step is


def _said(found) -> str:
    assert not found.ok
    return "; ".join(found.problems)


def test_wrong_units_are_noticed(gt, targets):
    found = align(TriangleMesh(gt.vertices * 1.6, gt.faces), targets, AlignmentConfig("similarity"))
    assert "scale 0.6" in _said(found)


def test_too_few_inliers_are_noticed(targets):
    found = align(sphere(0.02, 3), targets, AlignmentConfig("rigid"))
    assert "within 5 mm" in _said(found)


def test_stopping_early_is_noticed(gt, targets):
    known = motion([0.1, 0.1, 0], [0.01, 0, 0])
    found = align(gt.transformed(known), targets, AlignmentConfig("rigid", iterations=1))
    assert "not converged" in _said(found)


def test_landmarks_that_mislead_are_noticed(gt, targets):
    # Turned by half a turn about y: ICP ends in a wrong basin, worse than where the mesh stood.
    found = align(
        gt, targets, AlignmentConfig("rigid"), start=motion([0, np.pi, 0], [0, 0, 0]), start_name="landmarks (3)"
    )
    assert "residual grew" in _said(found)


def test_a_sphere_that_may_spin_does_not_spin():
    mesh = sphere(0.1, 4)
    points = sample_surface(sphere(0.1, 4, centre=(0, 0, 0.003)), 4000, seed=0).points
    found = align(mesh, points, AlignmentConfig("rigid"))
    assert found.shift_mm == pytest.approx(3.0, abs=0.05)  # the sagitta of both is 0.03 mm
    assert found.rotation_deg < 2.0
