"""Which floating-point types the arithmetic of light accepts.

float64 and float32 are computed as they are. float16 and bfloat16 are for storing: their values are widened to
float32, computed there, and rounded once at the end, so that only the rounding of what came in and of what goes out is
left. A unit vector rounded to half precision is up to 2^-9 (bfloat16) or 2^-12 (float16) off its length and is
normalised again. Beyond 65504, float16 holds nothing: results saturate there.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from sira_assets.errors import InputError
from sira_assets.numerics.vector import unit

STORED = (torch.float16, torch.bfloat16)
COMPUTED = (torch.float32, torch.float64)


def widen(directions: Sequence[Tensor], numbers: Sequence[Tensor] = ()) -> tuple[torch.dtype, list[Tensor]]:
    """The inputs in the type that they are computed in, and the type that the result goes back to.

    Parameters
    ----------
    directions : unit vectors (..., 3)
    numbers : everything else

    Returns
    -------
    The common type of the inputs; directions, then numbers, as float32 or float64

    Raises
    ------
    InputError : the types differ, or are none of float16, bfloat16, float32, float64.
    """
    found = {t.dtype for t in (*directions, *numbers)}
    if len(found) != 1 or not found <= {*STORED, *COMPUTED}:
        raise InputError(
            expected="float16, bfloat16, float32 or float64, one and the same for all arguments",
            received=", ".join(sorted(str(d).removeprefix("torch.") for d in found)),
            remedy="convert them with .to(torch.float32)",
        )
    dtype = found.pop()
    if dtype in COMPUTED:
        return dtype, [*directions, *numbers]
    return dtype, [*(unit(d.float()) for d in directions), *(n.float() for n in numbers)]


def narrow(value: Tensor, dtype: torch.dtype) -> Tensor:
    """`value` in `dtype`; what float16 cannot hold becomes its largest number, 65504, and not infinity."""
    if dtype == torch.float16:
        largest = torch.finfo(dtype).max
        value = value.clamp(-largest, largest)
    return value.to(dtype)
