"""A user's scan: any frame, unit, orientation, texture or opening gives the same head; what is hopeless is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from data_synth.close_scan import closed_by_caps, oriented
from data_synth.import_scan import scan_subject
from data_synth.scan_back import widest_yaw
from data_synth.scan_landmarks import read_scan_landmarks
from data_synth.scan_material import NEUTRAL_ALBEDO, sample_bilinear
from data_synth.scan_mesh import read_scan_mesh
from data_synth.scene_settings import ScanSource
from sira_assets.errors import InputError
from sira_assets.mesh.signed_distance import inside, signed_distance
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, transform_points

CENTRE, AXES = np.array([0.0, -0.03, -0.06]), np.array([0.075, 0.12, 0.095])
NAMES = list(CANONICAL_LANDMARKS_M)


def egg(subdivisions=4) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a head-sized ellipsoid in the canonical frame; a millimetre or two from the landmarks."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions)
    return np.asarray(ball.vertices) * AXES + CENTRE, np.asarray(ball.faces)


def landmarks_on_egg() -> dict[str, np.ndarray]:
    """The canonical nine, moved radially onto the ellipsoid."""
    out = {}
    for name, point in CANONICAL_LANDMARKS_M.items():
        ray = (np.array(point) - CENTRE) / AXES
        out[name] = CENTRE + ray / np.linalg.norm(ray) * AXES
    return out


def write_scan(folder, vertices, faces, landmarks, *, colours=None, name="egg.ply"):
    import trimesh

    trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False).export(folder / name)
    points = {n: np.asarray(p).tolist() for n, p in landmarks.items()}
    (folder / "landmarks.json").write_text(json.dumps({"landmarks_m": points}))
    return ScanSource("egg", str(folder / name), str(folder / "landmarks.json"))


def test_frame_and_unit_of_the_file_do_not_matter(tmp_path):
    vertices, faces = egg()
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = 1000.0 * (vertices @ turn.T + [0.5, -2.0, 1.0])
    landmarks = landmarks_on_egg()
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one = scan_subject(write_scan(tmp_path / "a", vertices, faces, landmarks))
    there = {n: 1000.0 * (turn @ p + [0.5, -2.0, 1.0]) for n, p in landmarks.items()}
    other = scan_subject(write_scan(tmp_path / "b", moved, faces, there))
    # PLY is single precision: 2 m from the origin that is 0.1 micrometre.
    assert np.abs(one.mesh.vertices - other.mesh.vertices).max() < 1e-6
    assert other.closed is other.mesh
    assert "size unknown" in other.provenance["scan"]["notes"][-1]


def test_size_is_taken_from_the_unit_and_a_wrong_unit_is_refused_with_the_right_one(tmp_path):
    vertices, faces = egg()
    landmarks = {n: 1100.0 * p for n, p in landmarks_on_egg().items()}
    source = write_scan(tmp_path, 1100.0 * vertices, faces, landmarks)
    subject = scan_subject(replace(source, metres_per_unit=0.001))
    unscaled = scan_subject(replace(source, metres_per_unit=None))
    assert unscaled.scale == 1.0
    lengths = [np.linalg.norm(x[1:] - x[:-1], axis=1) for x in (vertices, subject.mesh.vertices)]
    # PLY is single precision: 1e-7 of the size, 1e-4 of the shortest of these lengths at the least.
    assert subject.scale * lengths[1] == pytest.approx(1.1 * lengths[0], rel=1e-4)
    with pytest.raises(InputError, match=r"about 0\.000\d+ would fit"):
        scan_subject(replace(source, metres_per_unit=1.0))


def test_a_scan_turned_inside_out_in_part_or_whole_comes_out_outward(tmp_path):
    vertices, faces = egg()
    mixed = faces.copy()
    mixed[::3] = mixed[::3, ::-1]
    for k, turned in enumerate((faces[:, ::-1], mixed)):
        (tmp_path / str(k)).mkdir()
        mesh = scan_subject(write_scan(tmp_path / str(k), vertices, turned, landmarks_on_egg())).mesh
        assert ((mesh.vertices - CENTRE) / AXES * mesh.normals).sum(1).min() > 0


def test_dirt_is_left_out_and_said(tmp_path):
    vertices, faces = egg()
    scrap = np.array([[0.2, 0.2, 0.2], [0.201, 0.2, 0.2], [0.2, 0.201, 0.2]])
    n = len(vertices)
    dirty = np.concatenate([faces, faces[:5], [[0, 0, 1]], [[n, n + 1, n + 2]]])
    source = write_scan(tmp_path, np.concatenate([vertices, scrap]), dirty, landmarks_on_egg())
    subject = scan_subject(source)
    assert len(subject.mesh.faces) == len(faces)
    assert len(subject.mesh.vertices) == n
    notes = " ".join(subject.provenance["scan"]["notes"])
    assert "6 empty or double faces" in notes
    assert "1 separate pieces" in notes
    assert "no colours: neutral grey" in notes
    assert np.allclose(subject.vertex_albedo, NEUTRAL_ALBEDO)


@pytest.mark.parametrize("stray", [[0.0, 3.0, 0.0], [0.0, 3e5, 0.0], [np.nan] * 3], ids=["near", "far", "NaN"])
def test_vertices_of_no_face_do_not_count(tmp_path, stray):
    vertices, faces = egg()
    for name in ("clean", "strayed"):
        (tmp_path / name).mkdir()
    clean = scan_subject(write_scan(tmp_path / "clean", vertices, faces, landmarks_on_egg()))
    more = np.insert(vertices, [0, len(vertices)], stray, axis=0)
    strayed = scan_subject(write_scan(tmp_path / "strayed", more, faces + 1, landmarks_on_egg()))
    assert np.array_equal(strayed.mesh.vertices, clean.mesh.vertices)
    assert np.array_equal(strayed.mesh.faces, clean.mesh.faces)
    assert strayed.provenance == clean.provenance


def test_vertex_colours_are_srgb(tmp_path):
    vertices, faces = egg()
    colours = np.full((len(vertices), 4), [188, 188, 0, 255], np.uint8)
    subject = scan_subject(write_scan(tmp_path, vertices, faces, landmarks_on_egg(), colours=colours))
    # Code 188 is 0.5 linear, to half a code.
    assert np.allclose(subject.vertex_albedo, [0.503, 0.503, 0.0], atol=3e-3)


def test_texture_is_bilinear_with_its_origin_at_the_bottom_left():
    picture = np.zeros((2, 4, 3), np.uint8)
    picture[1, 0] = 255  # lower left
    assert sample_bilinear(picture, np.array([[0.125, 0.25]]))[0] == pytest.approx([1, 1, 1])
    assert sample_bilinear(picture, np.array([[0.125, 0.75]]))[0] == pytest.approx([0, 0, 0])
    assert sample_bilinear(picture, np.array([[0.25, 0.25]]))[0] == pytest.approx([0.5] * 3)
    assert sample_bilinear(picture, np.array([[3.125, -0.75]]))[0] == pytest.approx([1, 1, 1])


def write_textured(folder, vertices, faces, colour) -> ScanSource:
    """An OBJ whose texture is cut at every edge."""
    folder.mkdir(exist_ok=True)
    Image.fromarray(np.full((8, 8, 3), colour, np.uint8)).save(folder / "skin.png")
    (folder / "egg.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    corner_uv = np.random.default_rng(0).random((3 * len(faces), 2))
    lines = ["mtllib egg.mtl", *(f"v {x} {y} {z}" for x, y, z in vertices), *(f"vt {u} {v}" for u, v in corner_uv)]
    lines.append("usemtl skin")
    for k, face in enumerate(faces):
        lines.append("f " + " ".join(f"{v + 1}/{3 * k + c + 1}" for c, v in enumerate(face)))
    (folder / "egg.obj").write_text("\n".join(lines))
    points = {n: p.tolist() for n, p in landmarks_on_egg().items()}
    (folder / "landmarks.json").write_text(json.dumps({"landmarks_m": points}))
    return ScanSource("egg", str(folder / "egg.obj"), str(folder / "landmarks.json"))


def test_the_fingerprint_is_of_the_pictures_that_a_mesh_names_too(tmp_path):
    colours = {"one": [188, 124, 99], "copy": [188, 124, 99], "other": [188, 124, 98]}
    digest = {n: write_textured(tmp_path / n, *egg(2), colour).digest() for n, colour in colours.items()}
    assert digest["one"] == digest["copy"] != digest["other"]


def test_the_fingerprint_is_of_geometry_in_another_file_too(tmp_path):
    import trimesh

    vertices, faces = egg(2)
    inner = int(np.abs((vertices - CENTRE) / AXES).max(1).argmin())  # leaves the bounds, which the glTF itself says
    digest = {}
    for name, factor in (("one", 1.0), ("copy", 1.0), ("other", 1.001)):
        moved = vertices.copy()
        moved[inner] = CENTRE + factor * (moved[inner] - CENTRE)
        source = write_scan(tmp_path, moved, faces, landmarks_on_egg())
        (tmp_path / name).mkdir()
        for file, data in trimesh.Trimesh(moved, faces, process=False).export(file_type="gltf").items():
            (tmp_path / name / file).write_bytes(data)
        digest[name] = replace(source, mesh=str(tmp_path / name / "model.gltf")).digest()
    assert (tmp_path / "one" / "model.gltf").read_bytes() == (tmp_path / "other" / "model.gltf").read_bytes()
    assert digest["one"] == digest["copy"] != digest["other"]


def test_a_cut_texture_leaves_the_surface_whole(tmp_path):
    """An OBJ with a seam: vertices are split where the texture is, normals and closedness are the welded surface's."""
    vertices, faces = egg(3)
    subject = scan_subject(write_textured(tmp_path, vertices, faces, [188, 124, 99]))
    assert len(subject.mesh.vertices) == len(vertices)
    assert len(subject.rendered.vertices) > 3 * len(vertices)
    assert subject.closed is subject.mesh
    albedo, _ = subject.material(subject.material_coordinates)
    assert np.allclose(albedo, [0.503, 0.202, 0.125], atol=3e-3)
    assert ((subject.rendered.vertices - CENTRE) / AXES * subject.rendered.normals).sum(1).min() > 0


