"""torch's Adam without torch's compiler.

Some of an optimiser's methods are wrapped so that `torch.compile` leaves them alone, and the first call of one imports
all of `torch._dynamo`: a second or two of every run, for a compiler that is not used here.
"""

from collections.abc import Callable

import torch


def _unwrapped(method: Callable) -> Callable:
    """What `functools.wraps` wrapped, or the method itself."""
    return getattr(method, "__wrapped__", method)


class Adam(torch.optim.Adam):
    """`torch.optim.Adam` (Kingma and Ba 2015, arXiv 1412.6980), with its wrapped methods as they were written.

    Not for `differentiable=True`: its steps are never part of a graph.
    """

    add_param_group = _unwrapped(torch.optim.Adam.add_param_group)
    zero_grad = _unwrapped(torch.optim.Adam.zero_grad)
    state_dict = _unwrapped(torch.optim.Adam.state_dict)
    load_state_dict = _unwrapped(torch.optim.Adam.load_state_dict)
    step = torch.no_grad()(_unwrapped(torch.optim.Adam.step))
