"""Blocks change neither values nor gradients."""

import torch

from sira_assets.numerics.blocks import PAIRS, in_blocks
from sira_assets.numerics.sg import irradiance
from sira_assets.numerics.sg_specular import specular_radiance


def problem(count: int):
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    normals = torch.nn.functional.normalize(draw(count, 3), dim=-1)
    view = torch.nn.functional.normalize(normals + 0.5 * draw(count, 3), dim=-1)
    axis = torch.nn.functional.normalize(draw(32, 3), dim=-1)
    f0, seen = (torch.rand(*s, generator=generator, dtype=torch.float64) for s in ((count,), (count, 32)))
    return [t.requires_grad_() for t in (normals, view, f0, axis, torch.exp(draw(32)), draw(32, 3).abs(), seen)]


def whole_and_parts(function, tensors, rows):
    whole = function(*tensors)
    parts = torch.cat(
        [function(*(t[i : i + rows] if len(t) != 32 else t for t in tensors)) for i in range(0, 2500, rows)]
    )
    weight = torch.randn(whole.shape, generator=torch.Generator().manual_seed(1), dtype=whole.dtype)
    return [(v, torch.autograd.grad((weight * v).sum(), tensors, allow_unused=True)) for v in (whole, parts)]


def test_values_and_gradients_are_those_of_single_blocks():
    # 2500 points by 32 lobes are three blocks; 500 by 32 are less than one, which takes the ordinary path.
    assert 500 * 32 < PAIRS < 2500 * 32
    functions = [
        lambda n, v, f, a, s, m, seen: irradiance(n, a, s, m, visibility=seen),
        lambda n, v, f, a, s, m, seen: specular_radiance(n, v, f, a, s, m, roughness=0.5, visibility=seen),
    ]
    for function in functions:
        (value, gradients), (expected, right) = whole_and_parts(function, problem(2500), 500)
        torch.testing.assert_close(value, expected, rtol=1e-13, atol=1e-14)
        for got, exact in zip(gradients, right, strict=True):
            if exact is None:
                assert got is None
            else:
                # Sums over the points in another order.
                torch.testing.assert_close(got, exact, rtol=1e-11, atol=1e-11)


def test_second_derivatives():
    def cubic(points, shared):
        return (points * shared).pow(3).sum(-1)

    count = PAIRS // 4
    points = torch.linspace(-1, 1, 2 * count, dtype=torch.float64).unsqueeze(-1).requires_grad_()
    shared = torch.tensor([0.7], dtype=torch.float64, requires_grad=True)
    value = in_blocks(cubic, (points,), (shared,), pairs=4)
    (first,) = torch.autograd.grad(value.sum(), points, create_graph=True)
    torch.testing.assert_close(first, 3 * 0.7**3 * points**2)
    (second,) = torch.autograd.grad(first.sum(), points, retain_graph=True)
    torch.testing.assert_close(second, 6 * 0.7**3 * points.detach())
    (mixed,) = torch.autograd.grad(first.sum(), shared)
    torch.testing.assert_close(mixed, (9 * 0.7**2 * points.detach() ** 2).sum()[None])


def test_nothing_is_handed_on_as_nothing():
    def function(points, nothing, shared):
        assert nothing is None
        return points @ shared

    points, shared = torch.ones(PAIRS, 2), torch.ones(2, 3)
    assert torch.equal(in_blocks(function, (points, None), (shared,), pairs=8), points @ shared)