def open_behind(subdivisions=4, depth=-0.05):
    vertices, faces = egg(subdivisions)
    return vertices, faces[(vertices[faces][:, :, 2] > depth).all(1)]


def test_an_opening_is_closed_exactly_and_known_as_such(tmp_path):
    vertices, faces = open_behind()
    subject = scan_subject(write_scan(tmp_path, vertices, faces, landmarks_on_egg()))
    closed, count = subject.closed, len(subject.mesh.faces)
    assert np.array_equal(closed.faces[:count], subject.mesh.faces)
    edges = np.concatenate([closed.faces[:, [0, 1]], closed.faces[:, [1, 2]], closed.faces[:, [2, 0]]])
    there = {tuple(e) for e in edges.tolist()}
    assert len(there) == len(edges)
    assert all((b, a) in there for a, b in there)
    # The ellipsoid cut by a plane, in closed form away from both: inside means inside both.
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.1, -0.2, -0.2], [0.1, 0.1, 0.1], (4000, 3))
    # Placement by landmarks that were moved onto the egg is a similarity close to the identity.
    placed = np.array(subject.provenance["scan"]["canonical_from_scan"])
    level = (((points - CENTRE) / AXES) ** 2).sum(1)
    clear = (np.abs(level - 1) > 0.05) & (np.abs(points[:, 2] + 0.05) > 0.006)
    expected = (level < 1) & (points[:, 2] > -0.05)
    assert np.array_equal(inside(closed, transform_points(placed, points))[clear], expected[clear])
    distance, face = signed_distance(closed, transform_points(placed, np.array([[0.0, -0.03, -0.2]])))
    assert distance[0] > 0
    assert face[0] >= count


