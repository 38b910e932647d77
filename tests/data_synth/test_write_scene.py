"""A written scene: read back by the project's readers, whole or absent, in the real scenes' format."""

import json

import numpy as np
import pytest
from PIL import Image

import data_synth.write_scene
from data_synth.cameras import CameraConfig, sample_cameras
from data_synth.dataset import remove_leftovers
from data_synth.light_rigs import sample_rig
from data_synth.render import RayScene, RenderConfig, Surface, render
from data_synth.scene_settings import SceneSettings
from data_synth.synth_scene import Frame, SynthScene
from data_synth.truth import BACKGROUND, full_truth
from data_synth.write_scene import write_scene
from data_synth.write_truth import ply_bytes
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, similarity_scale, transform_points
from sira_assets.scene.exr import read_exr
from sira_assets.scene.image import read_image, read_mask
from sira_assets.scene.read_scene import read_frames, read_scene
from sira_assets.scene.sg_light import SGLight
from sira_assets.train.scenes import SampleConfig, sample_scene

ALBEDO = np.array([0.5, 0.3, 0.2])


@pytest.fixture(scope="module")
def scene() -> SynthScene:
    """Three views of a head-sized ellipsoid through the eyes, chin and nose of the canonical head, roughly."""
    import trimesh

    rng = np.random.default_rng(0)
    x = np.asarray(trimesh.creation.icosphere(4).vertices) * [0.075, 0.12, 0.095] + [0, -0.02, -0.06]
    faces = np.asarray(trimesh.creation.icosphere(4).faces)
    world_from_canonical = np.eye(4)
    world_from_canonical[:3, :3] *= 1.07
    world_from_canonical[:3, 3] = [0.1, -0.2, 0.05]
    mesh = TriangleMesh(x, faces).transformed(world_from_canonical)
    cameras = sample_cameras(rng, x, world_from_canonical, 3, CameraConfig(width=40, height=32))
    light = sample_rig(rng).light().scaled(0.3)
    surface = Surface(mesh, x, lambda p: (np.broadcast_to(ALBEDO, p.shape), np.full(len(p), 0.02)), 0.4)
    rays = RayScene(surface)
    renderings = [render(rays, camera, light, rng, RenderConfig(8, 4)) for camera in cameras]
    second = SGLight([[0, 0, 1]], [10.0], [[1, 1, 1]])
    names = {n: transform_points(world_from_canonical, np.array(p)) for n, p in CANONICAL_LANDMARKS_M.items()}
    full = full_truth(
        rays, cameras, light, mesh, mesh, lambda c: (c[:, 2] > 0).astype(int), {0: "back", 1: "front"}, rng, 16
    )
    return SynthScene(
        mesh=mesh,
        closed=mesh,
        vertex_albedo=np.broadcast_to(ALBEDO, x.shape),
        cameras=cameras,
        frames=[Frame(rendering.image, rendering.mask) for rendering in renderings],
        portrait=renderings[0],
        light=light,
        envmap=None,
        roughness=0.4,
        canonical_from_world=np.linalg.inv(world_from_canonical),
        landmarks_world=names,
        landmarks68_world=np.zeros((68, 3)),
        anchors_world=x[:5],
        relight=(second, render(rays, cameras[0], second, rng, RenderConfig(8))),
        full=full,
        provenance={"index": 0},
    )


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "train_000000"
    write_scene(scene, path)
    return path


def test_the_reader_gives_back_camera_mask_picture_and_head_frame(scene, folder):
    portrait = read_scene(folder)
    assert portrait.camera.world_from_camera == pytest.approx(scene.cameras[0].world_from_camera, abs=1e-12)
    assert portrait.camera.intrinsics == pytest.approx(scene.cameras[0].intrinsics, rel=1e-12)
    assert portrait.canonical_from_world == pytest.approx(scene.canonical_from_world, abs=1e-12)
    assert similarity_scale(portrait.canonical_from_world) == pytest.approx(1 / 1.07)
    assert np.array_equal(portrait.mask, scene.portrait.mask)
    unclipped = scene.portrait.image.max(-1) < 1
    # Half of an 8-bit step, at the steepest place of the sRGB curve's inverse.
    assert np.abs(portrait.image_linear - scene.portrait.image)[unclipped].max() < 0.5 / 255 * 2.4


