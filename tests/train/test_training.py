"""The losses are what the paper says, and a stopped training goes on exactly."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig
from sira_assets.numerics.srgb import srgb_encode
from sira_assets.train.appearance import AppearanceTrainConfig, train_appearance
from sira_assets.train.batches import Batch, SampleTensors, open_stack, stack, step_generator, write_stack
from sira_assets.train.checkpoint import read_header
from sira_assets.train.guard import GuardedOptimiser
from sira_assets.train.loop import learning_rate
from sira_assets.train.parallel import Share
from sira_assets.train.scenes import SceneSamples
from sira_assets.train.shape import ShapeTrainConfig, new_codes, principal_codes, shape_losses, train_shape

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


def linear_heads(count: int, modes: int, seed: int = 0):
    """Heads (count, 60, 3) of a linear model whose modes are orthogonal and ever smaller, and their coefficients."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(180, modes)))[0].T
    coefficients = rng.normal(size=(count, modes)) * 0.5 ** np.arange(modes)
    coefficients -= coefficients.mean(0)
    return torch.as_tensor((coefficients @ basis).reshape(count, 60, 3)), coefficients


def test_principal_codes_order_heads_as_they_differ():
    points, coefficients = linear_heads(200, 6)
    codes = principal_codes(points, 4).numpy()
    assert codes.shape == (200, 4)
    width = codes.std(0)
    assert width[0] == pytest.approx(0.45, rel=0.02)  # a millimetre of noise takes a hundredth of the widest mode
    assert np.all(np.diff(width) < 0)
    # In 200 draws the principal axes lie near the model's own; the widest two are told apart without doubt.
    for k in range(2):
        assert abs(np.corrcoef(codes[:, k], coefficients[:, k])[0, 1]) > 0.98
    # Where heads stand and which comes first does not matter.
    moved = principal_codes(points + torch.tensor([1.0, -2.0, 3.0]), 4).numpy()
    np.testing.assert_allclose(moved, codes, atol=1e-9)
    np.testing.assert_allclose(principal_codes(points.flip(0), 4).numpy()[::-1], codes, atol=1e-9)


def test_a_head_that_lacks_points_gets_the_likeliest_code():
    points, _ = linear_heads(60, 3)
    whole = principal_codes(points, 3)
    holed = points.clone()
    holed[5, 20:] = torch.nan  # 60 of 180 numbers are left, many more than three unknowns
    codes = principal_codes(holed, 3)
    others = [i for i in range(60) if i != 5]
    # The axes themselves come from 59 heads instead of 60.
    np.testing.assert_allclose(codes[others], whole[others], atol=0.03)
    np.testing.assert_allclose(codes[5], whole[5], atol=0.05)
    nothing = points.clone()
    nothing[5] = torch.nan
    assert principal_codes(nothing, 3)[5].abs().max() == 0.0  # the mean head


def test_few_heads_or_equal_ones_start_as_in_the_paper():
    points, _ = linear_heads(8, 3)
    assert principal_codes(points[:1], 3).shape == (1, 0)
    assert principal_codes(points[:1].expand(9, -1, -1), 3).shape == (9, 0)
    assert principal_codes(points, 30).shape == (8, 3)
    lacking = points.clone()
    lacking[:, 0] = torch.nan
    assert principal_codes(lacking, 3).shape == (8, 0)
    paper, started = new_codes(8, MODEL, 0), new_codes(8, MODEL, 0, principal_codes(points, 30).float())
    assert torch.equal(paper.z_sdf[:, 3:], started.z_sdf[:, 3:])
    assert torch.equal(paper.z_r, started.z_r)
    assert not torch.equal(paper.z_sdf[:, :3], started.z_sdf[:, :3])


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