def test_closed_surfaces_and_agreeing_faces_are_left_alone():
    vertices, faces = egg(2)
    mesh = TriangleMesh(vertices, faces)
    assert closed_by_caps(mesh) is mesh
    assert oriented(faces) is faces


def test_cameras_keep_to_where_the_inside_does_not_show():
    vertices, faces = egg()
    assert widest_yaw(TriangleMesh(vertices, faces)) == 150.0
    # A hemisphere open behind shows its inside beyond the side view at the latest.
    vertices, faces = open_behind(depth=CENTRE[2])
    assert widest_yaw(TriangleMesh(vertices, faces)) <= 90.0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda v, f, p: (v, f, p | {NAMES[0]: p[NAMES[3]], NAMES[3]: p[NAMES[0]], NAMES[6]: p[NAMES[7]]}),
            "mm .RMS. from",
        ),
        (lambda v, f, p: (v, f, dict(list(p.items())[:4])), "at least 5 of the nine"),
        (lambda v, f, p: (v, f, {n: x + np.array([0, 0, 0.5]) for n, x in p.items()}), "none near|mm off"),
        (lambda v, f, p: (v, f[:100], p), "at least 200 triangles"),
        (
            lambda v, f, p: (
                v[f].reshape(-1, 3) + np.random.default_rng(0).normal(size=(3 * len(f), 3)) * 1e-4,
                np.arange(3 * len(f)).reshape(-1, 3),
                p,
            ),
            "hang together",
        ),
        (lambda v, f, p: (v, f[v[f][:, :, 2].min(1) > 0.012], p), "can be closed|triangles|mm off"),
    ],
    ids=["swapped sides", "few landmarks", "another frame", "few triangles", "soup", "a sliver of face"],
)
def test_what_is_hopeless_is_refused_in_one_line(tmp_path, spoil, words):
    vertices, faces, points = spoil(*egg(), landmarks_on_egg())
    with pytest.raises(InputError, match=words) as caught:
        scan_subject(write_scan(tmp_path, vertices, faces, points))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"ply\nnonsense", b"solid \x00\x01"])
def test_a_damaged_file_is_refused(tmp_path, content):
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(InputError):
        read_scan_mesh(tmp_path / "bad.ply")