def test_all_frames_are_found_with_their_pictures_and_masks(scene, folder):
    frames = read_frames(folder)
    assert len(frames) == 3
    for frame, camera, rendered in zip(frames, scene.cameras, scene.frames, strict=True):
        assert frame.camera.world_from_camera == pytest.approx(camera.world_from_camera, abs=1e-12)
        assert np.array_equal(read_mask(frame.mask_path), rendered.mask)
        assert np.array_equal(read_image(frame.image_path.with_suffix(".exr")).linear, rendered.image)


def test_truth_is_written_as_it_was_rendered(scene, folder):
    first = scene.portrait
    for name, expected in (
        ("gt/albedo", first.albedo),
        ("gt/specular", first.specular),
        ("gt/normal", first.normal_world),
        ("gt/depth", first.depth),
        ("gt/position", first.position_world),
        ("gt/alpha", first.alpha),
        ("gt/diffuse_radiance", first.diffuse_radiance),
        ("gt/specular_radiance", first.specular_radiance),
        ("gt/diffuse_unshadowed", first.diffuse_unshadowed),
        ("gt/specular_unshadowed", first.specular_unshadowed),
        ("gt/diffuse_shading", first.diffuse_shading),
        ("image", first.image),
        ("relight/image", scene.relight[1].image),
    ):
        assert np.array_equal(read_exr(folder / f"{name}.exr"), expected), name


def test_light_and_brdf_read_back(scene, folder):
    light = SGLight.from_dict(json.loads((folder / "gt" / "lights.json").read_text()))
    assert np.array_equal(light.amplitude, scene.light.amplitude)
    envmap = read_exr(folder / "gt" / "envmap.exr")
    assert envmap.shape == (128, 256, 3)
    brdf = json.loads((folder / "gt" / "brdf.json").read_text())
    assert brdf["alpha"] == pytest.approx(brdf["roughness"] ** 2)


def test_landmarks_project_where_they_say(scene, folder):
    data = json.loads((folder / "gt" / "landmarks.json").read_text())
    for name in CANONICAL_LANDMARKS_M:
        entry = data[name]
        pixel, _ = scene.cameras[0].project(np.array([entry["xyz_m"]]))
        assert entry["pixel"] == pytest.approx(pixel[0])
        assert data["landmarks_m"][name] == entry["xyz_m"]
    assert len(data["lm68_m"]) == 68
    assert len(data["anchors_m"]) == 5


def test_the_mesh_loads_in_another_program(scene, folder):
    import trimesh

    loaded = trimesh.load(folder / "gt" / "mesh.ply", process=False)
    assert np.array_equal(loaded.faces, scene.mesh.faces)
    # Stored in single precision.
    assert np.abs(loaded.vertices - scene.mesh.vertices).max() < 1e-7
    assert np.array_equal(np.unique(loaded.visual.vertex_colors[:, :3], axis=0)[0], [188, 149, 124])


def test_ply_bytes_do_not_depend_on_array_layout(scene):
    fortran = TriangleMesh(np.asfortranarray(scene.mesh.vertices), scene.mesh.faces, scene.mesh.normals)
    colours = np.random.default_rng(1).random((len(fortran.vertices), 3))
    assert ply_bytes(fortran, np.asfortranarray(colours)) == ply_bytes(scene.mesh, colours)


def test_a_failure_leaves_nothing(scene, tmp_path):
    import dataclasses

    broken = dataclasses.replace(scene, provenance={"index": object()})
    with pytest.raises(TypeError):
        write_scene(broken, tmp_path / "train_000001")
    assert list(tmp_path.iterdir()) == []


def test_leftovers_of_an_interrupted_run_are_removed_once_the_scenes_are_whole(tmp_path):
    for index in (1, 2):
        (tmp_path / f".train_00000{index}.x7.partial" / "images").mkdir(parents=True)
    (tmp_path / "train_000001").mkdir()
    (tmp_path / "train_000001" / "transforms.json").touch()
    (tmp_path / ".train-a0b1.json").touch()
    remove_leftovers(tmp_path, SceneSettings(), range(1, 3))
    # Another run may be at work on the other.
    assert {p.name for p in tmp_path.iterdir()} == {"train_000001", ".train_000002.x7.partial"}


