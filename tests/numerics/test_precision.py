"""Half precision is widened, other types refused: every entry point alike."""

import numpy as np
import pytest
import torch

from sira_assets.errors import InputError
from sira_assets.numerics.precision import narrow, widen
from sira_assets.numerics.sg import (
    irradiance,
    sg_evaluate,
    sg_hemisphere_integral,
    sg_inner_product,
    sg_integral,
    sg_product,
    sg_rotate,
)
from sira_assets.numerics.sg_sh import sh_evaluate, sh_from_sg, sh_irradiance
from sira_assets.numerics.sg_specular import specular_lobe, specular_radiance
from sira_assets.numerics.vector import unit
from sira_assets.render.shading import shade

HALF = [torch.float16, torch.bfloat16]
COUNT = 60


def arguments(dtype: torch.dtype) -> dict[str, torch.Tensor]:
    """Lights from sharpness 0 and 6e-8, float16's least, to 6e4, near its largest."""
    generator = torch.Generator().manual_seed(0)
    normals, other, axis = (unit(torch.randn(COUNT, 3, generator=generator)) for _ in range(3))
    sharpness = torch.tensor([0.0, *np.geomspace(6e-8, 6e4, COUNT - 1)])
    values = {
        "normals": normals,
        "view": unit(normals + 0.5 * other),
        "axis": axis,
        "sharpness": sharpness.float(),
        "amplitude": torch.rand(COUNT, 3, generator=generator),
        "f0": torch.rand(COUNT, generator=generator),
        "rotation": torch.linalg.qr(torch.randn(3, 3, generator=generator)).Q,
    }
    return {name: value.to(dtype) for name, value in values.items()}


ENTRY_POINTS = {
    "evaluate": lambda a: sg_evaluate(a["normals"], a["axis"], a["sharpness"], a["amplitude"]),
    "integral": lambda a: sg_integral(a["sharpness"], a["amplitude"]),
    "hemisphere": lambda a: sg_hemisphere_integral(a["normals"], a["axis"], a["sharpness"], a["amplitude"]),
    "rotate": lambda a: sg_rotate(a["rotation"], a["axis"]),
    "product": lambda a: torch.cat([
        p.reshape(-1) for p in sg_product(
            a["axis"], a["sharpness"], a["amplitude"], a["normals"], a["sharpness"].flip(0), a["amplitude"]
        )
    ]),
    "inner product": lambda a: sg_inner_product(
        a["axis"], a["sharpness"], a["amplitude"], a["normals"], a["sharpness"], a["amplitude"]
    ),
    "harmonics": lambda a: sh_from_sg(a["axis"], a["sharpness"], a["amplitude"]),
    "harmonic light": lambda a: sh_evaluate(a["normals"], a["amplitude"][:9]),
    "harmonic irradiance": lambda a: sh_irradiance(a["normals"], a["amplitude"][:9]),
    **{
        f"irradiance {grade}": lambda a, g=grade: irradiance(
            a["normals"], a["axis"], a["sharpness"], a["amplitude"], grade=g
        )
        for grade in ("fast", "accurate")
    },
    **{
        f"specular {grade}": lambda a, g=grade: specular_radiance(
            a["normals"], a["view"], a["f0"], a["axis"], a["sharpness"], a["amplitude"], roughness=0.5, grade=g
        )
        for grade in ("fast", "accurate")
    },
    "specular lobe": lambda a: torch.cat([
        p.reshape(-1) for p in specular_lobe(a["normals"], a["view"], a["f0"], roughness=0.5)
    ]),
    "shade": lambda a: shade(
        a["normals"], a["view"], a["amplitude"], a["f0"], a["axis"], a["sharpness"], a["amplitude"]
    ).radiance,
}  # fmt: skip


@pytest.mark.parametrize("dtype", HALF, ids=["float16", "bfloat16"])
@pytest.mark.parametrize("name", ENTRY_POINTS)
def test_half_precision_is_float32_rounded_once(name, dtype):
    stored = arguments(dtype)
    value = ENTRY_POINTS[name](stored)
    wide = {k: v.float() for k, v in stored.items()}
    wide |= {k: unit(wide[k]) for k in ("normals", "view", "axis")}
    exact = ENTRY_POINTS[name](wide).clamp(-65504, 65504)
    assert value.dtype == dtype
    assert torch.isfinite(value).all()
    # `shade`'s sum of diffuse and specular is one rounding more; float16's subnormals are 6e-8 apart.
    eps = torch.finfo(dtype).eps
    torch.testing.assert_close(value.float(), exact, rtol=1.5 * eps, atol=1e-7 if dtype == torch.float16 else 0.0)


@pytest.mark.parametrize("name", ENTRY_POINTS)
def test_other_types_are_refused_with_the_remedy(name):
    mixed = arguments(torch.float32)
    mixed = {k: v.double() if k in ("amplitude", "f0", "rotation") else v for k, v in mixed.items()}
    whole = {k: (8 * v).to(torch.int64) for k, v in arguments(torch.float32).items()}
    for wrong in (mixed, whole):
        with pytest.raises(InputError, match=r"expected float16, bfloat16, float32 or float64.*convert them with"):
            ENTRY_POINTS[name](wrong)


@pytest.mark.parametrize("dtype", HALF, ids=["float16", "bfloat16"])
def test_gradients_reach_half_precision_inputs(dtype):
    a = arguments(dtype)
    leaves = [a[k].requires_grad_() for k in ("normals", "axis", "sharpness", "amplitude")]
    for gradient in torch.autograd.grad(irradiance(*leaves).sum(), leaves):
        assert gradient.dtype == dtype
        assert torch.isfinite(gradient).all()


def test_float16_saturates_where_it_ends():
    lobe = torch.tensor([[0, 0, 1.0]]).half(), torch.zeros(1).half(), torch.full((1, 3), 6e4).half()
    assert (irradiance(lobe[0], *lobe) == 65504).all()  # pi 6e4 is 188496
    assert torch.isinf(torch.tensor([188496.0]).half()).all()


def test_double_and_single_pass_through_untouched():
    for dtype in (torch.float32, torch.float64):
        a = torch.tensor([[0.0, 0.0, 3.0]], dtype=dtype)
        found, (b,) = widen((a,))
        assert found == dtype
        assert b is a
        assert narrow(a, dtype) is a
