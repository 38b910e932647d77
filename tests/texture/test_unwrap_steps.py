"""The steps of the unwrap, each against what it must be: sound faces, parts, exact overlap, packing, texture size."""

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.mesh.topology import topology
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.camera import Camera
from sira_assets.texture.atlas import chart_labels, measure_atlas, signed_uv_areas
from sira_assets.texture.box_charts import box_charts
from sira_assets.texture.overlap import losers, overlapping_pairs
from sira_assets.texture.packing import pack_charts
from sira_assets.texture.sound_surface import cut_open, face_pieces, sound_surface
from sira_assets.texture.texture_size import LEAST, photo_texture_size
from sira_assets.texture.unwrap import UnwrapConfig, unwrap
from sira_assets.texture.unwrap_cost import predicted_seconds
from sira_assets.texture.unwrap_parts import Part, split_parts, unwrap_parts


def grid(n):
    """A flat n x n grid of unit squares, two triangles each."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    i = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :n].reshape(-1)
    faces = np.concatenate([np.stack([i, i + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + n + 1], 1)])
    return TriangleMesh(np.stack([x.reshape(-1), y.reshape(-1), np.zeros(x.size)], 1), faces)


def clipped_area(first, second):
    """Area that two triangles (3, 2) share, by cutting one with each edge line of the other: slow and certain."""
    shape = first
    for k in range(3):
        a, b = second[k], second[(k + 1) % 3]
        side = (b[0] - a[0]) * (shape[:, 1] - a[1]) - (b[1] - a[1]) * (shape[:, 0] - a[0])
        cut = []
        for i in range(len(shape)):
            j = (i + 1) % len(shape)
            if side[i] >= 0:
                cut.append(shape[i])
            if side[i] * side[j] < 0:
                cut.append(shape[i] + side[i] / (side[i] - side[j]) * (shape[j] - shape[i]))
        if len(cut) < 3:
            return 0.0
        shape = np.array(cut)
    x, y = shape[:, 0], shape[:, 1]
    return 0.5 * abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def test_overlap_is_what_clipping_says():
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.uniform(-2.5, -0.3, (40, 1, 1))  # small among large: every level of the hierarchy
    corners = rng.uniform(0, 1, (40, 1, 2)) + size * rng.standard_normal((40, 3, 2))
    clockwise = signed_uv_areas(corners.reshape(-1, 2), np.arange(120).reshape(-1, 3)) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    found = overlapping_pairs(corners.reshape(-1, 2), np.arange(120).reshape(-1, 3), tolerance=1e-9)
    areas = {(i, j): clipped_area(corners[i], corners[j]) for i in range(40) for j in range(i + 1, 40)}
    expected = {pair for pair, area in areas.items() if area > 1e-12}
    assert len(expected) > 20
    assert {tuple(pair) for pair in found.tolist()} == expected


def test_neighbours_touch_and_do_not_overlap():
    mesh = grid(12)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])  # off the axes: shared edges are rounded
    uv = mesh.vertices[:, :2] @ turn.T / 3.0
    assert len(overlapping_pairs(uv, mesh.faces, tolerance=1e-12)) == 0
    folded = uv.copy()
    folded[13 * 6 + 6] += (0.9, 0.9)  # one inner vertex dragged over its neighbours
    pairs = overlapping_pairs(folded, mesh.faces)
    gone = losers(pairs, len(mesh.faces)) | (signed_uv_areas(folded, mesh.faces) <= 0)
    assert gone.any()
    assert len(overlapping_pairs(folded, mesh.faces[~gone])) == 0


def test_welding_cutting_and_setting_aside():
    mesh = grid(3)
    v, f = mesh.vertices, mesh.faces
    fin = [[0, 1, len(v)]]  # the edge 0-1 is on the border: with one fin it is proper, with two it is not
    apart = TriangleMesh(np.vstack([v, [[0, 0, 1.0]], v[:3]]), np.vstack([f, fin, f[:1, ::-1], [[5, 5, 6]], f[:1]]))
    sound = sound_surface(apart)
    assert len(sound.faces) == len(f) + 1
    assert sound.original[-2] == -1  # no area
    assert sound.original[-1] == sound.original[-3] == sound.original[0]
    soup = TriangleMesh(v[f].reshape(-1, 3), np.arange(3 * len(f)).reshape(-1, 3))
    assert len(sound_surface(soup).vertices) == len(v)
    twice = np.vstack([f, [[0, 1, len(v)]], [[0, 1, len(v) + 1]], [[0, 1, len(v) + 2]]])
    faces, vertex = cut_open(twice)
    assert np.array_equal(vertex[faces], twice)
    shape = topology(TriangleMesh(np.vstack([v, np.eye(3)])[vertex], faces))
    assert shape.nonmanifold_edges == shape.nonmanifold_vertices == shape.misoriented_edges == 0
    assert face_pieces(cut_open(f)[0]).max() == 0  # what is sound already stays in one piece


def test_parts_cover_everything_once_and_keep_their_size():
    mesh = grid(20)
    far = TriangleMesh(
        np.vstack([mesh.vertices, mesh.vertices[:4] + 100]), np.vstack([mesh.faces, [[441, 442, 443], [442, 444, 443]]])
    )
    piece = face_pieces(far.faces)
    for most in (3, 100, 799, 800, 801, 5000):  # around the large piece's own size too
        part = split_parts(far.vertices, far.faces, piece, most)
        sizes = np.bincount(part)
        assert sizes.sum() == len(far.faces)
        assert 1 <= sizes.min() <= sizes.max() <= most
        assert len(np.unique(part[-2:])) == 1


def test_box_charts_never_overlap():
    rng = np.random.default_rng(1)
    vertices = rng.uniform(0, 1, (60, 3))
    faces = np.array([rng.choice(60, 3, replace=False) for _ in range(200)])
    uv, faces_uv = box_charts(vertices, faces)
    chart = chart_labels(faces_uv, len(uv))[faces_uv[:, 0]]
    assert (signed_uv_areas(uv, faces_uv) > 0).all()
    assert len(overlapping_pairs(uv, faces_uv, chart)) == 0


@pytest.mark.parametrize(("size", "padding"), [(64, 2), (512, 4), (512, 16), (1000, 3)])
def test_packed_charts_keep_shape_and_distance(size, padding):
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(2)
    one = grid(4)
    scale = rng.uniform(0.3, 2.0, 12)
    uv = np.concatenate([one.vertices[:, :2] * (s, 0.4 * s) for s in scale])
    faces = np.concatenate([one.faces + 25 * k for k in range(12)])
    chart = np.repeat(np.arange(12), 25)
    packed = pack_charts(uv, faces, chart, size, padding)
    assert packed.padding == padding
    assert packed.uv.min() >= 0
    assert packed.uv.max() <= 1
    # One scale for all, no mirror: areas keep their ratio, sign included.
    ratio = signed_uv_areas(packed.uv, faces) / signed_uv_areas(uv, faces)
    assert np.ptp(ratio) < 1e-9 * ratio.mean()
    assert ratio.mean() * signed_uv_areas(uv, faces).sum() > 0.3
    # Points along the grid lines, dense against a texel: the nearest of another chart is at least the padding away.
    t = np.linspace(0, 1, 40)[:, None, None]
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    along = (packed.uv[edges[:, 0]] * (1 - t) + packed.uv[edges[:, 1]] * t).transpose(1, 0, 2)
    name = chart[edges[:, 0]]
    least = min(
        cKDTree(along[name != k].reshape(-1, 2)).query(along[name == k].reshape(-1, 2))[0].min() for k in range(12)
    )
    assert size * least >= padding - 1e-6


def test_too_many_charts_still_fit():
    corners = np.array([[0, 0], [1, 0], [0, 1.0]])
    uv = np.tile(corners, (5000, 1))
    faces = np.arange(15000).reshape(-1, 3)
    packed = pack_charts(uv, faces, np.repeat(np.arange(5000), 3), 64, 4)
    assert packed.padding < 4  # 5000 charts four texels apart do not fit into 64 x 64, and it says so
    assert len(overlapping_pairs(packed.uv, faces, tolerance=1e-9)) == 0


def test_what_one_part_cannot_others_may(monkeypatch):
    good = grid(6)
    bad = Part(np.full((3, 3), np.nan), np.array([[0, 1, 2]]))
    parts = [Part(good.vertices / 6, good.faces), bad, Part(good.vertices / 6, good.faces)]
    results = unwrap_parts("xatlas", parts, 30.0, 1)
    assert isinstance(results[1], str)
    for k in (0, 2):
        assert results[k][1].shape == good.faces.shape


def test_an_expensive_method_is_not_begun():
    atlas = unwrap(grid(10), UnwrapConfig(methods=("xatlas",), budget_s=0.5))
    assert atlas.report.method == "boxes"
    assert "would take about" in atlas.report.attempts[0]
    costs = [predicted_seconds(method, [10**6]) for method in ("boxes", "uvatlas", "xatlas")]
    assert costs == sorted(costs)
    assert predicted_seconds("xatlas", [10**4] * 10) < predicted_seconds("xatlas", [10**5])


def test_report_of_a_known_atlas():
    mesh = grid(2)
    uv = mesh.vertices[:, :2] / 4.0  # a quarter of the square
    said = {"method": "x", "attempts": (), "padding_texels": 4.0, "seconds": 0.0, "predicted_s": 0.0}
    report = measure_atlas(mesh, uv, mesh.faces, texture_size=64, **said)
    assert report.charts == 1
    assert report.utilisation == pytest.approx(0.25)
    assert report.stretch == pytest.approx(1.0)
    assert report.sliver_share == 0.0
    assert report.overlapping == 0
    thin = measure_atlas(mesh, uv * (1.0, 0.05), mesh.faces, texture_size=64, **said)
    assert thin.sliver_share == 1.0  # 1.6 texels
    assert thin.stretch_95 == pytest.approx(20.0)


def test_infinite_vertices_are_refused_in_one_line():
    with pytest.raises(InputError, match="finite vertices") as caught:
        TriangleMesh(np.array([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]), np.array([[0, 1, 2]]))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("metres_per_unit", [1.0, 1e-3])
def test_texture_size_follows_the_photos_pixels(metres_per_unit):
    """A square of 0.4 m seen head-on from 2 m at f = 1100: 220 pixels, 284 texels a side at 60 % utilisation."""
    pose = np.diag([1.0, -1, -1, 1])
    pose[2, 3] = 2.0 / metres_per_unit
    mesh = grid(4)
    square = TriangleMesh((mesh.vertices - (2, 2, 0)) * 0.1 / metres_per_unit, mesh.faces)

    def wanted(focal, **options):
        camera = Camera(np.array([[focal, 0, 500], [0, focal, 500], [0, 0, 1.0]]), pose, 1000, 1000)
        return photo_texture_size(square, camera, **options)

    assert wanted(1100.0) == 512
    assert wanted(1100.0, texels_per_pixel=2.0) == 1024
    assert wanted(3900.0) == 1024  # 1007
    assert wanted(4000.0) == 1024  # 1033: less than a hundredth too few
    assert wanted(4100.0) == 2048
    # Two texels to a wave of 2.25 mm: 459 a side, whatever the photo has; twice that at two a pixel.
    wave = 0.00225 / metres_per_unit
    assert [wanted(f, shortest_wave=wave) for f in (1100.0, 4100.0, 1e4)] == [512, 512, 512]
    assert wanted(1e4, shortest_wave=wave, texels_per_pixel=2.0) == 1024
    assert wanted(400.0, shortest_wave=wave) == LEAST
    behind = pose.copy()
    behind[2, 3] *= -1
    camera = Camera(np.array([[1000, 0, 500], [0, 1000, 500], [0, 0, 1.0]]), behind, 1000, 1000)
    assert photo_texture_size(square, camera) == LEAST


def test_a_soup_is_unwrapped_as_the_surface_it_is():
    mesh = grid(6)
    soup = TriangleMesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))
    assert unwrap(soup, UnwrapConfig(methods=())).report.charts == 1


@pytest.mark.parametrize(("n", "order"), [(70, ["xatlas", "uvatlas"]), (72, ["uvatlas", "xatlas"])])
def test_small_surfaces_go_to_xatlas_first_and_others_to_uvatlas(n, order, monkeypatch):
    asked = []

    def refuse(method, parts, seconds, workers):
        asked.append(method)
        return ["not today"] * len(parts)

    monkeypatch.setattr("sira_assets.texture.unwrap.unwrap_parts", refuse)
    surface = grid(n)  # 9,800 and 10,368 faces
    assert unwrap(surface).report.method == "boxes"
    assert asked == order
    assert unwrap(surface, UnwrapConfig(methods=("xatlas",))).report.method == "boxes"
    assert asked == [*order, "xatlas"]
