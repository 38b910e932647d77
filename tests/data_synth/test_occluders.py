"""Things held before a face: before it, near it, hiding some of it and not all."""

import numpy as np

from data_synth.occluders import sample_occluder
from sira_assets.mesh.raycast import Raycaster
from sira_assets.mesh.triangle_mesh import TriangleMesh


def head() -> TriangleMesh:
    import trimesh

    ball = trimesh.creation.icosphere(4, 1.0)
    return TriangleMesh(np.asarray(ball.vertices) * [0.075, 0.115, 0.1] - [0, 0.02, 0.09], ball.faces)


def test_every_draw_hides_some_of_the_face_and_touches_none():
    mesh, kinds, shares = head(), set(), []
    towards = np.array([0.3, 0.1, 1.0]) / np.sqrt(1.1)
    on = mesh.vertices[(mesh.normals @ towards) > 0.3]
    for seed in range(30):
        held = sample_occluder(np.random.default_rng(seed), mesh.vertices, np.array([0.0, -0.02, 0.0]), towards)
        kinds.add(held.kind)
        caster = Raycaster(held.mesh)
        shares.append(caster.occluded(on, np.broadcast_to(towards, on.shape)).mean())
        assert np.abs(held.mesh.vertices - [0, -0.02, 0]).max() < 0.35
        assert caster.closest(mesh.vertices).distance.min() > 0.005
        assert held.albedo.min() >= 0
        assert held.albedo.max() <= 0.8
    assert kinds == {"ball", "box", "hand"}
    assert max(shares) < 0.9
    # A ball of 2 cm held 9 cm aside may miss the face; most do not.
    assert np.median(shares) > 0.03
