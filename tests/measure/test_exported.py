"""The exported file proves itself: a faithful one agrees with what it was made from, a spoilt one does not."""

import dataclasses
import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from sira_assets.asset.export_config import ExportConfig
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


def edited(data: bytes, change) -> bytes:
    """The GLB with its JSON, and its vertex data by name, given to `change` to be altered in place."""
    (length,) = struct.unpack_from("<I", data, 12)
    document, blob = json.loads(data[20 : 20 + length]), bytearray(data[28 + length :])
    arrays = {}
    for name, index in document["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        count = view["byteLength"] // 4
        arrays[name] = np.ndarray((accessor["count"], count // accessor["count"]), "<f4", blob, view["byteOffset"])
    change(document, arrays)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<IIIII", 0x46546C67, 2, 28 + len(text) + len(blob), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(blob), 0x004E4942) + bytes(blob)


def metal(document, arrays):
    document["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] = 1.0


def metal_by_default(document, arrays):
    del document["materials"][0]["pbrMetallicRoughness"]["metallicFactor"]


def rough_by_default(document, arrays):
    del document["materials"][0]["pbrMetallicRoughness"]["roughnessFactor"]


def no_specular_extension(document, arrays):
    document["materials"][0]["extensions"]["KHR_materials_specular"]["specularColorFactor"] = [0.04] * 3  # F0 = s / S


def v_not_flipped(document, arrays):
    arrays["TEXCOORD_0"][:, 1] = 1 - arrays["TEXCOORD_0"][:, 1]


def u_flipped(document, arrays):
    arrays["TEXCOORD_0"][:, 0] = 1 - arrays["TEXCOORD_0"][:, 0]


def handedness(document, arrays):
    arrays["TANGENT"][:, 3] *= -1


def tangents_turned(document, arrays):
    arrays["TANGENT"][:, :3] = np.cross(arrays["NORMAL"], arrays["TANGENT"][:, :3])


def z_up(document, arrays):
    for name in ("POSITION", "NORMAL"):
        arrays[name][:] = np.stack([arrays[name][:, 0], -arrays[name][:, 2], arrays[name][:, 1]], 1)


def mirrored(document, arrays):
    for name in ("POSITION", "NORMAL"):
        arrays[name][:, 0] = (4 if name == "POSITION" else 0) - arrays[name][:, 0]  # about the ball's own middle


def millimetres(document, arrays):
    arrays["POSITION"][:] *= 1000


def metres(document, arrays):
    arrays["POSITION"][:] *= document["scenes"][0]["extras"]["metres_per_unit"]


def light_in_canonical_frame(document, arrays):
    turn = np.linalg.inv(WORLD_FROM_CANONICAL)[:3, :3] * 1.3
    for lobe in document["scenes"][0]["extras"]["light"]["sgs"]:
        lobe["axis"] = (turn @ lobe["axis"]).tolist()


def camera_from_world(document, arrays):
    said = document["scenes"][0]["extras"]["camera"]
    said["world_from_camera"] = np.linalg.inv(said["world_from_camera"]).tolist()


# What an axis, a flip, a metal or a unit gone wrong in the writer would put into the file, and what the figure falls to
# from more than 90 dB: below the 38 that an avatar must reach, but for what touches highlights alone, a small part.
MISTAKES = [
    *((f, 38) for f in (metal, metal_by_default, v_not_flipped, u_flipped, handedness, tangents_turned, mirrored)),
    *((f, 38) for f in (light_in_canonical_frame, z_up, millimetres, metres, camera_from_world)),
    *((f, 42) for f in (rough_by_default, no_specular_extension)),
]
# After these the camera may look past the head, which is refused in words.
LOST = (z_up, millimetres, metres, camera_from_world)


@pytest.fixture(scope="module")
def faithful(tmp_path_factory):
    """A right file, and the neural render it stands for."""
    path = written(tmp_path_factory.mktemp("faithful"), smooth_maps())
    return path, *pictures(path)


@pytest.mark.parametrize(("mistake", "most_db"), MISTAKES, ids=lambda f: getattr(f, "__name__", ""))
def test_mistakes_of_the_file_show(tmp_path, mistake, most_db, faithful):
    path, final, mask = faithful
    (tmp_path / "a.glb").write_bytes(edited(path.read_bytes(), mistake))
    try:
        made = measure_exported(tmp_path / "a.glb", final, final, mask, shadows=False)
    except InputError:
        made = None
    if made is None:
        assert mistake in LOST
        return
    assert made.unweighted_psnr_db < most_db
    assert made.against_final.psnr_db < most_db


def test_an_edit_that_changes_nothing_changes_nothing(tmp_path, faithful):
    path, final, mask = faithful
    (tmp_path / "a.glb").write_bytes(edited(path.read_bytes(), lambda document, arrays: None))
    assert measure_exported(tmp_path / "a.glb", final, final, mask, shadows=False).unweighted_psnr_db > 90


@pytest.mark.parametrize("wrong", ["gamma", "linear", "flip", "normal", "specular", "roughness"])
def test_maps_of_another_encoding_show(tmp_path, wrong, faithful):
    _, final, mask = faithful
    maps = smooth_maps()
    changes = {
        "gamma": {"diffuse": maps.diffuse ** (1 / 2.2)},
        "linear": {"diffuse": maps.diffuse**2.2},
        "flip": {"diffuse": maps.diffuse[::-1].copy()},
        "normal": {"normal_tangent": maps.normal_tangent * np.float32([1, -1, 1])},  # DirectX's green
        "specular": {"specular_f0": maps.specular_f0 / np.float32(0.04)},  # ks for F0
        "roughness": {},
    }[wrong]
    options = {"roughness": 0.1} if wrong == "roughness" else {}
    path = written(tmp_path, dataclasses.replace(maps, **changes), **options)
    assert measure_exported(path, final, final, mask, shadows=False).unweighted_psnr_db < 38


@pytest.mark.parametrize(
    "config",
    [ExportConfig("factor"), ExportConfig(quantise=True), ExportConfig(jpeg_quality=95)],
    ids=["factor form", "quantised", "JPEG"],
)
def test_every_option_writes_the_same_asset(tmp_path, config, faithful):
    _, final, mask = faithful
    avatar = dataclasses.replace(avatar_of(smooth_maps()), camera=portrait_camera())
    write_glb(avatar, tmp_path / "avatar.glb", config)
    found = measure_exported(tmp_path / "avatar.glb", final, final, mask, shadows=False).unweighted_psnr_db
    # Quantised: 16-bit normals and positions. JPEG: some codes. Factor: F90 is not 1, so the outline shines less.
    assert found > (60 if config.quantise else 42)


def test_a_file_without_its_camera_is_refused(tmp_path):
    final, mask = pictures(written(tmp_path, smooth_maps()))
    write_glb(avatar_of(smooth_maps()), tmp_path / "avatar.glb")
    with pytest.raises(InputError, match="camera"):
        measure_exported(tmp_path / "avatar.glb", final, final, mask, shadows=False)
