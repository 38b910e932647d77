"""How far a predicted surface is from the true one, by three named protocols.

`surface` point to triangle on area-uniform samples of the outer surface, both directions, by region and by whether the
          input camera sees it. What this project reports.
`h3ds`    the public evaluation of H3DS (Ramon et al. 2021, DOI 10.1109/ICCV48922.2021.00557): landmark Procrustes where
          landmarks of the prediction are given, ICP on the face, nearest vertex from each true vertex to the
          prediction and back.
`now`     NoW (Sanyal et al. 2019, DOI 10.1109/CVPR.2019.00795): a disc around the nose, seven-landmark Procrustes,
refined
          scale, rotation and translation from scan to mesh; distance of each scan vertex to the mesh.
A result names every choice it rests on, and a failed alignment says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sira_assets.errors import InputError
from sira_assets.measure.alignment import Alignment, AlignmentConfig, AlignmentKind, align, landmark_start
from sira_assets.measure.outer_surface import OuterSurfaceConfig, outer_surface
from sira_assets.measure.regions import (
    FACE_RADIUS_M,
    NOW_LANDMARKS,
    Region,
    in_face,
    in_head,
    now_disc,
    seen_by,
)
from sira_assets.measure.surface import MM_PER_M, DistanceSummary, Surface, sample_surface, summarise
from sira_assets.measure.truth import Truth
from sira_assets.mesh.triangle_mesh import TriangleMesh

Protocol = Literal["surface", "h3ds", "now"]
GT_TO_PRED, PRED_TO_GT = "gt to pred", "pred to gt"


@dataclass(frozen=True)
class ProtocolConfig:
    """What the user may choose.

    Parameters
    ----------
    protocol : see the module
    align : None for the protocol's own: surface none, h3ds and now similarity
    samples : points per surface of `surface`; 60,000 put the noise of a face's mean below 0.005 mm
    seed : of the samples
    leave_out_inner : drop inner surfaces of truth and prediction (mouth bags, eyeball backs)
    close_openings : what is seen only through a mesh's own holes (a bust's open bottom) is inner
    """

    protocol: Protocol = "surface"
    align: AlignmentKind | None = None
    samples: int = 60_000
    seed: int = 0
    leave_out_inner: bool = True
    close_openings: bool = True


@dataclass(frozen=True)
class Choice:
    """One choice a figure rests on, in words."""

    name: str
    value: str


@dataclass(frozen=True)
class Measured:
    """One set of distances: region of the truth, direction, visibility ("any", "seen", "unseen") and statistics."""

    region: str
    direction: str
    seen: str
    distances: DistanceSummary | None


@dataclass(frozen=True)
class SurfaceReport:
    """All figures of one protocol on one pair."""

    protocol: Protocol
    alignment: Alignment
    measured: tuple[Measured, ...]
    choices: tuple[Choice, ...]

    def distances(self, region: str, direction: str = GT_TO_PRED, seen: str = "any") -> DistanceSummary | None:
        """The statistics of one set, or None where it was not measured."""
        found = (m.distances for m in self.measured if (m.region, m.direction, m.seen) == (region, direction, seen))
        return next(found, None)


def measure_surface(
    pred: TriangleMesh,
    truth: Truth,
    config: ProtocolConfig = ProtocolConfig(),
    *,
    pred_landmarks: Mapping[str, np.ndarray] | None = None,
) -> SurfaceReport:
    """Measure a prediction against the truth by one protocol.

    Parameters
    ----------
    pred : predicted mesh, metres, in the truth's world (or anywhere, where landmarks or ICP bring it there)
    pred_landmarks : name -> (3,) on the prediction, metres; where three names match the truth's, alignment starts from
        them

    Raises
    ------
    InputError : landmarks the protocol needs are absent, or speak of another place than the truth's mesh; or `now` is
        asked for without scale.
    """
    pred, truth = without_inner(pred, truth, config)
    return measure_prepared(pred, truth, config, pred_landmarks=pred_landmarks)


def without_inner(pred: TriangleMesh, truth: Truth, config: ProtocolConfig) -> tuple[TriangleMesh, Truth]:
    """Both surfaces without what no one sees from outside, where the configuration asks for that (seconds of rays)."""
    if not config.leave_out_inner:
        return pred, truth
    outer = OuterSurfaceConfig(close_openings=config.close_openings)
    return outer_surface(pred, outer), replace(truth, mesh=outer_surface(truth.mesh, outer))


def measure_prepared(
    pred: TriangleMesh,
    truth: Truth,
    config: ProtocolConfig = ProtocolConfig(),
    *,
    pred_landmarks: Mapping[str, np.ndarray] | None = None,
) -> SurfaceReport:
    """`measure_surface` for surfaces that went through `without_inner` already: to measure one pair several times."""
    measure = {"surface": _surface, "h3ds": _h3ds, "now": _now}[config.protocol]
    return measure(pred, truth, config, pred_landmarks or {})


def _surface(pred, truth, config, pred_landmarks) -> SurfaceReport:
    true_points = sample_surface(truth.mesh, config.samples, seed=config.seed).points
    gt_surface = Surface(truth.mesh)
    regions = _true_regions(truth, true_points)
    kind = config.align or "none"
    alignment = _align(pred, true_points[regions[0][1]], AlignmentConfig(kind), truth, pred_landmarks)
    moved = pred.transformed(alignment.gt_from_pred)
    to_pred = Surface(moved).distance(true_points)
    # Another seed: equal meshes must not be compared at equal samples by luck.
    pred_points = sample_surface(moved, config.samples, seed=config.seed + 1).points
    to_gt = gt_surface.distance(pred_points)
    seen = seen_by(truth.camera, true_points, gt_surface) if truth.camera is not None else None
    out = []
    for (name, inside), (_, pred_inside) in zip(regions, _regions(truth, pred_points), strict=True):
        out.append(Measured(name, GT_TO_PRED, "any", summarise(to_pred[inside])))
        if seen is not None:
            out.append(Measured(name, GT_TO_PRED, "seen", summarise(to_pred[inside & seen])))
            out.append(Measured(name, GT_TO_PRED, "unseen", summarise(to_pred[inside & ~seen])))
        out.append(Measured(name, PRED_TO_GT, "any", summarise(to_gt[pred_inside])))
    choices = (
        Choice("distance", "point to triangle"),
        Choice("samples", f"{config.samples} per surface, uniform by area, seed {config.seed}"),
        Choice("seen", "by the input camera, hidden points excluded" if seen is not None else "not asked: no camera"),
    )
    return SurfaceReport("surface", alignment, tuple(out), _choices(config, regions, alignment, choices))


def _h3ds(pred, truth, config, pred_landmarks) -> SurfaceReport:
    from scipy.spatial import cKDTree

    true_points = truth.mesh.vertices
    regions = _true_regions(truth, true_points)
    kind = config.align or "similarity"
    rule = AlignmentConfig(kind, nearest="vertex", keep=1.0)
    alignment = _align(pred, true_points[regions[0][1]], rule, truth, pred_landmarks)
    moved = pred.transformed(alignment.gt_from_pred)
    to_pred = cKDTree(moved.vertices).query(true_points)[0]
    out = []
    for (name, inside), (_, pred_inside) in zip(regions, _regions(truth, moved.vertices), strict=True):
        to_gt = cKDTree(true_points[inside]).query(moved.vertices[pred_inside])[0] if inside.any() else np.zeros(0)
        out.append(Measured(name, GT_TO_PRED, "any", summarise(to_pred[inside])))
        out.append(Measured(name, PRED_TO_GT, "any", summarise(to_gt)))
    choices = (
        Choice("distance", "vertex to nearest vertex: depends on both tessellations"),
        Choice("samples", "every vertex"),
        Choice("direction", "H3DS's code leads with gt to pred, SIRA's text says pred to gt; both, within the region"),
    )
    return SurfaceReport("h3ds", alignment, tuple(out), _choices(config, regions, alignment, choices))


def _now(pred, truth, config, pred_landmarks) -> SurfaceReport:
    if config.align not in (None, "similarity"):
        raise InputError(
            expected="alignment by similarity for the protocol now, which refines scale",
            received=f"--align {config.align}",
            remedy="leave --align out, or use --protocol surface",
        )
    centre, radius = now_disc(truth.landmarks)
    points = truth.mesh.vertices[np.linalg.norm(truth.mesh.vertices - centre, axis=1) <= radius]
    if not len(points):
        raise _astray("vertices around the nose", f"none within {radius * MM_PER_M:.0f} mm of it")
    rule = AlignmentConfig("similarity", keep=1.0)
    seven = {name: pred_landmarks[name] for name in NOW_LANDMARKS if name in pred_landmarks}
    alignment = _align(pred, points, rule, truth, seven)
    distance = Surface(pred.transformed(alignment.gt_from_pred)).distance(points)
    choices = (
        Choice("region", f"true vertices within {radius * MM_PER_M:.1f} mm of the nose's centre"),
        Choice("distance", "vertex of the truth to triangle of the prediction"),
        Choice("samples", "every true vertex in the region; at most 8000 of them in the alignment"),
        Choice("robustifier", "none: plain least squares"),
    )
    measured = (Measured("now disc", GT_TO_PRED, "any", summarise(distance)),)
    return SurfaceReport("now", alignment, measured, _choices(config, (), alignment, choices))


def _align(pred, targets, rule: AlignmentConfig, truth: Truth, pred_landmarks) -> Alignment:
    names = [name for name in pred_landmarks if name in truth.landmarks]
    if rule.kind == "none" or len(names) < 3:
        return align(pred, targets, rule)
    theirs, ours = (np.array([source[name] for name in names]) for source in (pred_landmarks, truth.landmarks))
    start = landmark_start(theirs, ours, rule.kind)
    return align(pred, targets, rule, start=start, start_name=f"landmarks ({len(names)})")


def _regions(truth: Truth, points: np.ndarray) -> tuple[tuple[Region, np.ndarray], ...]:
    """The regions that can be told, the narrowest first: it is what alignment looks at."""
    out: list[tuple[Region, np.ndarray]] = []
    if "nose_tip" in truth.landmarks:
        out.append(("face", in_face(points, truth.landmarks["nose_tip"])))
    if truth.canonical_from_world is not None:
        out.append(("head", in_head(points, truth.canonical_from_world)))
    out.append(("all", np.ones(len(points), bool)))
    return tuple(out)


def _true_regions(truth: Truth, points: np.ndarray) -> tuple[tuple[Region, np.ndarray], ...]:
    """`_regions` of points of the truth itself.

    Raises
    ------
    InputError : one of them is empty: landmarks or canonical frame speak of another place than the mesh.
    """
    regions = _regions(truth, points)
    for name, inside in regions:
        if not inside.any():
            raise _astray(f"some surface in the region {name}", "none there")
    return regions


def _astray(expected: str, received: str) -> InputError:
    remedy = "check that landmarks and mesh share frame and unit"
    return InputError(expected=f"a scan with {expected}", received=received, remedy=remedy)


def _choices(config, regions, alignment: Alignment, own: tuple[Choice, ...]) -> tuple[Choice, ...]:
    words = {
        "face": f"face: true surface within {FACE_RADIUS_M * MM_PER_M:.0f} mm of the nose tip",
        "head": "head: above a plane from under the chin to the nape",
        "all": "all: everything",
    }
    named = {choice.name for choice in own}
    kind = {"none": "none, as given", "rigid": "rigid ICP, size kept", "similarity": "ICP with scale"}[alignment.kind]
    shared = (
        Choice("protocol", config.protocol),
        Choice("alignment", kind),
        Choice("alignment start", alignment.start),
        Choice("inner surfaces", "left out of truth and prediction" if config.leave_out_inner else "counted"),
        Choice("unit", "mm, in the truth's size"),
    )
    region = Choice("region", "; ".join(words[name] for name, _ in regions))
    return shared + (() if "region" in named else (region,)) + own
