"""Building blocks of every network: positional encoding and a plain multilayer perceptron.

Notation: x (N, D) inputs; PE_K(x) = (x, sin(2^k x), cos(2^k x)) for k < K (Mildenhall 2020, DOI 10.1145/3503250), in
network units (`UNIT_M` canonical metres each), so the shortest wavelength is 2 pi UNIT_M / 2^(K-1).
"""

import itertools

import torch
from jaxtyping import Float
from torch import Tensor, nn

# One network unit in canonical metres. A head then spans about +-1.5 units, where sin(2^0 x) is still one-to-one.
UNIT_M = 0.1


def encode(x: Float[Tensor, "N D"], octaves: int) -> Float[Tensor, "N E"]:
    """Positional encoding with E = D (1 + 2 octaves)."""
    if octaves == 0:
        return x
    scaled = x[..., None] * (2.0 ** torch.arange(octaves, dtype=x.dtype, device=x.device))
    return torch.cat([x, torch.sin(scaled).flatten(-2), torch.cos(scaled).flatten(-2)], -1)


def encoded_size(dimension: int, octaves: int) -> int:
    """E of `encode`."""
    return dimension * (1 + 2 * octaves)


class MLP(nn.Module):
    """`depth` hidden layers of `width`, SiLU, linear output.

    The eikonal term differentiates the gradient, so the activation must be smooth. SiLU instead of the softplus of IDR
    and its kin: the same shape, and a step with double backward costs a quarter on a CPU.
    """

    def __init__(self, inputs: int, outputs: int, *, width: int, depth: int):
        super().__init__()
        sizes = [inputs] + [width] * depth
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        self.out = nn.Linear(width, outputs)
        for layer in self.hidden:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            nn.init.zeros_(layer.bias)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Float[Tensor, "N D"], code: Float[Tensor, "..."] | None = None) -> Float[Tensor, "N O"]:
        """Apply the layers to x with a latent code appended: (Z,) for one scene, or (N, Z) for one scene a point."""
        first, *rest = self.hidden
        if code is None or code.ndim > 1:
            x = first(x if code is None else torch.cat([x, code], -1))
        else:
            # A code that all points share adds the same to all of them, so its columns are multiplied once.
            own = x.shape[-1]
            x = nn.functional.linear(
                x, first.weight[:, :own], nn.functional.linear(code, first.weight[:, own:], first.bias)
            )
        # Nothing looks back at what a layer gave unless a gradient does.
        in_place = not torch.is_grad_enabled()
        x = nn.functional.silu(x, inplace=in_place)
        for layer in rest:
            x = nn.functional.silu(layer(x), inplace=in_place)
        # Under autocast the hidden layers may run in bfloat16; a distance needs the digits of float32.
        with torch.autocast(x.device.type, enabled=False):
            return self.out(x.to(self.out.weight.dtype))
