"""The trained prior: both models and the gaussians of their codes over the training heads, in one safetensors file.

Notation: a code z of size Z is drawn as z = mean + basis c with c ~ N(0, I_K): the principal directions of the trained
codes scaled by their standard deviations, so that |c|^2 is a squared Mahalanobis distance.
"""

import copy
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from sira_assets.errors import InputError
from sira_assets.fields.af_sm import AppearanceConfig, AppearanceFactorModel
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig
from sira_assets.fields.tensor_file import write_tensors

CODE_NAMES = ("z_sdf", "z_r", "z_a", "z_s", "z_l")


@dataclass(frozen=True)
class CodeStatistics:
    """Gaussian of one code: mean (Z,), basis (Z, K) with columns of decreasing length."""

    mean: Float[Tensor, " Z"]
    basis: Float[Tensor, "Z K"]

    def code(self, coefficients: Float[Tensor, "*B K"]) -> Float[Tensor, "*B Z"]:
        """z = mean + basis c."""
        # Autocast multiplies matrices in bfloat16, which would leave a code three digits.
        with torch.autocast(coefficients.device.type, enabled=False):
            return self.mean + coefficients @ self.basis.T

    @staticmethod
    def of(codes: Float[Tensor, "N Z"], *, variance: float = 0.999) -> "CodeStatistics":
        """Principal directions that hold this share of the variance of trained codes."""
        mean = codes.mean(0)
        _, s, vt = torch.linalg.svd(codes - mean, full_matrices=False)
        share = torch.cumsum(s**2, 0) / (s**2).sum().clamp_min(1e-30)
        rank = min(int((share < variance).sum()) + 1, len(s))
        scale = s[:rank] / max(len(codes) - 1, 1) ** 0.5
        return CodeStatistics(mean.contiguous(), (vt[:rank].T * scale).contiguous())


@dataclass(frozen=True)
class Prior:
    """SA-SM, AF-SM and the statistics of z_sdf, z_r, z_a, z_s, z_l."""

    shape: ShapeAppearanceModel
    appearance: AppearanceFactorModel
    z_sdf: CodeStatistics
    z_r: CodeStatistics
    z_a: CodeStatistics
    z_s: CodeStatistics
    z_l: CodeStatistics

    def to(self, device: str | torch.device) -> "Prior":
        """The prior on another device."""
        move = lambda s: CodeStatistics(s.mean.to(device), s.basis.to(device))  # noqa: E731
        return Prior(
            copy.deepcopy(self.shape).to(device),
            copy.deepcopy(self.appearance).to(device),
            *(move(getattr(self, name)) for name in CODE_NAMES),
        )


def untrained_appearance(prior: Prior, seed: int = 0) -> Prior:
    """The same shapes with an AF-SM that has learnt nothing: first weights, and codes of mean zero."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        new = AppearanceFactorModel(prior.appearance.config, feature_size=prior.shape.config.feature_size)
    blank = lambda statistics: replace(statistics, mean=torch.zeros_like(statistics.mean))  # noqa: E731
    z_a, z_s, z_l = blank(prior.z_a), blank(prior.z_s), blank(prior.z_l)
    return replace(prior, appearance=freeze(new.to(z_a.mean.device)), z_a=z_a, z_s=z_s, z_l=z_l)


def save_prior(prior: Prior, path: Path, description: dict) -> None:
    """Write the prior as float32; `description` (what trained it) goes into the file's header as JSON."""
    tensors = {f"shape/{k}": v for k, v in prior.shape.state_dict().items()}
    tensors |= {f"appearance/{k}": v for k, v in prior.appearance.state_dict().items()}
    for name in CODE_NAMES:
        statistics = getattr(prior, name)
        tensors |= {f"{name}/mean": statistics.mean, f"{name}/basis": statistics.basis}
    header = {
        "shape": json.dumps(asdict(prior.shape.config)),
        "appearance": json.dumps(asdict(prior.appearance.config)),
        "description": json.dumps(description),
    }
    write_tensors(path, {k: v.float() for k, v in tensors.items()}, header)


def load_prior(path: Path | None = None) -> Prior:
    """Read a prior; without a path, the one that ships with the package.

    Raises
    ------
    InputError : no such file, or one that holds something else.
    """
    path = Path(path) if path is not None else Path(__file__).parent / "weights" / "prior.safetensors"
    try:
        with safe_open(path, "pt") as file:
            header = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
        shape = ShapeAppearanceModel(ShapeConfig(**json.loads(header["shape"])))
        appearance = AppearanceFactorModel(
            AppearanceConfig(**json.loads(header["appearance"])), feature_size=shape.config.feature_size
        )
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            expected=f"a trained prior at {path}",
            received=f"{type(error).__name__}: {error}",
            remedy="train one: python tools/train_prior.py --scenes DIR --out FILE",
        ) from None
    for name, model in (("shape", shape), ("appearance", appearance)):
        model.load_state_dict({k.split("/", 1)[1]: v for k, v in tensors.items() if k.startswith(f"{name}/")})
        freeze(model)
    return Prior(shape, appearance, *(CodeStatistics(tensors[f"{n}/mean"], tensors[f"{n}/basis"]) for n in CODE_NAMES))


def freeze(model: nn.Module) -> nn.Module:
    """No gradients for the weights; evaluation mode."""
    return model.requires_grad_(False).eval()
