"""Unwrapping ends, covers every face and says what it did, whatever the mesh."""

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.fields.analytic import EllipsoidHead
from sira_assets.mesh.extract import ExtractConfig, extract_mesh
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.texture.atlas import Atlas, AtlasReport, signed_uv_areas, stretch, vertex_of_uv
from sira_assets.texture.overlap import overlapping_pairs
from sira_assets.texture.unwrap import UnwrapConfig, unwrap

BOXES = UnwrapConfig(methods=())


@pytest.fixture(scope="module")
def ellipsoid():
    return extract_mesh(EllipsoidHead(), ExtractConfig(cell_m=0.01))


def soup(seed, faces=100):
    rng = np.random.default_rng(seed)
    return TriangleMesh(rng.standard_normal((3 * faces, 3)), np.arange(3 * faces).reshape(-1, 3))


def tangle():
    rng = np.random.default_rng(3)
    return TriangleMesh(rng.standard_normal((40, 3)), np.array([rng.choice(40, 3, replace=False) for _ in range(120)]))


def with_faults(mesh):
    """Copies (one of them turned over), flat faces, a face with a repeated vertex, a vertex of no face."""
    extra = np.concatenate([mesh.faces[:3], mesh.faces[3:4, ::-1], [[0, 0, 5], [7, 7, 7]]])
    return TriangleMesh(np.vstack([mesh.vertices, [[0, 0, 9.0]]]), np.concatenate([mesh.faces, extra]))


def check(mesh, atlas, *, copies=0):
    """`copies` faces at the end repeat earlier ones, and so overlap them by design."""
    assert len(atlas.faces_uv) == len(mesh.faces)
    assert np.isfinite(atlas.uv).all()
    assert atlas.uv.min() >= 0.0
    assert atlas.uv.max() <= 1.0
    assert vertex_of_uv(mesh, atlas).min() >= 0  # no unused atlas vertex, none for two mesh vertices
    originals = atlas.faces_uv[: len(mesh.faces) - copies]
    assert len(overlapping_pairs(atlas.uv, originals, tolerance=1e-7)) == 0
    assert 0.0 < atlas.report.utilisation <= 1.0
    assert atlas.report.stretch >= 1.0


@pytest.fixture(scope="module", params=[pytest.param("uvatlas", marks=pytest.mark.slow), "xatlas", "boxes"])
def unwrapped(request, ellipsoid):
    return request.param, unwrap(ellipsoid, UnwrapConfig(methods=(request.param,), texture_size=512, padding=4))


def test_each_method_unwraps_an_ellipsoid_without_mirror_or_overlap(ellipsoid, unwrapped):
    method, atlas = unwrapped
    assert atlas.report.method == method
    assert atlas.report.attempts == ()
    check(ellipsoid, atlas)
    area = signed_uv_areas(atlas.uv, atlas.faces_uv)
    assert (area > 0).all()
    # Texels follow surface: no face gets less than a fifth or more than five times its share.
    corners = ellipsoid.vertices[ellipsoid.faces]
    surface = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = (area / area.sum()) / (surface / surface.sum())
    assert np.percentile(share, 1) > 0.2
    assert np.percentile(share, 99) < 5
    assert atlas.report.utilisation > 0.4


def test_charts_keep_their_distance(unwrapped):
    from scipy.ndimage import distance_transform_edt

    from sira_assets.texture.atlas import chart_labels
    from sira_assets.texture.raster import rasterise

    _, atlas = unwrapped
    samples = rasterise(atlas.uv, atlas.faces_uv, 1024, samples=1, first_row=0, last_row=1024)
    chart = np.full(1024 * 1024, -1)
    chart[samples.texel] = chart_labels(atlas.faces_uv, len(atlas.uv))[atlas.faces_uv[samples.face, 0]]
    chart = chart.reshape(1024, 1024)
    nearest = min(distance_transform_edt(chart != c)[(chart >= 0) & (chart != c)].min() for c in range(chart.max() + 1))
    # Measured on a lattice of half texels: touched half-texels may stand up to 3 steps nearer than the shapes.
    assert nearest >= 2 * 4 - 3


