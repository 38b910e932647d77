"""An optimiser step that cannot leave NaN behind: used by training and by both fits.

Notation: a step is refused when its loss or the norm of its gradient is not finite; the parameters then return to the
last state kept, with the optimiser's moments of that time.
"""

import copy

import torch
from torch import Tensor, nn

# A state is kept every so many accepted steps: a copy of small networks, which costs far less than one step.
KEEP_EVERY = 20


class GuardedOptimiser:
    """Steps of an optimiser, each of them checked.

    Parameters
    ----------
    optimiser : over leaf tensors
    clip : greatest norm of the gradients of `clipped`, or None
    most_refusals : refusals after which `exhausted` holds and the caller should end its stage

    Attributes
    ----------
    refused : steps refused so far
    """

    def __init__(
        self,
        optimiser: torch.optim.Optimizer,
        *,
        clip: float | None = None,
        clipped: list[nn.Parameter] | None = None,
        most_refusals: int = 10,
    ):
        self.optimiser, self.clip, self.most_refusals = optimiser, clip, most_refusals
        self.parameters = [p for group in optimiser.param_groups for p in group["params"]]
        self.clipped = self.parameters if clipped is None else clipped
        self.refused = 0
        self._accepted = 0
        self._keep()

    @property
    def exhausted(self) -> bool:
        """Whether so many steps were refused that going on is of no use."""
        return self.refused >= self.most_refusals

    def backward(self, loss: Tensor) -> bool:
        """Gradients of a loss; False, with everything as it was last kept, if loss or gradients are not finite."""
        self.optimiser.zero_grad(set_to_none=True)
        if not bool(torch.isfinite(loss)):
            return self._refuse()
        loss.backward()
        return True

    def step(self) -> bool:
        """Clip the gradients and move; False, with everything as it was last kept, if they are not finite."""
        gradients = [p.grad for p in self.parameters if p.grad is not None]
        if not gradients:
            return True
        if not bool(torch.isfinite(nn.utils.get_total_norm(gradients))):
            return self._refuse()
        if self.clip is not None:
            nn.utils.clip_grad_norm_(self.clipped, self.clip)
        self.optimiser.step()
        self._accepted += 1
        if self._accepted % KEEP_EVERY == 0:
            self._keep()
        return True

    def _refuse(self) -> bool:
        self.refused += 1
        self.optimiser.zero_grad(set_to_none=True)
        with torch.no_grad():
            for parameter, kept in zip(self.parameters, self._kept, strict=True):
                parameter.copy_(kept)
        # The rates are the schedule's, not the kept state's.
        rates = [group["lr"] for group in self.optimiser.param_groups]
        self.optimiser.load_state_dict(copy.deepcopy(self._kept_optimiser))
        for group, rate in zip(self.optimiser.param_groups, rates, strict=True):
            group["lr"] = rate
        return False

    def _keep(self) -> None:
        if not all(bool(torch.isfinite(p).all()) for p in self.parameters):
            return
        self._kept = [p.detach().clone() for p in self.parameters]
        self._kept_optimiser = copy.deepcopy(self.optimiser.state_dict())
