"""SA-SM, AF-SM, the prior file and the fitted head: shapes of functions, gradients, round trips."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.fields.af_sm import MAX_F0, AppearanceConfig, AppearanceFactorModel, fibonacci_sphere
from sira_assets.fields.fitted import AlbedoRefinement, FittedHead, load_fitted, save_fitted
from sira_assets.fields.head_field import query
from sira_assets.fields.mlp import MLP, UNIT_M, encode, encoded_size
from sira_assets.fields.prior import CODE_NAMES, CodeStatistics, Prior, load_prior, save_prior
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig, sdf_and_gradient

SMALL = ShapeConfig(code_size=6, appearance_code_size=5, feature_size=3, deformation_width=16, reference_width=16)
SMALL_APPEARANCE = AppearanceConfig(albedo_code_size=4, specular_code_size=3, light_code_size=4, lobes=5)


def small_prior(seed=0) -> Prior:
    torch.manual_seed(seed)
    shape = ShapeAppearanceModel(SMALL)
    appearance = AppearanceFactorModel(SMALL_APPEARANCE, feature_size=SMALL.feature_size)
    sizes = (6, 5, 4, 3, 4)
    return Prior(shape, appearance, *(CodeStatistics.of(torch.randn(20, size)) for size in sizes))


def test_positional_encoding_has_the_stated_size_and_values():
    x = torch.tensor([[0.3, -0.7, 2.0]], dtype=torch.float64)
    e = encode(x, 3)
    assert e.shape[1] == encoded_size(3, 3) == 21
    torch.testing.assert_close(e[0, :3], x[0])
    for k in range(3):
        for axis in range(3):
            assert (e[0] == torch.sin(2**k * x[0, axis])).any()


def test_a_code_all_points_share_is_a_code_given_to_each():
    torch.manual_seed(0)
    net = MLP(3 + 5, 2, width=8, depth=3).double()
    x, code = torch.randn(7, 3, dtype=torch.float64), torch.randn(5, dtype=torch.float64, requires_grad=True)
    each = code.expand(7, 5)
    for given in (each, code):
        torch.testing.assert_close(net(x, given), net(torch.cat([x, each], -1)))
    gradients = [torch.autograd.grad(net(x, given).square().sum(), [code, *net.parameters()]) for given in (each, code)]
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b)


def test_untrained_reference_is_near_a_ball_of_one_unit():
    torch.manual_seed(0)
    model = ShapeAppearanceModel(SMALL)
    with torch.no_grad():
        model.reference.out.weight.zero_()
        x = torch.tensor([[0.0, 0.0, 1.0], [0.0, 2.0, 0.0]])
        sdf = model.reference_sdf(x)
    # the square root's guard of 1e-6 shifts distances by half of that
    torch.testing.assert_close(sdf, torch.tensor([0.0, 1.0]), atol=1e-6, rtol=0)


def test_gradient_of_the_composed_distance_is_the_finite_difference():
    torch.manual_seed(0)
    model = ShapeAppearanceModel(SMALL).double()
    x, z = torch.randn(30, 3, dtype=torch.float64), torch.randn(6, dtype=torch.float64)
    _, gradient, _, _ = sdf_and_gradient(model, x, z, differentiable=False)
    h = 1e-5
    for axis in range(3):
        step = torch.zeros(3, dtype=torch.float64)
        step[axis] = h
        difference = (model(x + step, z)[0] - model(x - step, z)[0]) / (2 * h)
        # central differences are off by h^2 f''' / 6; PE reaches 16 rad/unit, so f''' is at most a few thousand
        torch.testing.assert_close(gradient[:, axis], difference, atol=1e-6, rtol=1e-5)


def test_reference_distance_sees_the_code_only_through_the_deformation():
    torch.manual_seed(0)
    model = ShapeAppearanceModel(SMALL)
    x = torch.randn(10, 3)
    for z in torch.randn(2, 6):
        sdf, x_ref, _ = model(x, z)
        torch.testing.assert_close(sdf, model.reference_sdf(x_ref))


def test_without_a_reference_the_code_reaches_the_distance_and_nothing_moves():
    torch.manual_seed(0)
    model = ShapeAppearanceModel(replace(SMALL, reference=False)).double()
    x, (a, b) = torch.randn(10, 3, dtype=torch.float64), torch.randn(2, 6, dtype=torch.float64)
    sdf, x_ref, gamma = model(x, a)
    delta, same_gamma = model.deform(x, a)
    torch.testing.assert_close(x_ref, x, rtol=0, atol=0)
    assert (delta == 0).all()
    torch.testing.assert_close(gamma, same_gamma, rtol=0, atol=0)
    assert gamma.shape == (10, 3)
    assert (model(x, b)[0] != sdf).all()
    assert not any(name.startswith("reference.") for name in model.state_dict())
    _, gradient, _, _ = sdf_and_gradient(model, x, a, differentiable=False)
    h = 1e-5
    difference = (model(x + h * x, a)[0] - model(x - h * x, a)[0]) / (2 * h)
    # along x itself; central differences are off by a sixth of h^2 times the third derivative
    torch.testing.assert_close((gradient * x).sum(-1), difference, atol=1e-6, rtol=1e-5)


def test_material_decoders_stay_in_their_ranges():
    torch.manual_seed(0)
    model = AppearanceFactorModel(SMALL_APPEARANCE, feature_size=3)
    x, g = 10 * torch.randn(200, 3), 10 * torch.randn(200, 3)
    albedo = model.diffuse(x, g, 10 * torch.randn(4))
    f0 = model.specular_f0(x, torch.rand(len(x), 3), 10 * torch.randn(3))
    assert ((albedo >= 0) & (albedo <= 1)).all()
    assert ((f0 >= 0) & (f0 <= MAX_F0)).all()
    axis, sharpness, amplitude = model.lobes(100 * torch.randn(3, 4))
    torch.testing.assert_close(axis.norm(dim=-1), torch.ones(3, 5))
    assert (sharpness > 0).all()
    assert (amplitude > 0).all()
    assert torch.isfinite(sharpness).all()
    assert torch.isfinite(amplitude).all()


def test_fibonacci_directions_are_unit_and_balanced():
    d = fibonacci_sphere(200).double()
    torch.testing.assert_close(d.norm(dim=-1), torch.ones(200, dtype=torch.float64), atol=1e-6, rtol=0)
    assert d.mean(0).norm() < 0.01


def test_code_statistics_are_those_of_the_codes():
    torch.manual_seed(0)
    codes = torch.randn(500, 3) @ torch.diag(torch.tensor([2.0, 0.5, 0.1])) + torch.tensor([1.0, 2.0, 3.0])
    s = CodeStatistics.of(codes, variance=0.999999)
    torch.testing.assert_close(s.basis @ s.basis.T, torch.cov(codes.T), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(s.code(torch.zeros(3)), codes.mean(0))
    with torch.autocast("cpu", torch.bfloat16):
        beside_bfloat16 = s.code(codes)
    torch.testing.assert_close(beside_bfloat16, s.code(codes), rtol=0, atol=0)
    low = CodeStatistics.of(codes, variance=0.9)
    assert low.basis.shape == (3, 1)


@pytest.mark.parametrize("config", [SMALL, replace(SMALL, reference=False, joint_appearance=False)])
def test_prior_survives_its_file(tmp_path, config):
    prior = replace(small_prior(), shape=ShapeAppearanceModel(config))
    save_prior(prior, tmp_path / "p.safetensors", {"note": "test"})
    back = load_prior(tmp_path / "p.safetensors")
    x, z = torch.randn(20, 3), torch.randn(6)
    torch.testing.assert_close(back.shape(x, z)[0], prior.shape(x, z)[0], rtol=0, atol=0)
    for name in CODE_NAMES:
        torch.testing.assert_close(getattr(back, name).basis, getattr(prior, name).basis, rtol=0, atol=0)
    assert back.shape.config == config
    assert not any(p.requires_grad for p in back.shape.parameters())


def test_a_file_that_is_no_prior_is_refused_in_one_line(tmp_path):
    (tmp_path / "no.safetensors").write_bytes(b"not a tensor in sight")
    for path in (tmp_path / "no.safetensors", tmp_path / "absent.safetensors"):
        with pytest.raises(InputError, match="trained prior") as caught:
            load_prior(path)
        assert "\n" not in str(caught.value)


def fitted(refinement=True) -> FittedHead:
    prior = small_prior(1)
    net = AlbedoRefinement(feature_size=3) if refinement else None
    if net is not None:
        torch.nn.init.normal_(net.net.out.weight, std=0.05)
    codes = (prior.z_sdf.mean, prior.z_a.mean, prior.z_s.mean)
    return FittedHead(prior.shape, prior.appearance, *codes, net, 0.7)


@pytest.mark.parametrize("refinement", [True, False])
def test_fitted_head_survives_its_file(tmp_path, refinement):
    head = fitted(refinement)
    save_fitted(head, tmp_path / "field.safetensors", {"who": "nobody"})
    back = load_fitted(tmp_path / "field.safetensors")
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (50, 3))
    a = query(head, points, normals=True, material=True)
    b = query(back, points, normals=True, material=True)
    for name in ("sdf_m", "normals", "diffuse", "specular_f0"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_fitted_head_speaks_metres():
    head = fitted()
    x = torch.randn(10, 3) * 0.1
    torch.testing.assert_close(head.sdf(x), head.shape(x / UNIT_M, head.z_sdf)[0] * UNIT_M)


def test_specular_scale_scales_the_specular_albedo():
    head = fitted()
    x = torch.randn(10, 3) * 0.1
    full = FittedHead(head.shape, head.appearance, head.z_sdf, head.z_a, head.z_s, head.refinement, 1.0)
    torch.testing.assert_close(head.material(x)[1], 0.7 * full.material(x)[1])
