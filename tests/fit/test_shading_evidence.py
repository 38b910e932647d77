"""What shading tells of the shape, beside finite differences, autograd and photos made by the model itself."""

import copy
from dataclasses import replace

import pytest
import torch

from sira_assets.fields.prior import CODE_NAMES, CodeStatistics, Prior, load_prior
from sira_assets.fit.landmark_rays import LandmarkRays, landmark_offsets
from sira_assets.fit.pixels import PixelRays
from sira_assets.fit.pose import PoseCorrection
from sira_assets.fit.shading import (
    ShadingConfig,
    _Problem,
    harmonics,
    harmonics_slopes,
    no_evidence,
    shading_evidence,
)
from sira_assets.numerics.srgb import srgb_encode_beyond
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M

# A lamp from the upper left over a bright sky, the same in all colours but for its strength.
LIGHT = torch.tensor([1.1, -0.25, 0.3, 0.35, 0.0, 0.02, 0.03, -0.02, 0.0])[:, None] * torch.tensor([1.0, 0.9, 0.8])


@pytest.fixture(scope="module")
def prior():
    return load_prior()


def before_a_face(count, seed=0):
    """Rays along -z through random points of the face, one metre off."""
    torch.manual_seed(seed)
    origins = torch.cat([1.2 * torch.rand(count, 2) - torch.tensor([0.6, 0.95]), torch.full((count, 1), 10.0)], 1)
    directions = torch.tensor([0.0, 0.0, -1.0]).expand(count, 3).clone()
    yes = torch.ones(count, dtype=torch.bool)
    index = torch.arange(count)
    return PixelRays(origins, directions, torch.full((count, 3), 0.5), yes, yes, index, index)


def landmarks(prior, count=9, aside=0.0):
    """Rays along -z through the mean head's landmarks, or `aside` of them in x; 0.1 is a centimetre."""
    start = torch.tensor(list(CANONICAL_LANDMARKS_M.values()), dtype=torch.float32)[:count] * 10.0
    with torch.no_grad():
        x_ref = start + prior.shape.deform(start, prior.z_sdf.mean)[0]
    origins = torch.cat([start[:, :2] + torch.tensor([aside, 0.0]), torch.full((count, 1), 10.0)], 1)
    directions = torch.tensor([0.0, 0.0, -1.0]).expand(count, 3).clone()
    return LandmarkRays(origins, directions, torch.full((count,), 0.02), start, x_ref)


def generator():
    return torch.Generator().manual_seed(0)


def photographed(prior, rays, coefficients):
    """The rays with the colours that the model gives this shape under LIGHT."""
    problem = _Problem(rays, torch.full((len(rays),), 9.0), landmarks(prior, 0), prior, ShadingConfig())
    p = torch.zeros_like(problem.precision)
    p[: len(coefficients)] = coefficients
    p[problem.codes :][:27] = LIGHT.T.flatten()
    seen = problem.seen(p, torch.full((len(rays),), 9.0))
    for _ in range(3):  # a hit moves by 8 mm at most a step
        seen = problem.seen(p, seen.t)
    radiance, _ = problem.error(p, seen)
    return replace(rays, rgb=srgb_encode_beyond(radiance)), seen.n


def doubled(record):
    """A record of tensors, those of floats in float64."""
    return type(record)(*(v.double() if v.is_floating_point() else v for v in vars(record).values()))


def in_doubles(prior):
    """The prior in float64, for derivatives."""
    to = lambda s: CodeStatistics(s.mean.double(), s.basis.double())  # noqa: E731
    networks = copy.deepcopy(prior.shape).double(), copy.deepcopy(prior.appearance).double()
    return Prior(*networks, *(to(getattr(prior, name)) for name in CODE_NAMES))


def test_the_slopes_of_the_harmonics_are_autograds():
    n = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator(), dtype=torch.float64), dim=-1)
    expected = torch.stack([torch.func.jacrev(lambda v: harmonics(v[None])[0])(row) for row in n])
    torch.testing.assert_close(harmonics_slopes(n), expected, rtol=0, atol=1e-14)


