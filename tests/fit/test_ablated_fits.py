"""The models and fits that the paper leaves parts out of: each is what its name says, and ends finite."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from ball_prior import APPEARANCE, SHAPE
from small_portrait import portrait
from test_fit import APPEARANCE_FIT, GEOMETRY
from test_landmark_rays import posed_by_landmarks

from sira_assets.fields.af_sm import AppearanceFactorModel
from sira_assets.fields.prior import CodeStatistics, Prior, freeze, untrained_appearance
from sira_assets.fields.sa_sm import ShapeAppearanceModel
from sira_assets.fit.appearance import fit_appearance, unlit_head
from sira_assets.fit.geometry import fit_geometry
from sira_assets.mesh.extract import ExtractConfig, extract_mesh

WITHOUT_REFERENCE = replace(SHAPE, reference=False, joint_appearance=False)


def ball_prior(config) -> Prior:
    """Networks that have learnt nothing but a ball of ten centimetres."""
    torch.manual_seed(3)
    shape, appearance = ShapeAppearanceModel(config), AppearanceFactorModel(APPEARANCE, feature_size=2)
    for net in (shape.deformation if shape.reference is None else shape.reference,):
        torch.nn.init.normal_(net.out.weight, std=1e-3)
    statistics = [CodeStatistics.of(0.1 * torch.randn(12, size)) for size in (4, 4, 3, 2, 3)]
    return Prior(freeze(shape), freeze(appearance), *statistics)


def changed(before, after) -> bool:
    pairs = zip(before.parameters(), after.parameters(), strict=True)
    return any(not torch.equal(a, b) for a, b in pairs)


@pytest.mark.parametrize("steps", [0, 4])
def test_without_a_reference_phase_b_frees_every_weight_and_phase_a_none(steps):
    prior = ball_prior(WITHOUT_REFERENCE)
    fit = fit_geometry(portrait(), prior, replace(GEOMETRY, steps_networks=steps, steps_cover=0))
    assert changed(prior.shape.deformation, fit.shape.deformation) == (steps > 0)
    assert fit.shape.reference is None
    assert all(np.isfinite(list(losses.values())).all() for _, losses in fit.history)
    assert len(extract_mesh(unlit_head(fit, prior), ExtractConfig(cell_m=0.01)).faces) > 100


def test_without_a_reference_a_pose_from_landmarks_is_refined_all_the_same():
    fit = fit_geometry(posed_by_landmarks(), ball_prior(WITHOUT_REFERENCE), GEOMETRY)
    assert 0.0 < fit.pose_change_deg < 30.0


def test_an_untrained_renderer_learns_from_the_first_step_and_a_trained_one_later():
    only_codes = replace(GEOMETRY, steps_networks=0, steps_cover=0)
    for joint in (True, False):
        prior = ball_prior(replace(SHAPE, joint_appearance=joint))
        fit = fit_geometry(portrait(), prior, only_codes)
        assert changed(prior.shape.renderer, fit.shape.renderer) != joint
        assert not changed(prior.shape.deformation, fit.shape.deformation)


def test_all_at_once_learns_its_own_decoders_and_leaves_the_prior_alone():
    prior = untrained_appearance(ball_prior(SHAPE), seed=1)
    before = [p.clone() for p in prior.appearance.parameters()]
    grey = replace(portrait(), image_linear=np.full((96, 96, 3), 0.3, np.float32))
    geometry = fit_geometry(grey, prior, GEOMETRY)
    surface = extract_mesh(unlit_head(geometry, prior), ExtractConfig(cell_m=0.01))
    config = replace(APPEARANCE_FIT, scheduled=False, shadows=False, steps_light=30)
    fit = fit_appearance(grey, geometry, prior, surface, config)
    assert changed(prior.appearance.albedo, fit.head.appearance.albedo)
    assert changed(prior.appearance.specular, fit.head.appearance.specular)
    assert fit.head.refinement is None
    assert all(torch.equal(a, b) for a, b in zip(before, prior.appearance.parameters(), strict=True))
    assert not any(p.requires_grad for p in fit.head.appearance.parameters())
    first, last = fit.history[0][1]["colour"], fit.history[-1][1]["colour"]
    assert last < 0.9 * first


def test_an_untrained_appearance_is_even_light_and_the_same_for_a_seed():
    prior = ball_prior(SHAPE)
    a, b = (untrained_appearance(prior, seed=5) for _ in range(2))
    assert not changed(a.appearance, b.appearance)
    assert changed(a.appearance, prior.appearance)
    assert a.shape is prior.shape
    _, sharpness, amplitude = a.appearance.lobes(a.z_l.mean[None])
    # A code of zero and layers without bias: every lobe is as the formula starts it.
    torch.testing.assert_close(amplitude, torch.full_like(amplitude, np.exp(-0.7)))
    torch.testing.assert_close(sharpness, torch.full_like(sharpness, np.exp(1.5)))
