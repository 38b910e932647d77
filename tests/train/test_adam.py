"""Adam as torch has it, without torch's compiler."""

import subprocess
import sys

import torch

from sira_assets.train.adam import Adam


def descended(kind, steps=30):
    x = torch.linspace(-1.0, 1.0, 7).requires_grad_(True)
    y = torch.ones(2, 3, requires_grad=True)
    optimiser = kind([{"params": [x], "lr": 0.1}, {"params": [y], "lr": 0.02}])
    for step in range(steps):
        optimiser.zero_grad(set_to_none=True)
        ((x - 2.0) ** 2 * torch.arange(7)).sum().add((y**4).sum()).backward()
        optimiser.step()
        if step == steps // 2:
            optimiser.load_state_dict(optimiser.state_dict())
    return x.detach(), y.detach()


def test_the_same_steps_to_the_last_bit():
    for ours, theirs in zip(descended(Adam), descended(torch.optim.Adam), strict=True):
        assert torch.equal(ours, theirs)


def test_steps_leave_gradients_as_they_were_switched():
    for on in (True, False):
        x = torch.ones(3, requires_grad=True)
        x.grad = torch.ones(3)
        with torch.set_grad_enabled(on):
            Adam([{"params": [x], "lr": 0.1}]).step()
            assert torch.is_grad_enabled() == on
        assert x.requires_grad


def test_no_compiler_is_imported():
    code = (
        "import sys, torch; from sira_assets.train.adam import Adam; x = torch.ones(3, requires_grad=True);"
        "o = Adam([{'params': [x], 'lr': 0.1}]); o.zero_grad(); x.sum().backward(); o.step();"
        "o.load_state_dict(o.state_dict()); sys.exit('torch._dynamo' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 0
