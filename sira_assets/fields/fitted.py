"""A fitted head: the prior's networks at one person's codes, plus the albedo refinement, as a HeadField and a file.

Notation: as in fields/sa_sm.py and fields/af_sm.py; a = a_base(x_ref, gamma; z_a) + k_r a_refine(x_ref, gamma)
(SIRA section 3.3).
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from sira_assets.errors import InputError
from sira_assets.fields.af_sm import AppearanceConfig, AppearanceFactorModel
from sira_assets.fields.mlp import MLP, UNIT_M
from sira_assets.fields.prior import freeze
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig
from sira_assets.fields.tensor_file import write_tensors


@dataclass(frozen=True)
class RefinementConfig:
    """Size of a_refine.

    Parameters
    ----------
    waves : random plane waves that encode x_ref
    longest, shortest : their wavelengths, network units; 0.03 is 3 mm, about two pixels of a 512-pixel portrait
    """

    width: int = 128
    depth: int = 3
    waves: int = 128
    longest: float = 4.0
    shortest: float = 0.03


class AlbedoRefinement(nn.Module):
    """a_refine(x_ref, gamma): what one person's albedo has and the prior has not (moles, stubble, eyebrows, prints)."""

    def __init__(self, config: RefinementConfig = RefinementConfig(), *, feature_size: int = 16):
        super().__init__()
        self.config = config
        self.net = MLP(2 * config.waves + feature_size, 3, width=config.width, depth=config.depth)
        nn.init.zeros_(self.net.out.weight)
        self.register_buffer("frequencies", wave_vectors(config))

    def forward(self, x_ref: Float[Tensor, "N 3"], gamma: Float[Tensor, "N G"]) -> Float[Tensor, "N 3"]:
        """Correction to the linear albedo, zero before training."""
        phase = x_ref @ self.frequencies
        return self.net(torch.cat([torch.sin(phase), torch.cos(phase), gamma], -1))


def wave_vectors(config: RefinementConfig) -> Float[Tensor, "3 W"]:
    """Angular wave vectors: random directions, wavelengths even in the logarithm.

    Directions off the axes: the encoding by octaves along each axis (see `fields.mlp.encode`) leaves a weave of its
    own in the albedo. Tancik et al. 2020, Fourier features let networks learn high frequency functions, arXiv
    2006.10739.
    """
    generator = torch.Generator().manual_seed(0)
    direction = nn.functional.normalize(torch.randn(3, config.waves, generator=generator, dtype=torch.float64), dim=0)
    share = torch.linspace(0.0, 1.0, config.waves, dtype=torch.float64)
    wavelength = config.longest * (config.shortest / config.longest) ** share
    return (2.0 * torch.pi * direction / wavelength).float()


@dataclass(frozen=True)
class FittedHead:
    """One person's head, in the canonical frame.

    Parameters
    ----------
    shape, appearance : the networks, frozen
    z_sdf, z_a, z_s : (Z,) codes
    refinement : a_refine, or None where the scene required none
    specular_scale : k_s in [0, 1]; 0 where the scene showed no highlight
    """

    shape: ShapeAppearanceModel
    appearance: AppearanceFactorModel
    z_sdf: Float[Tensor, " Z"]
    z_a: Float[Tensor, " Z"]
    z_s: Float[Tensor, " Z"]
    refinement: AlbedoRefinement | None = None
    specular_scale: float = 1.0

    @property
    def shortest_wave_m(self) -> float:
        """Of the waves that the albedo is made of, canonical metres; the shape's and the prior's are longer."""
        config = RefinementConfig() if self.refinement is None else self.refinement.config
        return config.shortest * UNIT_M

    def sdf(self, x_canonical: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """Signed distance in canonical metres."""
        sdf, _, _ = self.shape(x_canonical / UNIT_M, self.z_sdf)
        return sdf * UNIT_M

    def material(self, x_canonical: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
        """Diffuse albedo in [0, 1] and specular albedo F0."""
        x = x_canonical / UNIT_M
        delta, gamma = self.shape.deform(x, self.z_sdf)
        return self.reference_material(x + delta, gamma)

    def reference_material(
        self, x_ref: Float[Tensor, "N 3"], gamma: Float[Tensor, "N G"]
    ) -> tuple[Float[Tensor, "N 3"], Float[Tensor, " N"]]:
        """The material where x_ref and gamma (network units) are known already."""
        diffuse = self.appearance.diffuse(x_ref, gamma, self.z_a)
        if self.refinement is not None:
            diffuse = (diffuse + self.refinement(x_ref, gamma)).clamp(0.0, 1.0)
        return diffuse, self.specular_scale * self.appearance.specular_f0(x_ref, diffuse, self.z_s)


def save_fitted(head: FittedHead, path: Path, header: dict | None = None) -> None:
    """Write a fitted head; `header` (JSON) travels in the file's metadata."""
    modules = {"shape": head.shape, "appearance": head.appearance, "refinement": head.refinement}
    tensors = {f"{n}/{k}": v for n, m in modules.items() if m is not None for k, v in m.state_dict().items()}
    tensors |= {"z_sdf": head.z_sdf, "z_a": head.z_a, "z_s": head.z_s}
    metadata = {n: json.dumps(asdict(m.config)) for n, m in modules.items() if m is not None}
    metadata |= {"specular_scale": json.dumps(head.specular_scale), "header": json.dumps(header or {})}
    write_tensors(path, {k: v.float() for k, v in tensors.items()}, metadata)


def load_fitted(path: Path, *, device: str | torch.device = "cpu") -> FittedHead:
    """Read a fitted head.

    Raises
    ------
    InputError : no such file, or one that holds something else.
    """
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
        shape = ShapeAppearanceModel(ShapeConfig(**json.loads(metadata["shape"])))
        feature_size = shape.config.feature_size
        appearance = AppearanceFactorModel(
            AppearanceConfig(**json.loads(metadata["appearance"])), feature_size=feature_size
        )
        modules = {"shape": shape, "appearance": appearance}
        if "refinement" in metadata:
            refinement = RefinementConfig(**json.loads(metadata["refinement"]))
            modules["refinement"] = AlbedoRefinement(refinement, feature_size=feature_size)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            expected=f"a fitted head (field.safetensors) at {path}",
            received=f"{type(error).__name__}: {error}",
            remedy="export the avatar again",
        ) from None
    for name, module in modules.items():
        module.load_state_dict({k.split("/", 1)[1]: v for k, v in tensors.items() if k.startswith(f"{name}/")})
        freeze(module.to(device))
    codes = (tensors[name].to(device) for name in ("z_sdf", "z_a", "z_s"))
    return FittedHead(shape, appearance, *codes, modules.get("refinement"), json.loads(metadata["specular_scale"]))
