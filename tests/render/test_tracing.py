"""Sphere tracing against closed-form intersections, and the differentiable hit against finite differences."""

import numpy as np
import torch

from sira_assets.render.tracing import TraceConfig, box_interval, differentiable_hit, sphere_trace

LOW, HIGH = torch.tensor([-2.0, -2.0, -2.0]), torch.tensor([2.0, 2.0, 2.0])


def rays(count=500, seed=0):
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins = 4.0 * origins / np.linalg.norm(origins, axis=1, keepdims=True)
    targets = rng.uniform(-1.3, 1.3, (count, 3))
    d = targets - origins
    return torch.tensor(origins).float(), torch.tensor(d / np.linalg.norm(d, axis=1, keepdims=True)).float()


def sphere(x, radius=1.0):
    return x.norm(dim=-1) - radius


def true_hit(origins, directions):
    b = (origins * directions).sum(-1)
    q = b**2 - (origins**2).sum(-1) + 1.0
    return q, -b - q.clamp_min(0).sqrt()


def test_hits_of_a_sphere_are_the_closed_form():
    o, d = rays()
    hits = sphere_trace(sphere, o, d, LOW, HIGH)
    q, t = true_hit(o, d)
    clear = q.abs() > 1e-2  # a tangent ray is neither a hit nor a miss within the tolerance
    assert torch.equal(hits.hit[clear], (q > 0)[clear])
    both = clear & hits.hit
    # tolerance / |grad f . d|, and |grad f . d| = sqrt(q) >= 0.1 here
    torch.testing.assert_close(hits.t[both], t[both], rtol=0, atol=2e-4 / 0.1 + 1e-5)


def test_a_field_steeper_than_a_distance_is_still_hit():
    o, d = rays()
    steep = lambda x: 1.6 * sphere(x) + 0.1 * torch.sin(7 * x[:, 0]) * sphere(x)  # noqa: E731
    hits = sphere_trace(steep, o, d, LOW, HIGH)
    q, _ = true_hit(o, d)
    clear = q > 0.05
    assert hits.hit[clear].all()
    assert sphere(o + hits.t[:, None] * d)[clear].abs().max() < 1e-3


def test_misses_give_the_nearest_point_of_the_ray():
    o, d = rays()
    hits = sphere_trace(sphere, o, d, LOW, HIGH, TraceConfig(steps=60, relaxation=0.5))
    q, _ = true_hit(o, d)
    miss = (q < -0.05) & ~hits.hit
    nearest = (-(o * d).sum(-1))[miss]
    assert miss.sum() > 20
    # Steps are at least half the distance, so the nearest sample is within about that distance of the nearest point,
    # and the distance there, being at a minimum, is right to second order.
    f = sphere((o + hits.t[:, None] * d)[miss])
    f_true = sphere(o[miss] + nearest[:, None] * d[miss])
    assert (f - f_true).max() < 0.15


def test_box_interval_of_an_axis_ray():
    o, d = torch.tensor([[0.0, 0.0, 5.0], [5.0, 0.0, 5.0]]), torch.tensor([[0.0, 0.0, -1.0]] * 2)
    near, far = box_interval(o, d, LOW, HIGH)
    assert near[0] == 3.0
    assert far[0] == 7.0
    assert near[1] > far[1]


def test_the_hit_moves_as_the_sphere_grows():
    """d t / d radius is -1 / (n . -d) wherever the ray is not grazing, and stays bounded where it is."""
    o, d = rays(2000)
    q, t = true_hit(o, d)
    ok = q > 0
    o, d, t = o[ok], d[ok], t[ok]
    radius = torch.tensor(1.0, requires_grad=True)
    x0 = o + t[:, None] * d
    f = sphere(x0, radius)
    gradient = x0 / x0.norm(dim=-1, keepdim=True)
    x = differentiable_hit(x0, d, f, gradient)
    moved = torch.autograd.functional.jacobian(lambda r: differentiable_hit(x0, d, sphere(x0, r), gradient), radius)
    along = (moved * d).sum(-1)
    cos = (gradient * d).sum(-1)
    steep = cos < -0.15
    torch.testing.assert_close(along[steep], (1.0 / cos)[steep], rtol=1e-4, atol=1e-4)
    assert along.abs().max() <= 10.0 + 1e-3
    torch.testing.assert_close(x, x0, rtol=0, atol=1e-4)  # float32 of a hit at distance 4