def test_normals_and_albedo_change_with_code_and_pose_as_finite_differences_say(prior):
    rays = before_a_face(40)
    t = torch.full((40,), 9.0, dtype=torch.float64)
    problem = _Problem(doubled(rays), t, doubled(landmarks(prior)), in_doubles(prior), ShadingConfig())
    p = torch.zeros_like(problem.precision)
    p[: problem.codes] = 0.3 * torch.randn(problem.codes, generator=generator(), dtype=torch.float64)
    # Steep places move by more than Newton's held steps; where a ray grazes, the slope is held on purpose.
    for _ in range(8):
        before, seen = t, problem.seen(p, t)
        t = seen.t
    steep = (seen.n[:, 2] > 0.4) & ((t - before).abs() < 1e-9)
    assert steep.sum() > 25
    h = 1e-4
    for k in (0, 7, problem.codes - 1, *range(problem.codes, problem.codes + 6)):
        step = torch.zeros_like(p)
        step[k] = h
        above, below = problem.seen(p + step, t), problem.seen(p - step, t)
        for now, slope in (("n", seen.dn), ("root", seen.droot)):
            expected = (getattr(above, now) - getattr(below, now)) / (2 * h)
            # Central differences err by h^2 times a third derivative, of up to 1e4 at the encoding's shortest wave.
            torch.testing.assert_close(slope[steep][..., k], expected[steep], rtol=0, atol=2e-4)
        # Offsets lie across the rays: along them (z) they change by the turn of the rays alone, which dr leaves out.
        expected = (above.r - below.r) / (2 * h)
        torch.testing.assert_close(seen.dr[:, :2, k], expected[:, :2], rtol=0, atol=2e-3)


def test_a_photo_of_the_model_itself_gives_its_shape_back(prior):
    truth = torch.zeros(prior.z_sdf.basis.shape[1])
    truth[:4] = torch.tensor([1.0, -1.0, 0.8, 0.6])
    rays, normals = photographed(prior, before_a_face(3000), truth)
    config = ShadingConfig(worth=1e9, patch_gain=1e-3, patch_tint=1e-3, steps=20)
    found = shading_evidence(rays, landmarks(prior, 0), prior, config, generator())
    # In what the shading can see at all; the rest is the prior's.
    seen = lambda c: float(c @ found.precision @ c)  # noqa: E731
    assert seen(found.coefficients - truth) < 0.1 * seen(truth)
    _, mean = photographed(prior, rays, torch.zeros_like(truth))
    _, fitted = photographed(prior, rays, found.coefficients)
    off = lambda n: torch.rad2deg((n * normals).sum(-1).clamp(-1, 1).acos()).median()  # noqa: E731
    assert off(fitted) < 0.5 * off(mean)


def test_evidence_is_a_precision_and_grows_with_what_the_photo_is_worth(prior):
    rays, _ = photographed(prior, before_a_face(1500), torch.zeros(prior.z_sdf.basis.shape[1]))
    less, more = (
        shading_evidence(rays, landmarks(prior, 0), prior, ShadingConfig(worth=w), generator()).precision
        for w in (150.0, 600.0)
    )
    assert torch.linalg.eigvalsh(less.double()).min() > -1e-3 * less.diagonal().max()
    assert torch.linalg.eigvalsh((more - less).double()).min() > -1e-3 * more.diagonal().max()
    torch.testing.assert_close(less, less.T)


def test_a_blotched_photo_is_hardly_believed(prior):
    rays, _ = photographed(prior, before_a_face(1500), torch.zeros(prior.z_sdf.basis.shape[1]))
    blotched = replace(rays, rgb=(rays.rgb + 0.1 * torch.randn(1500, 1, generator=generator())).clamp(0, 1))
    clear, unclear = (
        shading_evidence(r, landmarks(prior, 0), prior, ShadingConfig(), generator()).precision.trace()
        for r in (rays, blotched)
    )
    assert unclear < 0.1 * clear


def test_landmarks_all_moved_aside_move_the_pose(prior):
    rays, _ = photographed(prior, before_a_face(1500), torch.zeros(prior.z_sdf.basis.shape[1]))
    moved = landmarks(prior, aside=0.04)
    # A photo that is worth nothing, so that nothing but the landmarks speaks.
    found = shading_evidence(rays, moved, prior, ShadingConfig(worth=1e-6), generator())

    def offsets(evidence):
        z_sdf, pose = prior.z_sdf.code(evidence.coefficients), PoseCorrection(evidence.pose[:3], evidence.pose[3:])
        return landmark_offsets(moved, prior.shape, z_sdf, prior.z_sdf.basis, pose)[0].norm(dim=-1)

    torch.testing.assert_close(offsets(no_evidence(prior, refine_pose=True)), torch.full((9,), 0.04), rtol=0, atol=1e-4)
    assert offsets(found).mean() < 0.2 * 0.04
    assert found.coefficients.norm() < 0.3  # of a head that stands elsewhere, not of another one