def test_landmark_files_of_every_form_agree(tmp_path):
    from sira_assets.scene.canonical import IBUG68_OF_CANONICAL

    nine = landmarks_on_egg()
    all68 = np.zeros((68, 3))
    for name, row in IBUG68_OF_CANONICAL.items():
        all68[row] = nine[name]
    rows = {n: p.tolist() for n, p in nine.items()}
    (tmp_path / "names.json").write_text(json.dumps({"landmarks_m": rows}))
    (tmp_path / "68.json").write_text(json.dumps({"landmarks_m": all68.tolist()}))
    (tmp_path / "both.json").write_text(json.dumps({"landmarks_m": rows, "lm68_m": all68.tolist()}))
    (tmp_path / "list.json").write_text(json.dumps(all68.tolist()))

    def picked(points, names):
        body = "".join(
            f'<point active="1" x="{x!r}" y="{y!r}" z="{z!r}" name="{name}"/>'
            for name, (x, y, z) in zip(names, np.asarray(points).tolist(), strict=True)
        )
        unused = '<point active="0" x="9" y="9" z="9" name="q"/>'
        return f"<!DOCTYPE PickedPoints>\n<PickedPoints>{body}{unused}</PickedPoints>"

    order = [nine[name] for name in NAMES]
    (tmp_path / "named.pp").write_text(picked(order[::-1], NAMES[::-1]))
    (tmp_path / "ordered.pp").write_text(picked(order, range(9)))
    (tmp_path / "68.pp").write_text(picked(all68, range(68)))
    for name in ("names.json", "68.json", "both.json", "list.json", "named.pp", "ordered.pp", "68.pp"):
        read = read_scan_landmarks(tmp_path / name)
        assert {n: pytest.approx(p) for n, p in nine.items()} == dict(read.nine), name
        assert (read.all68 is not None) == ("68" in name or name in ("both.json", "list.json"))
    (tmp_path / "seven.pp").write_text(picked(order[:7], range(7)))
    with pytest.raises(InputError, match="7 points named 0, 1"):
        read_scan_landmarks(tmp_path / "seven.pp")


def test_another_view_costs_a_scene_its_picture_and_mask_alone(tmp_path):
    import tracemalloc

    from data_synth.draw_scene import draw_scene
    from data_synth.scene_settings import SceneSettings

    source = write_scan(tmp_path, *egg(3), landmarks_on_egg())

    def held(views):
        settings = SceneSettings(kind="scan", scan=source, views=views, size=64, samples=1, truth="train")
        draw_scene(settings, 0)  # tables and the scan are kept from the first scene on
        tracemalloc.start()
        try:
            scene = draw_scene(settings, 0)
            assert len(scene.cameras) == views
            return tracemalloc.get_traced_memory()[0]
        finally:
            tracemalloc.stop()

    # 13 bytes a pixel: three floats and a bool; so many again for the camera and lists. All maps have 125.
    assert (held(5) - held(1)) / (4 * 64**2) < 26


@pytest.mark.slow
def test_training_reads_a_real_scan(real_data, tmp_path):
    """A bust open at the neck, with vertex colours, separate eyes and 68 landmarks."""
    from data_synth.draw_scene import draw_scene
    from data_synth.scene_settings import SceneSettings
    from data_synth.write_scene import write_scene
    from sira_assets.train.scenes import SampleConfig, sample_scene

    folder = real_data / "heads" / "ict_a"
    source = ScanSource("ict_a", str(folder / "mesh.ply"), str(folder / "landmarks.json"), metres_per_unit=1.0)
    settings = SceneSettings(kind="scan", views=2, size=48, samples=8, scan=source)
    scene = draw_scene(settings, 0)
    write_scene(scene, tmp_path / "ict_a_000000")
    samples = sample_scene(
        tmp_path / "ict_a_000000", SampleConfig(surface=500, near=800, far=800, pixels_per_view=300), seed=0
    )
    assert len(samples.anchors) == len(NAMES)
    assert np.isfinite(samples.anchors).all()
    assert len(samples.volume) == len(samples.volume_sdf) <= 1600
    # Half of the points are all over the box, some of them below the neck, nearest to its cap.
    assert len(samples.volume) > 0.8 * 1600
    assert np.isfinite(samples.pixel_diffuse[:50]).all()
    truth = scene.full
    assert (np.abs(truth.sdf) < 0.5).all()
    assert 0.9 < truth.sdf_known.mean() < 1.0
    landmarks = json.loads((tmp_path / "ict_a_000000" / "gt" / "landmarks.json").read_text())
    assert np.array(landmarks["views"][0]["lm68_visible"]).mean() > 0.7
    assert not (tmp_path / "ict_a_000000" / "gt" / "regions.json").exists()
