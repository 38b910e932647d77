"""The direct-light estimator: known integrals, unbiasedness, convergence, shadows."""

import numpy as np
import pytest

from data_synth.render_light import direct_light, sample_directions, sobol, strategy_shares
from data_synth.render_source import SGSource
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
        assert (np.diff(points[:, 0].astype(np.int64)) >= 0).all()
    # Two coordinates of a Sobol sequence put at most a few points into each of 8 x 8 boxes, random ones leave 23 empty;
    # an exclusive or with the same number permutes the boxes.
    for scramble in (np.uint32(0), np.uint32(0xDEADBEEF)):
        boxes = ((sobol(64)[:, 1:] ^ scramble) >> 29).astype(int) @ [8, 1]
        assert len(np.unique(boxes)) > 47


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


def hemisphere(steps=300):
    """Midpoint directions (3, K) float32 and the solid angle of each, over the whole sphere."""
    z = -1 + 2 * (np.arange(steps) + 0.5) / steps
    phi = 2 * np.pi * (np.arange(steps) + 0.5) / steps
    z, phi = (a.ravel() for a in np.meshgrid(z, phi, indexing="ij"))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z]).astype(np.float32), 4 * np.pi / steps**2


def test_proposals_are_drawn_with_the_density_they_say():
    source, rng = SGSource(LIGHT), np.random.default_rng(2)
    w, omega = hemisphere()
    g, densities = source.evaluate(*w)
    # The sharpest lobe is 9 degrees wide, 15 cells of the midpoint rule.
    assert densities.sum(1) * omega == pytest.approx(np.ones(3), abs=2e-3)
    assert g == pytest.approx(np.exp(LIGHT.sharpness[:, None] * (LIGHT.axis @ w - 1)), abs=2e-5)
    for k in range(3):
        drawn = np.stack(source.draw(k, *rng.random((2, 40000), np.float32)))
        assert np.linalg.norm(drawn, axis=0) == pytest.approx(np.ones(40000), abs=1e-5)
        mean, expected = drawn.mean(1), (w * densities[k]).sum(1) * omega
        # Four standard errors of a mean of 40,000 unit vectors.
        assert mean == pytest.approx(expected, abs=4 / np.sqrt(3 * 40000))


@pytest.mark.parametrize("roughness", [0.05, 0.4])
def test_sharp_lobe_in_a_highlight_matches_quadrature(roughness):
    """A sun of sharpness 800 off the mirror direction by 5 degrees."""
    view = np.array([0.5, 0.0, np.sqrt(0.75)])
    a = np.radians(-30 + (5 if roughness > 0.1 else 0.05))
    light = SGLight([[np.sin(a), 0, np.cos(a)]], [800.0], [[3, 2, 1]])
    out = lit([0, 0, 1], view, light, roughness=roughness, points=400, directions=128)
    # Quadrature about the lobe's axis up to where it has fallen to e^-30.
    axis, reach, s = light.axis[0], 30 / 800, (np.arange(1500) + 0.5) / 1500
    t, weight = reach * s * s, 2 * reach * s / 1500 * (2 * np.pi / 720)
    phi = 2 * np.pi * (np.arange(720) + 0.5) / 720
    tangent = np.array([np.cos(a), 0, -np.sin(a)])
    ring = np.cos(phi)[:, None] * tangent + np.sin(phi)[:, None] * [0.0, 1.0, 0.0]
    w = (1 - t)[:, None, None] * axis + np.sqrt(t * (2 - t))[:, None, None] * ring
    nl, half = w[..., 2], w + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    alpha2 = roughness**4
    # 1 - nh^2 from the components across the normal, so that a mirror-like highlight keeps its digits
    d = alpha2 / np.pi / (half[..., 0] ** 2 + half[..., 1] ** 2 + alpha2 * half[..., 2] ** 2) ** 2
    v1 = 1 / (nl + np.sqrt(alpha2 + (1 - alpha2) * nl**2))
    v1 = v1 / (view[2] + np.sqrt(alpha2 + (1 - alpha2) * view[2] ** 2))
    brdf = d * v1 * (0.04 + 0.96 * (1 - half @ view) ** 5)
    expected = (brdf * nl * np.exp(-800 * t)[:, None]).sum(1) @ weight * light.amplitude[0]
    error = out.specular.std(0) / np.sqrt(400)
    # Four standard errors, and 1e-3 of float32 directions seen through a lobe of 800 and a highlight of alpha 0.0025.
    assert (np.abs(out.specular.mean(0) - expected) < 4 * error + 2e-3 * expected).all()


def test_a_normal_that_faces_away_reflects_nothing_but_keeps_the_local_model():
    out = lit([0, 0, 1], [0.9, 0, -0.1], LIGHT)
    assert not out.diffuse.any()
    assert not out.specular.any()
    assert out.diffuse_unshadowed.min() > 0


def test_visibility_tells_the_lobes_apart():
    """A wall that hides x < 0 takes the lamp at the left and leaves the one at the right."""
    light = SGLight([[-0.8, 0, 0.6], [0.8, 0, 0.6]], [60.0, 60.0], [[1, 1, 1], [3, 2, 1]])
    out = lit([0, 0, 1], [0, 0, 1], light, occluded=lambda index, w: w[:, 0] < 0)
    assert out.visibility == pytest.approx(np.tile([0.0, 1.0], (64, 1)), abs=1e-6)
    right = SGSource(light).irradiance(np.array([[0.0, 0.0, 1.0]]))[0, 1] * light.amplitude[1]
    assert out.diffuse[0] == pytest.approx(np.array([0.5, 0.3, 0.2]) / np.pi * right, rel=1e-5)


def test_strategies_are_drawn_as_often_as_asked():
    """Directions drawn, binned by hemisphere: the share of each strategy is what was asked for."""
    n = np.tile(np.float32([0, 0, 1]), (500, 1))
    source = SGSource(LIGHT)
    irradiance = source.irradiance(n)
    shares = strategy_shares(source.proposal_energy(irradiance), irradiance, source, np.ones(500, bool))
    assert shares.sum(1) == pytest.approx(np.ones(500), abs=1e-6)
    rotations = np.random.default_rng(1).random((500, 3))
    w = sample_directions(n, n, shares, source, rotations, 64, 0.4)
    assert np.linalg.norm(w, axis=0) == pytest.approx(np.ones(w.shape[1:]), abs=1e-5)
    near_key = (
        np.einsum("ipn,i->pn", w, LIGHT.axis[0]) > 1 - 3 / 40
    ).mean()  # three mean widths hold 1 - e^-3 of the lobe
    assert near_key > shares[0, 0] * 0.95