def test_a_run_that_begins_or_ends_while_another_writes_the_same_scene_leaves_it_whole(
    scene, folder, tmp_path, monkeypatch
):
    def interrupted(*arguments):
        remove_leftovers(tmp_path, SceneSettings(), range(1))
        write_truth(*arguments)

    write_truth = data_synth.write_scene.write_truth
    monkeypatch.setattr(data_synth.write_scene, "write_truth", interrupted)
    write_scene(scene, tmp_path / "train_000000")
    assert [p.name for p in tmp_path.iterdir()] == ["train_000000"]
    written = {p.relative_to(tmp_path / "train_000000") for p in (tmp_path / "train_000000").rglob("*")}
    assert written == {p.relative_to(folder) for p in folder.rglob("*")}


def test_a_writer_whose_scene_another_run_has_finished_meanwhile_fails_at_nothing(scene, tmp_path, monkeypatch):
    def overtaken(path, pixels):
        monkeypatch.undo()
        data_synth.write_scene.write_png(path, pixels)
        write_scene(scene, tmp_path / "train_000000")
        remove_leftovers(tmp_path, SceneSettings(), range(1))

    monkeypatch.setattr(data_synth.write_scene, "write_png", overtaken)
    write_scene(scene, tmp_path / "train_000000")
    assert [p.name for p in tmp_path.iterdir()] == ["train_000000"]
    assert read_scene(tmp_path / "train_000000").mask.any()


def test_of_two_writers_of_one_scene_the_first_wins(scene, folder):
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*")}
    write_scene(scene, folder)
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("*")} == before
    assert [p.name for p in folder.parent.iterdir()] == [folder.name]


def test_full_truth_reads_back(scene, folder):
    full = scene.full
    for k in range(len(scene.light)):
        assert np.array_equal(read_exr(folder / "gt" / "visibility" / f"{k:03d}.exr"), full.visibility[k])
    for k, frame in enumerate(scene.frames):
        region = np.asarray(Image.open(folder / "gt" / "regions" / f"{k:03d}.png"))
        assert np.array_equal(region != BACKGROUND, frame.mask)
    assert json.loads((folder / "gt" / "regions.json").read_text()) == {"0": "back", "1": "front"}
    with np.load(folder / "gt" / "sdf.npz") as data:
        assert np.array_equal(data["points_m"], full.sdf_points_world)
        assert np.array_equal(data["sdf_m"], full.sdf)
        assert data["known"].all()


def test_the_training_truth_is_what_training_reads(scene, tmp_path):
    import dataclasses

    write_scene(dataclasses.replace(scene, full=None), tmp_path / "small")
    names = {p.relative_to(tmp_path / "small").as_posix() for p in (tmp_path / "small").rglob("*") if p.is_file()}
    maps = {"gt/albedo.exr", "gt/specular.exr", "gt/alpha.exr"}
    assert {n for n in names if n.endswith(".exr")} == maps | {"relight/image.exr", "relight/envmap.exr"}
    samples = sample_scene(tmp_path / "small", SampleConfig(surface=50, near=50, far=50, pixels_per_view=20), seed=0)
    assert np.isfinite(samples.pixel_diffuse).any()
    assert np.isfinite(samples.anchors).all()


def test_files_are_named_as_in_the_real_scenes(folder, real_data):
    real = real_data / "scenes" / "ict_a_soft"
    ours = {p.relative_to(folder).as_posix() for p in folder.rglob("*")}
    theirs = {p.relative_to(real).as_posix() for p in real.rglob("*")}
    # A real scene has held-out views in novel/ where ours has many frames, and variants of the picture by bounces.
    variants = {"README", "image_direct.exr", "image_unshadowed.exr", "relight/image_unshadowed.exr"}
    assert {t for t in theirs if not t.startswith("novel")} - variants <= ours
    real_data_keys = set(json.loads((real / "gt" / "landmarks.json").read_text())["chin"])
    assert set(json.loads((folder / "gt" / "landmarks.json").read_text())["chin"]) == real_data_keys
    assert set(json.loads((folder / "gt" / "brdf.json").read_text())) == set(
        json.loads((real / "gt" / "brdf.json").read_text())
    )
    assert set(json.loads((real / "transforms.json").read_text())) <= set(
        json.loads((folder / "transforms.json").read_text())
    )