def test_a_wrong_landmark_moves_little(prior):
    rays, _ = photographed(prior, before_a_face(1500), torch.zeros(prior.z_sdf.basis.shape[1]))
    wrong = landmarks(prior)
    wrong.origins[4, 0] += 0.5  # the tip of the nose, by five centimetres
    found = shading_evidence(rays, wrong, prior, ShadingConfig(), generator())
    assert found.pose.abs().max() < 0.03


def test_an_unknown_pose_takes_evidence_away_and_a_given_one_stays(prior):
    rays, _ = photographed(prior, before_a_face(1500), torch.zeros(prior.z_sdf.basis.shape[1]))
    given = shading_evidence(rays, landmarks(prior, 0), prior, ShadingConfig(), generator())
    anywhere = replace(landmarks(prior), sigma=torch.full((9,), 1e3))
    estimated = shading_evidence(rays, anywhere, prior, ShadingConfig(), generator())
    assert torch.equal(given.pose, torch.zeros(6))
    codes = len(given.coefficients)
    shape, cross, pose = (
        estimated.precision[:codes, :codes],
        estimated.precision[:codes, codes:],
        estimated.precision[codes:, codes:],
    )
    assert (shape - cross @ torch.linalg.solve(pose, cross.T)).trace() < given.precision.trace()
    assert estimated.pose.abs().max() < 0.05  # the photo was taken in the pose assumed


@pytest.mark.parametrize("config", [ShadingConfig(steps=0), ShadingConfig(pixels=50)])
def test_no_steps_and_few_pixels_leave_the_prior_alone(prior, config):
    rays = before_a_face(300)
    found = shading_evidence(rays, landmarks(prior), prior, config, generator())
    c = torch.randn(prior.z_sdf.basis.shape[1], generator=generator())
    torch.testing.assert_close(found.energy(c, torch.zeros(6)), c.square().sum())
    given = no_evidence(prior, refine_pose=False)
    torch.testing.assert_close(given.energy(c, torch.ones(6)), c.square().sum())
    off = torch.tensor([0.06, 0.0, 0.0, 0.05, 0.0, 0.0])  # one standard deviation of each of two
    torch.testing.assert_close(found.energy(c, off), c.square().sum() + 2.0)


def test_a_surface_that_looks_one_way_and_a_photo_of_one_colour_end_finite(prior):
    rays = before_a_face(1500)
    spot = replace(rays, origins=rays.origins * torch.tensor([0.02, 0.02, 1.0]) + torch.tensor([0.3, -0.4, 0.0]))
    for few in (rays, spot):
        found = shading_evidence(few, landmarks(prior), prior, ShadingConfig(), generator())
        assert torch.isfinite(found.coefficients).all()
        assert torch.isfinite(found.precision).all()
        assert found.coefficients.square().sum() < 64.0


def test_the_same_photo_gives_the_same_bits(prior):
    rays, _ = photographed(prior, before_a_face(1500), torch.ones(prior.z_sdf.basis.shape[1]))
    one, other = (shading_evidence(rays, landmarks(prior), prior, ShadingConfig(), generator()) for _ in range(2))
    assert torch.equal(one.coefficients, other.coefficients)
    assert torch.equal(one.precision, other.precision)


def test_brighter_than_white_goes_on_along_the_slope():
    x = torch.tensor([0.0, 0.5, 1.0, 1.0 + 1e-4, 3.0], dtype=torch.float64, requires_grad=True)
    y = srgb_encode_beyond(x)
    (slope,) = torch.autograd.grad(y.sum(), x)
    y = y.detach()
    assert abs(float(y[3] - y[2]) / 1e-4 - 1.055 / 2.4) < 1e-4
    torch.testing.assert_close(slope[-2:], torch.full((2,), 1.055 / 2.4, dtype=torch.float64))
