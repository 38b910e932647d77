"""The generator's renderer against Mitsuba 3."""

import numpy as np
import pytest

from data_synth.render import RayScene, RenderConfig, Surface, render
from sira_assets.mesh.triangle_mesh import TriangleMesh
from sira_assets.numerics.colour import srgb_from_linear
from sira_assets.scene.camera import OPENCV_FROM_OPENGL, Camera
from sira_assets.scene.sg_light import SGLight
from tests.data_synth.path_tracer import trace_diffuse


def blob_with_a_roof() -> TriangleMesh:
    """A bumpy ball under a smaller one: curved, self-shadowing, closed."""
    import trimesh

    ball = trimesh.creation.icosphere(5, 0.1)
    x = np.asarray(ball.vertices)
    lower = x * (1 + 0.08 * np.sin(40 * x[:, :1]) * np.cos(35 * x[:, 1:2]))
    upper = 0.45 * x + [0.05, 0.12, 0.06]
    faces = np.asarray(ball.faces)
    return TriangleMesh(np.concatenate([lower, upper]), np.concatenate([faces, faces + len(x)]))


@pytest.mark.slow
def test_agrees_with_an_independent_path_tracer():
    mesh = blob_with_a_roof()
    rng = np.random.default_rng(3)
    albedo = 0.35 + 0.3 * np.sin(60 * mesh.vertices + rng.uniform(0, 6, 3))
    light = SGLight(
        [[0.5, 0.6, 0.6], [-0.8, 0.1, 0.5], [0.1, 1.0, 0.1]],
        [60.0, 6.0, 0.4],
        [[9.0, 8.0, 7.0], [0.5, 0.7, 1.0], [0.15, 0.15, 0.2]],
    )
    pose = np.eye(4)
    pose[:3, 3] = [0.02, 0.03, 0.8]
    camera = Camera([[330, 0, 64], [0, 330, 64], [0, 0, 1]], pose @ OPENCV_FROM_OPENGL, 128, 128)
    surface = Surface(mesh, albedo, lambda x: (x.astype(np.float32), np.zeros(len(x), np.float32)), 0.4)
    ours = render(RayScene(surface), camera, light, np.random.default_rng(0), RenderConfig(64, 16))
    theirs = trace_diffuse(mesh, albedo, camera, light, samples=1024)
    encoded = [srgb_from_linear(np.clip(image, 0, 1))[ours.mask] for image in (ours.image, theirs)]
    psnr = -10 * np.log10(np.mean((encoded[0] - encoded[1]) ** 2))
    # What is left is the path tracer's own noise at 1024 samples and edge pixels, sampled 16 times here.
    assert psnr >= 38.0
