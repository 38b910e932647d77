"""Fits kept on disk as they finish, so that a killed run goes on from the last finished one.

A kept fit is found again only under the same key: portrait, settings, prior and version.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open

from sira_assets import __version__
from sira_assets.errors import InputError
from sira_assets.fields.fitted import load_fitted, save_fitted
from sira_assets.fields.prior import CODE_NAMES, Prior, freeze
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig
from sira_assets.fields.tensor_file import write_tensors
from sira_assets.fit.appearance import AppearanceFit
from sira_assets.fit.decision import FitDecision
from sira_assets.fit.geometry import GeometryFit
from sira_assets.scene.portrait import Portrait
from sira_assets.scene.sg_light import SGLight


def fit_key(portrait: Portrait, prior: Prior, settings_repr: str) -> str:
    """Digest of everything that a fit depends on."""
    digest = hashlib.sha256(f"{__version__} {settings_repr}".encode())
    arrays = [portrait.image_linear, portrait.mask, portrait.saturated, portrait.canonical_from_world]
    arrays += [portrait.camera.intrinsics, portrait.camera.world_from_camera]
    arrays += [getattr(prior, name).basis.cpu().numpy() for name in CODE_NAMES]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def keep_geometry(fit: GeometryFit, folder: Path, key: str) -> None:
    """Write a geometry fit."""
    tensors = {f"shape/{k}": v for k, v in fit.shape.state_dict().items()} | {"z_sdf": fit.z_sdf, "z_r": fit.z_r}
    tensors["canonical_from_world"] = torch.as_tensor(fit.canonical_from_world, dtype=torch.float64)
    facts = {
        "key": key,
        "shape": vars(fit.shape.config),
        "history": fit.history,
        "pose_change_deg": fit.pose_change_deg,
        "pose_change_m": fit.pose_change_m,
        "warnings": fit.warnings,
        "seconds": fit.seconds,
    }
    write_tensors(folder / "geometry.safetensors", tensors, {"facts": json.dumps(facts)})


def kept_geometry(folder: Path, key: str, *, device: str | torch.device = "cpu") -> GeometryFit | None:
    """The geometry fit kept under this key, or None."""
    try:
        with safe_open(folder / "geometry.safetensors", "pt", device=str(device)) as file:
            facts = json.loads(file.metadata()["facts"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (OSError, SafetensorError, KeyError, ValueError):
        return None
    if facts["key"] != key:
        return None
    shape = ShapeAppearanceModel(ShapeConfig(**facts["shape"])).to(device)
    shape.load_state_dict({k.split("/", 1)[1]: v for k, v in tensors.items() if k.startswith("shape/")})
    freeze(shape)
    return GeometryFit(
        shape,
        tensors["z_sdf"],
        tensors["z_r"],
        tensors["canonical_from_world"].cpu().numpy(),
        tuple((step, losses) for step, losses in facts["history"]),
        facts["pose_change_deg"],
        facts["pose_change_m"],
        tuple(facts["warnings"]),
        facts["seconds"],
    )


def keep_appearance(fit: AppearanceFit, folder: Path, key: str) -> None:
    """Write an appearance fit."""
    facts = {
        "key": key,
        "light": fit.light.to_dict(),
        "roughness": fit.roughness,
        "shadowed": fit.shadowed,
        "warnings": fit.warnings,
        "history": fit.history,
        "decisions": [asdict(decision) for decision in fit.decisions],
        "seconds": fit.seconds,
    }
    save_fitted(fit.head, folder / "appearance.safetensors", facts)


def kept_appearance(folder: Path, key: str, *, device: str | torch.device = "cpu") -> AppearanceFit | None:
    """The appearance fit kept under this key, or None."""
    path = folder / "appearance.safetensors"
    try:
        with safe_open(path, "pt") as file:
            facts = json.loads(file.metadata()["header"])
        if facts.get("key") != key:
            return None
        head = load_fitted(path, device=device)
    except (OSError, SafetensorError, KeyError, ValueError, InputError):
        return None
    history = tuple((step, losses) for step, losses in facts["history"])
    decisions = tuple(FitDecision(**decision) for decision in facts["decisions"])
    return AppearanceFit(
        head,
        SGLight.from_dict(facts["light"]),
        facts["roughness"],
        facts["shadowed"],
        history,
        decisions,
        tuple(facts["warnings"]),
        facts["seconds"],
    )
