"""Whole heads: closed, repeatable, canonical, in correspondence, and of plausible colour."""

import numpy as np
import pytest
import trimesh

from data_synth.head.build import build_head
from data_synth.head.grid import evaluate_template
from data_synth.head.material import Region
from data_synth.head.params import mean_params, sample_params
from data_synth.head.skin import skin_albedo
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M, similarity

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def heads():
    """Two random heads with hair, and the mean head without."""
    rng = np.random.default_rng(5)
    return [build_head(sample_params(rng)), build_head(sample_params(rng)), build_head(mean_params())]


def test_meshes_are_watertight_outward_and_sound(heads):
    for head in heads:
        mesh = trimesh.Trimesh(head.vertices_m, head.faces, process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert 0.003 < mesh.volume < 0.02  # cubic metres: a head with shoulders
        assert np.isfinite(head.vertices_m).all()


def test_same_seed_same_bytes(heads):
    again = build_head(sample_params(np.random.default_rng(5)))
    assert again.vertices_m.tobytes() == heads[0].vertices_m.tobytes()
    assert again.faces.tobytes() == heads[0].faces.tobytes()
    x = again.template_positions_m[::50]
    assert again.material(x)[0].tobytes() == heads[0].material(x)[0].tobytes()


def test_heads_are_in_the_canonical_frame(heads):
    target = np.array([CANONICAL_LANDMARKS_M[n] for n in CANONICAL_LANDMARKS_M])
    for head in heads:
        nine = np.array([head.landmarks9[n] for n in CANONICAL_LANDMARKS_M])
        # the best similarity left to do is none
        assert np.abs(similarity(nine, target) - np.eye(4)).max() < 1e-9


def test_vertices_are_the_warped_template(heads):
    for head in heads:
        pick = slice(None, None, 997)
        assert np.abs(head.from_template(head.template_positions_m[pick]) - head.vertices_m[pick]).max() < 1e-9


def test_anchors_correspond_and_lie_on_the_skin(heads):
    first = heads[0].anchors_template_m
    # vertices of a marching-cubes mesh of 1.3 to 2.6 mm cells: within a tenth of a cell of the surface
    assert np.abs(evaluate_template(first)).max() < 2.5e-4
    for head in heads[1:]:
        assert np.array_equal(head.anchors_template_m, first)
        assert head.anchors_m.shape == (400, 3)


def test_material_is_physical_and_regions_are_present(heads):
    for head in heads:
        diffuse, specular = head.material(head.template_positions_m[::20])
        assert diffuse.min() > 0
        assert diffuse.max() < 0.95
        assert specular.min() > 0
        assert specular.max() <= 0.05
        present = set(np.unique(head.region).tolist())
        assert {int(Region.SKIN), int(Region.LIPS), int(Region.EYE), int(Region.BROW)} <= present


def test_irises_are_darker_than_the_white_of_the_eye(heads):
    head = heads[2]
    x = np.array([[0.0308, 0.003, 0.0117], [0.0395, -0.0015, 0.0075]])
    diffuse, _ = head.material(x)
    assert diffuse[0].mean() < 0.4 * diffuse[1].mean()


def test_skin_darkens_with_melanin_and_reddens_with_blood():
    melanin = np.linspace(0.013, 0.43, 20)
    albedo = skin_albedo(melanin, np.full(20, 0.008))
    assert (np.diff(albedo, axis=0) < 0).all()
    assert (albedo[:, 0] > albedo[:, 1]).all()
    assert (albedo[:, 1] > albedo[:, 2]).all()
    blood = skin_albedo(np.full(20, 0.05), np.linspace(0.002, 0.03, 20))
    assert (np.diff(blood[:, 0] / blood[:, 1]) > 0).all()
    luminance = albedo @ [0.2126, 0.7152, 0.0722]
    assert luminance[0] > 0.35
    assert luminance[-1] < 0.05
