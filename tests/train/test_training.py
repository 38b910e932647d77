"""The losses are what the paper says, and a stopped training goes on exactly."""

import numpy as np
import pytest
import torch

from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig
from sira_assets.numerics.srgb import srgb_encode
from sira_assets.train.appearance import AppearanceTrainConfig, train_appearance
from sira_assets.train.batches import SampleTensors, draw, stack, step_generator
from sira_assets.train.scenes import SceneSamples
from sira_assets.train.shape import ShapeTrainConfig, learning_rate, new_codes, shape_losses, train_shape

MODEL = ShapeConfig(code_size=4, appearance_code_size=4, feature_size=2, deformation_width=16, reference_width=24)
SHORT = ShapeTrainConfig(
    steps=12, scenes_per_step=3, pixels=16, surface=8, volume=8, volume_no_gradient=8, anchors=6, reference_steps=4
)


def sphere_scene(radius, seed) -> SceneSamples:
    """A sphere, network units, with exact samples; its colour is its normal."""
    rng = np.random.default_rng(seed)

    def directions(n):
        d = rng.normal(size=(n, 3))
        return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)

    n, p, v = directions(400), directions(500), rng.uniform(-2, 2, (400, 3)).astype(np.float32)
    anchors = np.random.default_rng(99).normal(size=(20, 3))
    anchors = (radius * anchors / np.linalg.norm(anchors, axis=1, keepdims=True)).astype(np.float32)
    return SceneSamples(
        surface=radius * n,
        surface_normals=n,
        volume=v,
        volume_sdf=(np.linalg.norm(v, axis=1) - radius).astype(np.float32),
        anchors=anchors,
        pixels=radius * p,
        pixel_normals=p,
        pixel_view=p,
        pixel_rgb=0.5 + 0.3 * p,
        pixel_diffuse=np.full_like(p, 0.4),
        pixel_specular=np.full(len(p), 0.03, np.float32),
    )


@pytest.fixture(scope="module")
def spheres() -> SampleTensors:
    return stack([sphere_scene(r, i) for i, r in enumerate((0.8, 0.9, 1.0, 1.1))])


def test_every_term_vanishes_on_a_perfect_model(spheres):
    """A reference that is the unit ball and no deformation: only the radius-one scene is explained, exactly."""
    model = ShapeAppearanceModel(MODEL)
    with torch.no_grad():
        for net in (model.deformation, model.reference):
            net.out.weight.zero_()
            net.out.bias.zero_()
    one = stack([sphere_scene(1.0, 7)])
    codes = new_codes(1, MODEL, 0)
    with torch.no_grad():
        codes.z_sdf.zero_()
        codes.z_r.zero_()
    losses = shape_losses(model, codes, one, SHORT, 0)
    for name in ("surface", "sdf", "eikonal", "normal", "deformation", "landmark", "embedding"):
        # the guard inside the square root (1e-6) and float32 rounding
        assert float(losses[name].detach()) < 2e-5, name


def test_deformation_term_is_size_plus_mean(spheres):
    model = ShapeAppearanceModel(MODEL)
    with torch.no_grad():
        model.deformation.out.weight.zero_()
        model.deformation.out.bias.zero_()
        model.deformation.out.bias[:3] = torch.tensor([0.3, 0.0, 0.4])
    losses = shape_losses(model, new_codes(4, MODEL, 0), spheres, SHORT, 0)
    assert losses["deformation"].item() == pytest.approx(0.5 + 0.5, rel=1e-5)  # |delta| = |mean delta| = 0.5


def test_landmark_term_is_the_mean_over_pairs(spheres):
    model = ShapeAppearanceModel(MODEL)
    with torch.no_grad():
        model.deformation.out.weight.zero_()
        model.deformation.out.bias.zero_()
    config = ShapeTrainConfig(**{**vars(SHORT), "scenes_per_step": 4, "anchors": 20})
    losses = shape_losses(model, new_codes(4, MODEL, 0), spheres, config, 0)
    radii = (0.8, 0.9, 1.0, 1.1)
    pairs = [(a - b) ** 2 for a in radii for b in radii if a != b]
    assert losses["landmark"].item() == pytest.approx(np.mean(pairs), rel=1e-4)


def test_training_brings_the_losses_down(spheres, tmp_path):
    config = ShapeTrainConfig(**{**vars(SHORT), "steps": 250, "reference_steps": 50})
    torch.manual_seed(config.seed)
    first = shape_losses(ShapeAppearanceModel(MODEL), new_codes(4, MODEL, 0), spheres, config, 0)
    last = {}
    train_shape(spheres, tmp_path, model_config=MODEL, config=config, report=lambda step, losses: last.update(losses))
    assert last["surface"] < 0.7 * first["surface"].item()
    assert last["colour"] < first["colour"].item()


def test_a_resumed_training_is_the_same_training(spheres, tmp_path):
    whole, _ = train_shape(spheres, tmp_path / "a", model_config=MODEL, config=SHORT)

    class Stop(Exception):
        pass

    def stop(step, losses):
        raise Stop

    # Saved at step 6, killed later; every step after the save is done again.
    with pytest.raises(Stop):
        train_shape(
            spheres,
            tmp_path / "b",
            model_config=MODEL,
            config=ShapeTrainConfig(**{**vars(SHORT), "steps": 12}),
            save_every=6,
            report=stop,
        )
    resumed, _ = train_shape(spheres, tmp_path / "b", model_config=MODEL, config=SHORT, resume=True)
    for a, b in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_appearance_training_learns_and_resumes(spheres, tmp_path):
    shape, codes = train_shape(spheres, tmp_path / "s", model_config=MODEL, config=SHORT)
    config = AppearanceTrainConfig(steps=60, scenes_per_step=2, pixels=64, supervision=1.0)
    first, last = {}, {}

    def report(step, losses):
        (first if not first else last).update(losses)

    whole, _ = train_appearance(spheres, shape, codes, tmp_path / "a", config=config, report=report)
    assert last["supervision"] < first["supervision"]
    train_appearance(
        spheres,
        shape,
        codes,
        tmp_path / "b",
        config=AppearanceTrainConfig(**{**vars(config), "steps": 60}),
        save_every=30,
    )
    again, _ = train_appearance(spheres, shape, codes, tmp_path / "b", config=config, resume=True)
    for a, b in zip(whole.parameters(), again.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_steps_draw_the_same_samples_whenever_they_are_drawn(spheres):
    a = draw((spheres.pixels,), torch.tensor([0, 2]), 5, step_generator(3, 17))
    step_generator(3, 16)
    b = draw((spheres.pixels,), torch.tensor([0, 2]), 5, step_generator(3, 17))
    torch.testing.assert_close(a[0], b[0], rtol=0, atol=0)
    assert a[0].shape == (10, 3)


def test_srgb_encoding_of_known_values():
    x = torch.tensor([0.0, 0.0031308, 0.18, 1.0, 4.0], dtype=torch.float64, requires_grad=True)
    y = srgb_encode(x)
    # 0.18 encodes to 0.4614 (IEC 61966-2-1)
    torch.testing.assert_close(
        y.detach(), torch.tensor([0.0, 0.04045, 0.46135612950044164, 1.0, 1.0]).double(), atol=2e-5, rtol=0
    )
    y.sum().backward()
    assert torch.isfinite(x.grad).all()


def test_learning_rate_warms_up_and_falls_to_a_fiftieth():
    assert learning_rate(0, 1000) == pytest.approx(0.01)
    assert learning_rate(100, 1000) > 0.95
    assert learning_rate(1000, 1000) == pytest.approx(0.02)
