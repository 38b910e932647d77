"""Fits of a few steps, and scenes small enough for them."""

import subprocess
import sys
from pathlib import Path

from sira_assets.fit.appearance_losses import AppearanceFitConfig
from sira_assets.fit.geometry import GeometryFitConfig
from sira_assets.mesh.extract import ExtractConfig
from sira_assets.pipeline import Settings
from sira_assets.texture.bake import BakeConfig
from sira_assets.texture.unwrap import UnwrapConfig

TOOLS = Path(__file__).resolve().parents[2] / "tools"


def tiny_settings(quality="draft", *, seed=0, **ignored) -> Settings:
    """In place of `settings_for`."""
    geometry = GeometryFitConfig(
        steps_appearance=3,
        steps_codes=3,
        steps_networks=3,
        steps_cover=2,
        pool=200,
        band_pool=80,
        rays=50,
        band_rays=30,
        seed=seed,
    )
    appearance = AppearanceFitConfig(
        steps_light=3, steps_albedo=3, steps_specular=3, steps_refinement=3, pixels=100, shadows=False, seed=seed
    )
    return Settings(
        quality,
        geometry,
        appearance,
        ExtractConfig(cell_m=0.01),
        max_triangles=500,
        unwrap=UnwrapConfig(texture_size=64, methods=()),
        bake=BakeConfig(size=64, samples=1),
        seed=seed,
    )


def make_scenes(out: Path, egg: Path, *arguments) -> Path:
    """Scenes of an egg, with the full truth."""
    command = [sys.executable, TOOLS / "make_scenes.py", "--from-scan", egg, "--out", out, "--workers", 1, "--quiet"]
    command += ["--samples", 4, *arguments]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return out
