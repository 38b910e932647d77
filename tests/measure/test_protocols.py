"""The three protocols on shapes with known distances, and on real heads."""

import numpy as np
import pytest
from shapes import bumpy, motion, sagitta, sphere

from sira_assets.errors import InputError
from sira_assets.measure.protocols import (
    GT_TO_PRED,
    PRED_TO_GT,
    ProtocolConfig,
    measure_prepared,
    measure_surface,
    without_inner,
)
from sira_assets.measure.regions import in_head, now_disc, seen_by
from sira_assets.measure.surface import Surface
from sira_assets.measure.truth import Truth, read_mesh, read_truth
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

NINE = {name: np.array(x) for name, x in CANONICAL_LANDMARKS_M.items()}
FAST = ProtocolConfig(samples=8000, leave_out_inner=False)  # balls have no inside


def ball(radius: float, level: int = 4) -> TriangleMesh:
    """A ball behind the canonical face: the nose tip lies on it when its radius is 0.1."""
    return sphere(radius, level, centre=(0.0, -0.031645, 0.045626 - 0.1))


def camera() -> Camera:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0, -0.03, 1.0]
    return Camera(np.array([[500.0, 0, 128], [0, 500.0, 128], [0, 0, 1]]), pose, 256, 256)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth(ball(0.1), NINE, np.eye(4), camera())


def test_a_larger_ball_is_away_by_the_difference_in_every_region(truth):
    report = measure_surface(ball(0.102), truth, FAST)
    slack = 1e3 * 2 * sagitta(0.1, sphere(0.1, 4))
    for region in ("face", "head", "all"):
        for direction in (GT_TO_PRED, PRED_TO_GT):
            assert report.distances(region, direction).mean_mm == pytest.approx(2.0, abs=slack)
    assert report.distances("face").samples < report.distances("all").samples


def test_seen_and_unseen_part_the_samples(truth):
    report = measure_surface(ball(0.102), truth, FAST)
    whole, seen, unseen = (report.distances("all", seen=s).samples for s in ("any", "seen", "unseen"))
    assert seen + unseen == whole
    # A camera at distance d from the centre sees (1 - R / d) / 2 of a ball; 1 % covers the 2 mm tolerance at the rim.
    d = 1.0 - (0.045626 - 0.1)
    assert seen / whole == pytest.approx((1 - 0.1 / d) / 2, abs=0.02)


def test_outside_the_picture_is_not_seen(truth):
    surface = Surface(truth.mesh)
    front = np.array([[0.0, -0.031645, 0.045626]])
    assert seen_by(camera(), front, surface).all()
    narrow = Camera(np.array([[500.0, 0, 1128], [0, 500.0, 128], [0, 0, 1]]), camera().world_from_camera, 256, 256)
    assert not seen_by(narrow, front, surface).any()


def test_head_ends_between_chin_and_neck():
    chin = np.array(CANONICAL_LANDMARKS_M["chin"])
    points = np.array([chin, chin - [0, 0.03, 0], chin - [0, 0.03, 0.1], [0.0, 0.1, -0.1]])
    assert in_head(points, np.eye(4)).tolist() == [True, False, False, True]


def test_regions_that_cannot_be_told_are_left_out():
    report = measure_surface(ball(0.102), Truth(ball(0.1)), FAST)
    assert {m.region for m in report.measured} == {"all"}
    assert report.distances("face") is None


def test_alignment_removes_a_known_motion():
    gt = bumpy(4)
    pred = gt.transformed(motion([0.03, -0.02, 0.05], [0.003, 0.002, -0.004]))
    placed = measure_surface(pred, Truth(gt), FAST).distances("all").mean_mm
    report = measure_surface(pred, Truth(gt), ProtocolConfig(align="rigid", samples=8000))
    assert placed > 1.0
    assert report.alignment.ok
    assert report.distances("all").mean_mm < 1e-3


def test_inner_surfaces_are_left_out_unless_asked_for(truth):
    inner = ball(0.05, 3)
    both = TriangleMesh(
        np.r_[truth.mesh.vertices, inner.vertices], np.r_[truth.mesh.faces, inner.faces + len(truth.mesh.vertices)]
    )
    without = measure_surface(truth.mesh, Truth(both, NINE, np.eye(4)), ProtocolConfig(samples=8000))
    assert without.distances("all").max_mm < 1e-6
    kept = measure_surface(
        truth.mesh, Truth(both, NINE, np.eye(4)), ProtocolConfig(samples=8000, leave_out_inner=False)
    )
    assert kept.distances("all").max_mm == pytest.approx(50.0, abs=0.2)


def test_h3ds_is_vertex_to_vertex(truth):
    coarse = ball(0.1, 2)
    report = measure_surface(coarse, truth, ProtocolConfig("h3ds", "none"))
    # An icosphere's vertices are among the finer one's: 0 from pred to gt, millimetres the other way. That is what this
    # protocol costs, and why it is not the default.
    assert report.distances("all", PRED_TO_GT).max_mm < 1e-9
    assert report.distances("all", GT_TO_PRED).mean_mm > 3.0  # level 2 has edges of 30 mm


