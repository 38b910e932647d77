"""The direct-light estimator: known integrals, unbiasedness, convergence, shadows."""

import numpy as np
import pytest

from data_synth.render_light import direct_light, sample_directions, sobol, strategy_shares
from sira_assets.scene.sg_light import SGLight

LIGHT = SGLight(
    [[0.3, 0.5, 0.8], [-0.9, 0.1, 0.3], [0, 1, 0]], [40.0, 5.0, 0.5], [[6, 5, 4], [0.5, 0.6, 0.8], [0.2, 0.2, 0.3]]
)


def never(index, directions):
    return np.zeros(len(index), bool)


def lit(normal, view, light, *, occluded=never, directions=256, roughness=0.4, points=64, f0=0.04, seed=0):
    """`points` independent estimates at one and the same point with albedo (0.5, 0.3, 0.2)."""
    ones = np.ones((points, 1))
    view = np.asarray(view, float) / np.linalg.norm(view)
    rotations = np.random.default_rng(seed).random((points, 3))
    albedo = np.broadcast_to([0.5, 0.3, 0.2], (points, 3))
    return direct_light(
        ones * normal, ones * view, albedo, np.full(points, f0), light, occluded, rotations,
        roughness=roughness, directions=directions,
    )  # fmt: skip


def reference_specular(normal, view, light, roughness, ks=1.0, steps=2000):
    """The integral of ks D G F / (4 nl nv) L nl over the hemisphere, by the midpoint rule in float64.

    G is Smith's in the form with tangents, D in the form with cosines: written differently from the code under test.
    """
    z = (np.arange(steps) + 0.5) / steps
    phi = 2 * np.pi * (np.arange(500) + 0.5) / 500
    z, phi = (a.ravel() for a in np.meshgrid(z, phi, indexing="ij"))
    r = np.sqrt(1 - z * z)
    w = np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)
    assert np.allclose(normal, [0, 0, 1])
    view = np.asarray(view, float) / np.linalg.norm(view)
    half = w + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    alpha2 = roughness**4
    nh, vh, nl, nv = half[:, 2], half @ view, z, view[2]
    d = alpha2 / (np.pi * ((nh * nh) * (alpha2 - 1) + 1) ** 2)
    g = np.prod([2 / (1 + np.sqrt(1 + alpha2 * (1 - c * c) / (c * c))) for c in (nl, np.full_like(nl, nv))], axis=0)
    brdf = ks * d * g * (0.04 + 0.96 * (1 - vh) ** 5) / (4 * nl * nv)
    return (light.radiance(w) * (brdf * nl)[:, None]).sum(0) * (2 * np.pi / len(z))


def test_points_of_the_sequence_are_evenly_spread():
    for count in (1, 32, 48, 64, 100):
        points = sobol(count)
        assert points.shape == (count, 3)
        assert points[:, 0] == pytest.approx((np.arange(count) + 0.5) / count, abs=1e-6)
        assert points.min() >= 0
        assert points.max() < 1
    # A (0, m, 2)-net puts one point into each of 8 x 8 boxes.
    boxes = (sobol(64)[:, 1:] * 8).astype(int) @ [8, 1]
    assert len(np.unique(boxes)) > 40


def test_unshadowed_diffuse_has_no_noise():
    out = lit([0, 0, 1], [0.2, 0.1, 1], LIGHT, directions=16)
    assert np.ptp(out.diffuse, axis=0).max() < 1e-6
    assert np.array_equal(out.diffuse, out.diffuse_unshadowed)


@pytest.mark.parametrize("roughness", [0.2, 0.4, 0.7])
@pytest.mark.parametrize("view", [[0, 0, 1], [0.6, -0.3, 0.7], [0.97, 0, 0.24]])
def test_specular_is_unbiased(view, roughness):
    out = lit([0, 0, 1], view, LIGHT, roughness=roughness, points=400, directions=128)
    expected = reference_specular(np.array([0, 0, 1]), view, LIGHT, roughness)
    standard_error = out.specular.std(0) / np.sqrt(len(out.specular))
    # Four standard errors, and the midpoint rule's own error of about 0.1 %.
    assert (np.abs(out.specular.mean(0) - expected) < 4 * standard_error + 2e-3 * expected).all()


def test_error_falls_as_the_samples_grow():
    spread = [
        lit([0, 0, 1], [0.5, 0, 1], LIGHT, directions=n, points=200).specular.std(0).mean() for n in (16, 64, 256)
    ]
    # Independent samples halve the error for four times as many; stratified ones do better.
    assert spread[1] < 0.55 * spread[0]
    assert spread[2] < 0.55 * spread[1]


