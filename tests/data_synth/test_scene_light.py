"""A scene's light: exposed for the face, rigs with the head, panoramas about the vertical with their gaussians."""

import json

import numpy as np
import pytest

from data_synth.lights import face_luminance
from data_synth.render_source import LUMINANCE
from data_synth.scene_light import PanoramaFile, sample_scene_light
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.scene.envmap import envmap_from_sg, write_envmap
from sira_assets.scene.sg_light import SGLight

LIGHT = SGLight([[0.3, 0.2, 0.9], [0, 1, 0]], [20.0, 1.0], [[300, 200, 100], [10, 20, 40]])


def ball() -> TriangleMesh:
    import trimesh

    mesh = trimesh.creation.icosphere(3, 0.1)
    return TriangleMesh(mesh.vertices, mesh.faces)


@pytest.fixture
def panorama(tmp_path) -> PanoramaFile:
    write_envmap(tmp_path / "room.exr", envmap_from_sg(LIGHT, 64))
    return PanoramaFile(str(tmp_path / "room.exr"), json.dumps(LIGHT.to_dict()))


def draw(seed, panoramas=()):
    mesh = ball()
    albedo, face = np.full((len(mesh.vertices), 3), 0.3), mesh.vertices[:, 2] > 0.05
    light = sample_scene_light(np.random.default_rng(seed), mesh, albedo, face, np.eye(3), panoramas)
    return light, face_luminance(mesh, albedo, light.rendered, face)


def test_rigs_and_panoramas_expose_the_face(panorama):
    for seed in range(30):
        for panoramas in ((), (panorama,)):
            # The range of sample_exposure at an albedo of 0.3.
            assert 0.065 * 0.99 < draw(seed, panoramas)[1] < 0.36 * 2**0.4 * 1.01


def test_a_panorama_and_its_gaussians_turn_together(panorama):
    turns = []
    for seed in range(6):
        light, _ = draw(seed, (panorama,))
        shown, stands_for = light.envmap.radiance, envmap_from_sg(light.gaussians, 64).radiance
        # The map was made from these very gaussians; a turn by whole columns changes nothing but rounding.
        assert np.abs(shown - stands_for).max() < 1e-3 * shown.max()
        assert light.rendered.envmap is light.envmap
        turns.append(int((shown @ LUMINANCE).sum(0).argmax()))
    assert len(set(turns)) > 3


def test_same_seed_same_light(panorama):
    one, two = (draw(5, (panorama,))[0] for _ in range(2))
    assert one.envmap.radiance.tobytes() == two.envmap.radiance.tobytes()
    assert one.gaussians.to_dict() == two.gaussians.to_dict()


def test_a_file_is_described_by_its_content(panorama):
    described = panorama.described()
    assert described["file"] == "room.exr"
    assert PanoramaFile(panorama.path, panorama.lights).described() == described
    assert PanoramaFile(panorama.path, "{}").described() != described