def test_h3ds_recovers_scale_from_vertices(truth):
    pred = truth.mesh.transformed(motion([0, 0, 0], [0.001, 0, 0], 1.01))
    report = measure_surface(pred, truth, ProtocolConfig("h3ds"), pred_landmarks={})
    assert report.alignment.kind == "similarity"
    assert report.alignment.scale == pytest.approx(1 / 1.01, abs=2e-3)


def test_now_disc_has_the_published_size():
    centre, radius = now_disc(NINE)
    # By hand from the canonical landmarks: outer eye distance 87.92 mm, bridge to base 49.76 mm.
    assert radius == pytest.approx(1.4 * (0.08792 + np.hypot(0.043925, 0.023366)) / 2, abs=1e-5)
    assert centre[1] == pytest.approx(-0.04751 + 0.3 * 0.043925, abs=1e-5)


def test_now_takes_landmarks_and_scale_out():
    gt = bumpy(5)
    marks = {
        name: gt.vertices[i] for name, i in zip(NINE, (50, 900, 2000, 3100, 4100, 5200, 6300, 7400, 8500), strict=True)
    }
    # The five that set the disc must span a face: put them where a face has them.
    known = motion([0.1, 1.2, 0.0], [0.2, 0.1, 0.0], 0.95)
    moved = {name: np.linalg.inv(known)[:3, :3] @ x + np.linalg.inv(known)[:3, 3] for name, x in marks.items()}
    pred = gt.transformed(np.linalg.inv(known))
    report = measure_surface(pred, Truth(gt, marks), ProtocolConfig("now"), pred_landmarks=moved)
    assert report.alignment.ok, report.alignment.problems
    assert report.alignment.start == "landmarks (7)"
    assert report.distances("now disc").max_mm < 0.01


def test_now_says_what_it_lacks(truth):
    with pytest.raises(InputError, match="nose base"):
        measure_surface(ball(0.1), Truth(ball(0.1)), ProtocolConfig("now"))
    with pytest.raises(InputError, match="similarity"):
        measure_surface(ball(0.1), truth, ProtocolConfig("now", "rigid"))


@pytest.mark.parametrize(
    ("protocol", "mesh", "marks"),
    [("surface", 1e3, 1), ("surface", 1, 1e3), ("h3ds", 1e3, 1), ("h3ds", 1, 1e3), ("now", 1e3, 1)],
)
def test_landmarks_in_another_unit_than_the_mesh_are_said(truth, protocol, mesh, marks):
    wrong = Truth(truth.mesh.transformed(np.diag([mesh, mesh, mesh, 1.0])), {k: marks * x for k, x in NINE.items()})
    with pytest.raises(InputError, match="frame and unit"):
        measure_surface(ball(0.1), wrong, ProtocolConfig(protocol, samples=1000, leave_out_inner=False))


@pytest.mark.parametrize("protocol", ["surface", "h3ds"])
def test_a_canonical_frame_elsewhere_is_said(truth, protocol):
    below = np.eye(4)
    below[1, 3] = -1.0
    with pytest.raises(InputError, match=r"region head.*frame and unit"):
        measure_surface(
            ball(0.1), Truth(truth.mesh, {}, below), ProtocolConfig(protocol, samples=1000, leave_out_inner=False)
        )


def test_every_choice_is_named(truth):
    for protocol in ("surface", "h3ds", "now"):
        names = [c.name for c in measure_surface(ball(0.1, 3), truth, ProtocolConfig(protocol, samples=1000)).choices]
        assert len(names) == len(set(names))
        assert {"protocol", "alignment", "alignment start", "region", "distance", "samples", "inner surfaces"} <= set(
            names
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("head", "placed", "after_icp"), [("james", 1.58, 1.42), ("ict_a", 1.17, 0.92), ("ict_d", 1.45, 1.14)]
)
def test_mean_head_scores_what_an_independent_measure_says(real_data, head, placed, after_icp):
    truth = read_truth(real_data / "scenes" / f"{head}_soft")
    mean = read_mesh(real_data / "heads" / "ict_mean").transformed(np.linalg.inv(truth.canonical_from_world))
    # The published figures have two decimals and their own sampling noise (9,500 samples of std 0.8: 0.01); which
    # half-hidden faces count differs by the directions drawn, worth another 0.01.
    # The published figures let rays out through the open bottom of the bust.
    mean, truth = without_inner(mean, truth, ProtocolConfig(close_openings=False))
    assert measure_prepared(mean, truth).distances("face").mean_mm == pytest.approx(placed, abs=0.02)
    report = measure_prepared(mean, truth, ProtocolConfig(align="rigid"))
    assert report.alignment.ok
    assert report.distances("face").mean_mm == pytest.approx(after_icp, abs=0.03)
