"""A user's own scan as a subject: read, cleaned, placed in the canonical frame, closed.

Notation: a scan's file has its own unit and frame (`scan`); canonical_from_scan is the similarity of its landmarks onto
the canonical nine.
"""

from functools import lru_cache

import numpy as np

from data_synth.close_scan import closed_by_caps, oriented
from data_synth.scan_back import widest_yaw
from data_synth.scan_landmarks import ScanLandmarks, check_on_surface, read_scan_landmarks
from data_synth.scan_mesh import ScanMesh
from data_synth.scene_settings import ScanSource
from data_synth.subject import Subject
from sira_assets.errors import InputError
from sira_assets.mesh.signed_distance import inside
from sira_assets.mesh.triangle_mesh import TriangleMesh, face_cross_products
from sira_assets.scene.canonical import (
    CANONICAL_LANDMARKS_M,
    canonical_from_landmarks,
    similarity_scale,
    transform_points,
)

# The nine of real heads lie 3 to 6 mm (RMS) from the mean head's; swapped sides, or other points, beyond 20 mm.
MOST_LANDMARK_RMS_M = 0.012
HEAD_REACH_M = 0.35  # from the point between the eyes; what lies beyond is body
SCALES = (0.7, 1.4)  # canonical metres per metre: newborn to giant
MOST_CAP = 1.0  # of the scan's own area (half a ball open behind: 0.5); more is a mask, whose inside is guesswork
DEPTH_M = 0.012  # so far behind its landmarks a head is solid


@lru_cache(maxsize=2)
def scan_subject(source: ScanSource) -> Subject:
    """Read a scan and make it a subject; read once a process.

    Raises
    ------
    InputError : a file cannot be read, the landmarks are not this face's, or the surface cannot be closed.
    """
    scan = source.read()
    landmarks = read_scan_landmarks(source.landmarks)
    canonical_from_scan = canonical_from_landmarks(landmarks.nine)
    placed = landmarks.moved(lambda p: transform_points(canonical_from_scan, p))
    _check_landmarks(source, placed)
    scale = _size(source, landmarks, similarity_scale(canonical_from_scan))
    vertices = transform_points(canonical_from_scan, scan.vertices)
    near = (np.linalg.norm(vertices, axis=1) < HEAD_REACH_M)[scan.faces].any(1)
    if not near.any():
        raise InputError(expected="landmarks on the scan", received="none near it", remedy="check their frame and unit")
    if not near.all():
        scan = scan.only(near, f"{100 * (~near).mean():.0f} % of the faces, beyond {HEAD_REACH_M:g} m, left out")
        vertices = transform_points(canonical_from_scan, scan.vertices)
    faces = oriented(scan.weld[scan.faces])
    if not np.array_equal(faces, scan.weld[scan.faces]):
        flipped = (faces != scan.weld[scan.faces]).any(1)
        scan = _with_flips(scan, flipped, "faces turned to one side")
    _, first = np.unique(scan.weld, return_index=True)
    mesh = TriangleMesh(vertices[first], scan.weld[scan.faces])
    if _looks_inward(mesh):
        scan = _with_flips(scan, np.ones(len(scan.faces), bool), "turned inside out")
        mesh = TriangleMesh(mesh.vertices, scan.weld[scan.faces])
    closed = _closed(source, mesh, placed)
    albedo, _ = scan.material(scan.coordinates[first])
    notes, widest = list(scan.notes), None
    if source.metres_per_unit is None:
        notes.append("size unknown: scaled to the mean head's (say --metres-per-unit)")
    if closed is not mesh:
        widest = widest_yaw(mesh)
        notes.append(
            f"open: closed with {len(closed.faces) - len(mesh.faces)} faces for the signed distance; "
            f"seen from {widest:g} degrees at most, where its inside does not show"
        )
    return Subject(
        mesh=mesh,
        vertex_albedo=albedo,
        rendered=TriangleMesh(vertices, scan.faces, mesh.normals[scan.weld]),
        material_coordinates=scan.coordinates,
        material=scan.material,
        landmarks=placed.nine,
        landmarks68=placed.all68,
        anchors=np.zeros((0, 3)),
        regions=None,
        region_names={},
        closed=closed,
        scale=scale,
        around_yaw_deg=widest,
        provenance={"scan": {"notes": notes, "canonical_from_scan": canonical_from_scan.tolist()}},
    )


def _with_flips(scan: ScanMesh, flipped: np.ndarray, note: str) -> ScanMesh:
    from dataclasses import replace

    faces = np.where(flipped[:, None], scan.faces[:, ::-1], scan.faces)
    return replace(scan, faces=faces, notes=(*scan.notes, note))


def _check_landmarks(source: ScanSource, placed: ScanLandmarks) -> None:
    gap = [np.linalg.norm(p - CANONICAL_LANDMARKS_M[name]) for name, p in placed.nine.items()]
    rms = float(np.sqrt(np.mean(np.square(gap))))
    if not rms < MOST_LANDMARK_RMS_M:
        raise InputError(
            expected=f"landmarks of a face in {source.landmarks}",
            received=f"points {1e3 * rms:.0f} mm (RMS) from a mean face's, best placed",
            remedy="check their names and order; right and left are the subject's",
        )


def _size(source: ScanSource, landmarks: ScanLandmarks, canonical_per_unit: float) -> float:
    """World metres per canonical metre."""
    if source.metres_per_unit is None:
        return 1.0
    scale = canonical_per_unit / source.metres_per_unit
    if not SCALES[0] <= scale <= SCALES[1]:
        raise InputError(
            expected=f"--metres-per-unit that makes {source.mesh} a head's size",
            received=f"{source.metres_per_unit:g}, a head {1 / scale:.3g} times the mean one",
            remedy=f"about {canonical_per_unit:.2g} would fit a mean head",
        )
    return 1.0 / scale


def _looks_inward(mesh: TriangleMesh) -> bool:
    """Whether most of the face's front turns its back to the viewer."""
    centre = mesh.vertices[mesh.faces].mean(1)
    front = np.linalg.norm(centre - np.array(CANONICAL_LANDMARKS_M["nose_tip"]), axis=1) < 0.06
    return float(face_cross_products(mesh.vertices, mesh.faces)[front, 2].sum()) < 0.0


def _closed(source: ScanSource, mesh: TriangleMesh, placed: ScanLandmarks) -> TriangleMesh:
    """The scan closed, with its own faces first; itself where it is closed."""
    points = np.array(list(placed.nine.values()))
    check_on_surface(points, mesh, source.mesh)
    closed = closed_by_caps(mesh)
    area = np.linalg.norm(face_cross_products(closed.vertices, closed.faces), axis=1)
    cap = float(area[len(mesh.faces) :].sum() / area[: len(mesh.faces)].sum())
    inward = np.array([0.0, -0.03, -0.05]) - points
    behind = points + DEPTH_M * inward / np.linalg.norm(inward, axis=1, keepdims=True)
    solid = float(inside(closed, behind).mean())
    if cap > MOST_CAP or solid < 0.6:
        raise InputError(
            expected=f"a scan that can be closed: {source.mesh}",
            received=f"openings of {100 * cap:.0f} % of its area, {100 * solid:.0f} % of the face solid behind",
            remedy="close it in a mesh program, or scan more of the head",
        )
    return closed