TORTURE = {
    "soup": soup(0),
    "tangle": tangle(),
    "one": TriangleMesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]])),
    "tiny": TriangleMesh(1e-7 * soup(1).vertices, soup(1).faces),
    "huge": TriangleMesh(1e9 * soup(2).vertices + 1e10, soup(2).faces),
    "faults": with_faults(soup(4, 50)),
}


@pytest.mark.parametrize("name", TORTURE)
def test_the_last_resort_takes_anything(name):
    atlas = unwrap(TORTURE[name], BOXES)
    assert atlas.report.method == "boxes"
    check(TORTURE[name], atlas, copies=6 * (name == "faults"))
    assert atlas.report.overlapping == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tangle", "tiny", "faults"])
@pytest.mark.parametrize("methods", [None, ("uvatlas", "xatlas")])
def test_torture_meshes_end_with_both_methods(name, methods):
    atlas = unwrap(TORTURE[name], UnwrapConfig(methods=methods, budget_s=20.0))
    check(TORTURE[name], atlas, copies=6 * (name == "faults"))
    if methods:
        assert "more than 30 pieces" in atlas.report.attempts[0]


def test_faces_set_aside_get_their_place(ellipsoid):
    mesh = with_faults(ellipsoid)
    atlas = unwrap(mesh, BOXES)
    count = len(ellipsoid.faces)
    assert np.array_equal(np.sort(atlas.faces_uv[count : count + 3], 1), np.sort(atlas.faces_uv[:3], 1))
    assert np.array_equal(atlas.faces_uv[count + 3], atlas.faces_uv[3, ::-1])
    assert np.ptp(atlas.uv[atlas.faces_uv[count + 4 :]], axis=1).max() == 0.0


def test_out_of_time_falls_back_and_says_so(ellipsoid):
    from sira_assets.texture.unwrap_parts import Part, unwrap_parts

    # Less than a process needs to start: killed, and said.
    assert unwrap_parts("xatlas", [Part(ellipsoid.vertices, ellipsoid.faces)], 0.01, 1) == ["not done within 0.01 s"]
    atlas = unwrap(ellipsoid, UnwrapConfig(methods=("xatlas",), budget_s=0.01))
    assert atlas.report.method == "boxes"
    assert len(atlas.report.attempts) == 1
    check(ellipsoid, atlas)


def test_a_worker_that_fails_falls_back_and_says_so(ellipsoid):
    atlas = unwrap(ellipsoid, UnwrapConfig(methods=("no_such_method",)))
    assert atlas.report.method == "boxes"
    assert "ended with code 1" in atlas.report.attempts[0]
    assert "no_such_method" in atlas.report.attempts[0]


def test_the_same_mesh_gives_the_same_atlas(ellipsoid):
    first, second = unwrap(ellipsoid, BOXES), unwrap(ellipsoid, BOXES)
    assert np.array_equal(first.uv, second.uv)


def test_a_mesh_without_area_is_refused():
    with pytest.raises(InputError, match="none of any area"):
        unwrap(TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))
    with pytest.raises(InputError, match="none of any area"):
        unwrap(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), int)))


def test_stretch_of_a_known_map():
    mesh = TriangleMesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]]))
    uv = np.array([[0, 0], [0.6, 0], [0, 0.2]])
    assert stretch(mesh, uv, mesh.faces)[0] == pytest.approx(3.0)
    sheared = np.array([[0, 0], [0.2, 0], [0.2, 0.2]])  # [[1, 1], [0, 1]]: singular values (sqrt 5 +- 1)/2
    assert stretch(mesh, sheared, mesh.faces)[0] == pytest.approx(((np.sqrt(5) + 1) / 2) ** 2)


def test_an_atlas_refuses_coordinates_outside_the_picture():
    report = AtlasReport("boxes", 1, 0.5, 0.0, 1.0)
    for bad in (np.nan, 1.5, -0.1):
        with pytest.raises(InputError, match="texture coordinates"):
            Atlas(np.array([[0, 0], [1, 0], [0, bad]]), np.array([[0, 1, 2]]), report)