@pytest.mark.parametrize("reference", [True, False])
def test_shapes_alone_are_learnt_without_the_renderer(spheres, tmp_path, reference):
    """The renderer stays what it was, the surface is learnt."""
    model_config = replace(MODEL, reference=reference, joint_appearance=False)
    config = replace(SHORT, steps=220, reference_steps=20)
    torch.manual_seed(config.seed)
    start = ShapeAppearanceModel(model_config)
    first = shape_losses(start, new_codes(4, model_config, 0), spheres, config, 0)
    assert "colour" not in first
    last = {}
    model, *_ = train_shape(
        spheres, tmp_path, model_config=model_config, config=config, report=lambda step, losses: last.update(losses)
    )
    for a, b in zip(start.renderer.parameters(), model.renderer.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)
    assert last["surface"] < 0.7 * first["surface"].item()


class Stop(Exception):
    """A kill."""


def stop(step, losses):
    """A report that kills the run."""
    raise Stop


def test_a_resumed_training_is_the_same_training(spheres, tmp_path):
    whole, *_ = train_shape(spheres, tmp_path / "a", model_config=MODEL, config=SHORT)
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
    resumed, *_ = train_shape(spheres, tmp_path / "b", model_config=MODEL, config=SHORT, resume=True)
    for a, b in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_appearance_training_learns_and_resumes(spheres, tmp_path):
    shape, codes, _ = train_shape(spheres, tmp_path / "s", model_config=MODEL, config=SHORT)
    config = AppearanceTrainConfig(steps=60, scenes_per_step=2, pixels=64, supervision=1.0)
    first, last = {}, {}

    def report(step, losses):
        (first if not first else last).update(losses)

    whole, *_ = train_appearance(spheres, shape, codes, tmp_path / "a", config=config, report=report)
    assert last["supervision"] < first["supervision"]

    # Saved at step 30, killed at the report of step 50.
    with pytest.raises(Stop):
        train_appearance(spheres, shape, codes, tmp_path / "b", config=config, save_every=30, report=stop)
    assert read_header(tmp_path / "b" / "appearance.safetensors")["step"] == "30"
    again, *_ = train_appearance(spheres, shape, codes, tmp_path / "b", config=config, resume=True)
    for a, b in zip(whole.parameters(), again.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_appearance_does_not_go_on_upon_another_shape(spheres, tmp_path):
    config = AppearanceTrainConfig(steps=2, scenes_per_step=2, pixels=16)
    shapes = [
        train_shape(spheres, tmp_path / str(seed), model_config=MODEL, config=replace(SHORT, steps=2, seed=seed))
        for seed in (0, 1)
    ]
    train_appearance(spheres, *shapes[0][:2], tmp_path, config=config)
    train_appearance(spheres, *shapes[0][:2], tmp_path, config=config, resume=True)
    with pytest.raises(InputError, match="this very run"):
        train_appearance(spheres, *shapes[1][:2], tmp_path, config=config, resume=True)
    moved = replace(shapes[0][1], z_sdf=torch.nn.Parameter(shapes[0][1].z_sdf + 1e-6))
    with pytest.raises(InputError, match="this very run"):
        train_appearance(spheres, shapes[0][0], moved, tmp_path, config=config, resume=True)


def test_steps_draw_the_same_samples_whenever_they_are_drawn(spheres):
    a = Batch.of_step(3, 17, 2, len(spheres)).draw((spheres.pixels,), 5)
    step_generator(3, 16)
    b = Batch.of_step(3, 17, 2, len(spheres)).draw((spheres.pixels,), 5)
    torch.testing.assert_close(a[0], b[0], rtol=0, atol=0)
    assert a[0].shape == (10, 3)


def test_processes_draw_the_parts_of_one_step(spheres):
    whole = Batch.of_step(0, 5, 4, len(spheres))
    parts = [Batch.of_step(0, 5, 4, len(spheres), Share(rank, 2)) for rank in (0, 1)]

    def drawn(batch):
        return (
            batch.draw((spheres.pixels, spheres.pixel_rgb), 7)[1],
            batch.same_of_all(spheres.anchors, 12, always=9).flatten(0, 1),
            batch.normal(7, 3),
            batch.codes(torch.arange(4.0)[:, None], 2),
        )

    for one, *two in zip(drawn(whole), *map(drawn, parts), strict=True):
        torch.testing.assert_close(one, torch.cat(two), rtol=0, atol=0)


def test_a_stack_on_disk_is_the_stack_in_memory(tmp_path):
    scenes = [sphere_scene(r, i) for i, r in enumerate((0.8, 1.0))]
    write_stack(scenes, tmp_path)
    for name, column in vars(open_stack(tmp_path)).items():
        torch.testing.assert_close(column, getattr(stack(scenes), name), rtol=0, atol=0)


def test_a_scan_without_correspondences_only_gives_its_landmarks(spheres):
    """Landmarks of a scan with nine anchors count like those of the others; the rest of its row is unknown."""
    few = sphere_scene(0.7, 8)
    data = stack([sphere_scene(1.0, 3), replace(few, anchors=few.anchors[:9])])
    assert torch.isnan(data.anchors[1, 9:]).all()
    model = ShapeAppearanceModel(MODEL)
    with torch.no_grad():
        model.deformation.out.weight.zero_()
        model.deformation.out.bias.zero_()
    losses = shape_losses(model, new_codes(2, MODEL, 0), data, replace(SHORT, anchors=20), 0)
    # Nine anchors known twice, eleven once (which are their own mean): 2 B/(B-1) = 4 times (0.15^2 * 18) / (18 + 11).
    assert losses["landmark"].item() == pytest.approx(4.0 * 0.15**2 * 18 / 29, rel=1e-4)
    assert all(torch.isfinite(value) for value in losses.values())


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


def test_a_checkpoint_of_another_run_is_refused(spheres, tmp_path):
    train_shape(spheres, tmp_path, model_config=MODEL, config=SHORT)
    for changed in ({"config": replace(SHORT, colour=0.4)}, {"config": SHORT, "scenes_digest": "others"}):
        with pytest.raises(InputError, match="this very run"):
            train_shape(spheres, tmp_path, model_config=MODEL, resume=True, **changed)


def test_seconds_of_all_sessions_are_counted(spheres, tmp_path):
    from safetensors import safe_open

    train_shape(spheres, tmp_path, model_config=MODEL, config=SHORT)
    with safe_open(tmp_path / "shape.safetensors", "pt") as file:
        first = float(file.metadata()["seconds"])
    *_, both = train_shape(spheres, tmp_path, model_config=MODEL, config=SHORT, resume=True)
    assert both > first > 0


def test_a_step_that_is_not_finite_goes_back_to_the_last_finite_state():
    x = torch.nn.Parameter(torch.tensor([1.0, 2.0]))
    guard = GuardedOptimiser(torch.optim.SGD([x], lr=0.5), most_refusals=3)
    assert guard.backward(x.square().sum())
    assert guard.step()
    torch.testing.assert_close(x.detach(), torch.zeros(2))
    assert not guard.backward(x.sum() * torch.nan)
    torch.testing.assert_close(x.detach(), torch.tensor([1.0, 2.0]))  # kept before the first step
    assert guard.backward(torch.sqrt(x - x.detach()).sum())  # finite value, infinite gradient
    assert not guard.step()
    assert not guard.exhausted
    guard.backward(x.sum() * torch.inf)
    assert guard.exhausted
    assert torch.isfinite(x).all()


def test_training_that_cannot_be_finite_says_so(spheres, tmp_path):
    broken = replace(spheres, pixel_rgb=torch.full_like(spheres.pixel_rgb, torch.nan))
    with pytest.warns(UserWarning, match="not finite"), pytest.raises(InputError, match="not finite"):
        train_shape(broken, tmp_path, model_config=MODEL, config=SHORT)


PARALLEL = """
import sys, torch
sys.path.insert(0, {tests!r})
from test_training import MODEL, SHORT, sphere_scene
from dataclasses import replace
from sira_assets.fields.sa_sm import ShapeAppearanceModel
from sira_assets.train.batches import stack
from sira_assets.train.parallel import joined_share
from sira_assets.train.shape import new_codes, shape_losses
from sira_assets.train.appearance import AppearanceTrainConfig, appearance_losses, new_appearance_codes
from sira_assets.fields.af_sm import AppearanceConfig, AppearanceFactorModel

data = stack([sphere_scene(r, i) for i, r in enumerate((0.8, 0.9, 1.0, 1.1))])
with joined_share() as share:
    torch.manual_seed(0)
    model, codes = ShapeAppearanceModel(MODEL), new_codes(4, MODEL, 0)
    af = AppearanceFactorModel(AppearanceConfig(lobes=3), feature_size=2)
    af_codes = new_appearance_codes(4, AppearanceConfig(), 0)
    parameters = [*model.parameters(), codes.z_sdf, codes.z_r]
    sum(shape_losses(model, codes, data, replace(SHORT, scenes_per_step=4), 3, share).values()).backward()
    share.average_gradients(parameters)
    own = [*af.parameters(), af_codes.z_a, af_codes.z_s, af_codes.z_l]
    config = AppearanceTrainConfig(scenes_per_step=4, pixels=32, supervision=0.5)
    sum(appearance_losses(af, af_codes, model, codes, data, config, 3, share).values()).backward()
    share.average_gradients(own)
    if share.leads:
        torch.save([p.grad for p in parameters + own], {out!r})
"""


def run_by_processes(size: int, text: str, out: Path) -> None:
    """A script of this file by `size` processes of torchrun with gloo, what it makes at `out`."""
    script = out.with_suffix(".py")
    script.write_text(text.format(tests=str(Path(__file__).parent), out=str(out)))
    command = [sys.executable, "-m", "torch.distributed.run", f"--nproc-per-node={size}", "--standalone"]
    done = subprocess.run([*command, str(script)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_two_processes_have_the_gradient_of_one(tmp_path):
    """torchrun with gloo: all terms, those over the whole step included, to float32 rounding."""
    gradients = []
    for size in (1, 2):
        out = tmp_path / f"{size}.pt"
        run_by_processes(size, PARALLEL, out)
        gradients.append(torch.load(out, weights_only=True))
    for one, two in zip(*gradients, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-6)  # float32 sums in another order


HELD = """
import sys
from dataclasses import replace
from pathlib import Path
sys.path.insert(0, {tests!r})
from test_training import MODEL, SHORT, sphere_scene
from sira_assets.train.batches import stack
from sira_assets.train.parallel import joined_share
from sira_assets.train.shape import train_shape

data = stack([sphere_scene(r, i) for i, r in enumerate((0.8, 0.9, 1.0, 1.1))])
config = replace(SHORT, steps=2, scenes_per_step=4, reference_steps=1)
with joined_share() as share:
    train_shape(data, Path({out!r}), model_config=MODEL, config=config, share=share)
"""


@pytest.mark.slow
def test_what_two_processes_hold_is_held_as_one_holds_it(tmp_path):
    """Of two steps the first holds the deformation: its optimiser has then seen one step, however many processes."""
    from safetensors.torch import load_file

    states = []
    for size in (1, 2):
        run_by_processes(size, HELD, tmp_path / str(size))
        states.append(load_file(tmp_path / str(size) / "shape.safetensors"))
    one, two = states
    assert one.keys() == two.keys()
    steps = {name: float(value) for name, value in one.items() if name.endswith("/step")}
    assert set(steps.values()) == {1.0, 2.0}
    assert {name: float(two[name]) for name in steps} == steps
    # Adam's first steps follow gradients' signs, which rounding can turn where they vanish: one step of 2e-5 apart.
    for name, value in one.items():
        torch.testing.assert_close(two[name], value, rtol=1e-3, atol=1e-4)
