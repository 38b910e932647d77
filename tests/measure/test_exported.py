"""The exported file proves itself: a faithful one agrees with what it was made from, a spoilt one does not."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from sira_assets.asset.gltf import write_glb
from sira_assets.errors import InputError
from sira_assets.measure.exported import measure_exported
from sira_assets.relight.glb_model import read_glb
from sira_assets.relight.render import render_asset
from sira_assets.scene.camera import Camera
from sira_assets.texture.texture_set import TextureSet

sys.path.append(str(Path(__file__).resolve().parents[1] / "asset"))
from sample_avatar import WORLD_FROM_CANONICAL, avatar_of, flat_maps, smooth_maps


def portrait_camera() -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = WORLD_FROM_CANONICAL[:3, :3] / 1.3 @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = (WORLD_FROM_CANONICAL @ [0, 0, 1.0, 1])[:3]
    return Camera(np.array([[140.0, 0, 20], [0, 140, 20], [0, 0, 1]]), pose, 40, 40)


def written(tmp_path, maps: TextureSet, **changes) -> Path:
    avatar = dataclasses.replace(avatar_of(maps), camera=portrait_camera(), **changes)
    write_glb(avatar, tmp_path / "avatar.glb")
    return tmp_path / "avatar.glb"


def pictures(path: Path) -> tuple[np.ndarray, np.ndarray]:
    model = read_glb(path)
    made = render_asset(
        model, portrait_camera(), avatar_of(flat_maps()).light, shadows=False, supersample=1, gltf_weighting=False
    )
    return made.radiance, made.alpha > 0


def test_a_faithful_file_differs_by_the_weighting_alone(tmp_path):
    path = written(tmp_path, smooth_maps())
    final, mask = pictures(path)
    made = measure_exported(path, final, final, mask, shadows=False)
    assert made.unweighted_psnr_db > 90  # the light went through JSON: float64 either way
    # 1 - F takes 2 to 8 % of the diffuse part here (F0 is 0.02 to 0.07), half of that after sRGB
    assert 38 < made.against_final.psnr_db < 48
    assert made.against_final.psnr_db == made.against_photo.psnr_db


@pytest.mark.parametrize("spoil", ["gamma", "flip", "roughness"])
def test_mistakes_of_the_file_show(tmp_path, spoil):
    final, mask = pictures(written(tmp_path, smooth_maps()))
    maps = smooth_maps()
    changes = {
        "gamma": {"diffuse": maps.diffuse ** (1 / 2.2)},
        "flip": {"diffuse": maps.diffuse[::-1].copy()},
        "roughness": {},
    }[spoil]
    options = {"roughness": 0.1} if spoil == "roughness" else {}
    path = written(tmp_path, dataclasses.replace(maps, **changes), **options)
    assert measure_exported(path, final, final, mask, shadows=False).unweighted_psnr_db < 38


def test_a_file_without_its_camera_is_refused(tmp_path):
    final, mask = pictures(written(tmp_path, smooth_maps()))
    write_glb(avatar_of(smooth_maps()), tmp_path / "avatar.glb")
    with pytest.raises(InputError, match="camera"):
        measure_exported(tmp_path / "avatar.glb", final, final, mask, shadows=False)