def test_specular_is_linear_in_f0_and_vanishes_with_it():
    full, half, none = (lit([0, 0, 1], [0.5, 0, 1], LIGHT, f0=f0, directions=512) for f0 in (0.04, 0.02, 0.0))
    assert half.specular == pytest.approx(0.5 * full.specular, rel=1e-5)
    assert not none.specular.any()


@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.8])
def test_white_furnace_reflects_at_most_what_arrives(roughness):
    """Under uniform light of radiance 1, GGX with F0 = 0.04 reflects about that head on, less when rough."""
    white = SGLight([[0, 0, 1]], [1e-4], [[1, 1, 1]])
    head_on, grazing = (lit([0, 0, 1], v, white, roughness=roughness).specular.mean() for v in ([0, 0, 1], [1, 0, 0.1]))
    assert 0.015 < head_on < 0.042  # separable masking loses up to half at roughness 0.8
    assert head_on < grazing < 1.0


def test_half_of_a_uniform_sky_gives_half_of_the_light():
    white = SGLight([[0, 0, 1]], [1e-5], [[1, 1, 1]])
    out = lit([0, 0, 1], [0, 0, 1], white, occluded=lambda index, w: w[:, 0] > 0, directions=256, points=200)
    assert out.diffuse.mean(0) == pytest.approx(0.5 * out.diffuse_unshadowed.mean(0), rel=5e-3)
    closed = lit([0, 0, 1], [0, 0, 1], white, occluded=lambda index, w: np.ones(len(w), bool))
    assert not closed.diffuse.any()
    assert not closed.specular.any()


@pytest.mark.parametrize("sharpness", [0.01, 3.0, 300.0, 1e5])
def test_shadowed_diffuse_matches_quadrature(sharpness):
    """A wall that hides all directions with x > 0.2 from a lobe that straddles its edge."""
    axis = np.array([0.2, 0.3, 0.0])
    axis[2] = np.sqrt(1 - axis @ axis)
    light = SGLight([axis], [sharpness], [[1, 2, 3]])
    out = lit([0, 0, 1], [0, 0, 1], light, occluded=lambda index, w: w[:, 0] > 0.2, directions=256, points=200)
    # Quadrature about the axis: 1 - cos = reach u^2, all azimuths.
    u, phi = (np.arange(500) + 0.5) / 500, 2 * np.pi * (np.arange(721) + 0.5) / 721
    u, phi = (a.ravel() for a in np.meshgrid(u, phi, indexing="ij"))
    reach = min(2.0, 40 / sharpness)
    t = reach * u * u
    tangent = np.cross(axis, [0, 0, 1.0])
    tangent /= np.linalg.norm(tangent)
    side = np.stack([tangent, np.cross(axis, tangent)])
    w = (1 - t)[:, None] * axis + np.sqrt(t * (2 - t))[:, None] * (np.stack([np.cos(phi), np.sin(phi)], -1) @ side)
    weight = np.exp(-sharpness * t) * 2 * u * np.maximum(w[:, 2], 0)
    expected = (weight * (w[:, 0] <= 0.2)).sum() / weight.sum()
    share = (out.diffuse / out.diffuse_unshadowed).mean()
    # Both sides see the edge as a step: 1 / 500 of the lobe here, and 50,000 samples there.
    assert share == pytest.approx(expected, abs=5e-3)


def test_densities_integrate_to_one():
    """Directions drawn, binned by hemisphere: the share of each strategy is what was asked for."""
    n = np.tile(np.float32([0, 0, 1]), (500, 1))
    shares = strategy_shares(np.tile([1.0, 0.5, 0.2], (500, 1)), LIGHT.sharpness, np.full(500, 0.04))
    assert shares.sum(1) == pytest.approx(np.ones(500), abs=1e-6)
    rotations = np.random.default_rng(1).random((500, 3))
    w = sample_directions(n, n, shares, LIGHT, rotations, 64, 0.4)
    assert np.linalg.norm(w, axis=-1) == pytest.approx(np.ones(w.shape[:2]), abs=1e-5)
    near_key = (w @ LIGHT.axis[0] > 1 - 3 / 40).mean()  # three mean widths hold 1 - e^-3 of the lobe
    assert near_key > shares[0, 0] * 0.95
