import dataclasses
import io
import itertools
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from glb_reader import read_glb
from sample_avatar import avatar_of, shaded_maps, smooth_maps

from sira_assets.asset.encoding import decode_normal, decode_srgb, encode_srgb
from sira_assets.asset.export_config import ExportConfig
from sira_assets.asset.glb_file import GlbFile
from sira_assets.asset.gltf import glb_bytes, write_glb
from sira_assets.asset.split import split_at_seams
from sira_assets.scene.camera import Camera
from sira_assets.scene.sg_light import SGLight


@pytest.fixture(scope="module")
def glb(avatar):
    return read_glb(glb_bytes(avatar))


def corners(avatar):
    """World positions (F, 3, 3) and bottom-left UVs (F, 3, 2) of every face corner."""
    return avatar.mesh.vertices[avatar.mesh.faces], avatar.atlas.uv[avatar.atlas.faces_uv]


def test_every_corner_keeps_its_world_position_and_its_place_in_the_picture(avatar, glb):
    positions, uv = corners(avatar)
    assert (glb.attribute("POSITION")[glb.faces] == positions.astype(np.float32)).all()
    stored = glb.attribute("TEXCOORD_0")[glb.faces]
    assert (stored[..., 0] == uv[..., 0].astype(np.float32)).all()
    # glTF's v runs down.
    assert (stored[..., 1] == (1 - uv[..., 1]).astype(np.float32)).all()


def test_vertices_are_split_at_seams_only(avatar, glb):
    split = split_at_seams(avatar.mesh.faces, avatar.atlas.faces_uv)
    assert len(glb.attribute("POSITION")) == len(split.position_index)
    assert len(avatar.mesh.vertices) < len(split.position_index) <= len(avatar.atlas.uv)


def test_bounds_are_those_of_the_stored_numbers(glb):
    accessor = glb.document["accessors"][glb.primitive["attributes"]["POSITION"]]
    stored = glb.attribute("POSITION")
    assert (np.float32(accessor["min"]) == stored.min(0)).all()
    assert (np.float32(accessor["max"]) == stored.max(0)).all()


def test_normals_and_tangents_are_a_frame_that_follows_the_picture(avatar, glb):
    normal, tangent = glb.attribute("NORMAL"), glb.attribute("TANGENT")
    # float32 rounding of a unit vector.
    assert np.abs(np.linalg.norm(normal, axis=1) - 1).max() < 1e-6
    assert np.abs(np.linalg.norm(tangent[:, :3], axis=1) - 1).max() < 1e-6
    assert set(np.unique(tangent[:, 3])) <= {-1.0, 1.0}
    positions, uv = corners(avatar)
    e1, e2 = positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    det = d1[:, :1] * d2[:, 1:] - d1[:, 1:] * d2[:, :1]
    along_u = (e1 * d2[:, 1:] - e2 * d1[:, 1:]) / det
    along_v = (e2 * d1[:, :1] - e1 * d2[:, :1]) / det
    n, t = (a[glb.faces].astype(np.float64) for a in (normal, tangent))
    # glTF: bitangent = cross(normal, tangent.xyz) * tangent.w; green is the direction of growing (bottom-left) v.
    bitangent = np.cross(n, t[..., :3]) * t[..., 3:]
    regular = np.abs(uv[:, :, 1] - 0.5).max(1) < 0.4  # near the poles u is degenerate
    assert ((t[..., :3] * along_u[:, None]).sum(-1)[regular] > 0).all()
    assert ((bitangent * along_v[:, None]).sum(-1)[regular] > 0).all()


def test_faces_wind_outward(glb):
    p = glb.attribute("POSITION")[glb.faces].astype(np.float64)
    p -= p.mean((0, 1))
    assert np.einsum("fi,fi->", p[:, 0], np.cross(p[:, 1], p[:, 2])) > 0


def test_skin_is_no_metal_and_only_one_extension_is_used_and_none_required(avatar, glb):
    pbr = glb.material["pbrMetallicRoughness"]
    assert pbr["metallicFactor"] == 0.0
    assert pbr["roughnessFactor"] == avatar.roughness
    assert glb.document["extensionsUsed"] == ["KHR_materials_specular"]
    assert "extensionsRequired" not in glb.document
    assert "specularFactor" not in glb.specular, "it would scale F90 as well"


def test_texels_are_the_maps(avatar, glb):
    maps = avatar.textures
    assert (glb.texels(glb.material["pbrMetallicRoughness"]["baseColorTexture"]) == encode_srgb(maps.diffuse)).all()
    normal = decode_normal(glb.texels(glb.material["normalTexture"]))
    # 0.4 degrees: the step of eight bits.
    assert (normal * maps.normal_tangent).sum(-1).min() > np.cos(np.radians(0.4))


def specular_f0(glb) -> np.ndarray:
    """F0 as the extension defines it for an index of refraction of 1.5."""
    texels = decode_srgb(glb.texels(glb.specular["specularColorTexture"]))
    return 0.04 * np.array(glb.specular["specularColorFactor"]) * texels


@pytest.mark.parametrize("scale", [0.01, 1.0, 10.0])
def test_specular_albedo_is_read_back_whatever_its_range(scale):
    maps = smooth_maps()
    maps = dataclasses.replace(maps, specular_f0=maps.specular_f0 * np.float32(scale))
    f0 = specular_f0(read_glb(glb_bytes(avatar_of(maps))))
    largest = maps.specular_f0.max()
    # sRGB's steepest slope is 2.4 / 1.055 at white: half a step there is 0.0045 of the largest value.
    assert np.abs(f0 - maps.specular_f0[..., None]).max() <= 0.0045 * largest


def test_constant_maps_become_factors(flat_avatar):
    glb = read_glb(glb_bytes(flat_avatar))
    assert "images" not in glb.document
    assert glb.material["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx([0.5, 0.3, 0.2, 1.0])
    assert glb.specular["specularColorFactor"] == pytest.approx([0.7] * 3)
    assert "normalTexture" not in glb.material
    assert "TANGENT" not in glb.primitive["attributes"]


def test_no_specular_at_all_is_a_factor_of_zero():
    maps = dataclasses.replace(smooth_maps(), specular_f0=np.zeros((64, 64), np.float32))
    glb = read_glb(glb_bytes(avatar_of(maps)))
    # The factor scales F90 too; a colour of 0 would leave the reflection at grazing angles.
    assert glb.specular == {"specularFactor": 0.0}


def test_extras_carry_unit_frame_and_light(avatar, glb):
    extras = glb.document["scenes"][0]["extras"]
    assert extras["metres_per_unit"] == avatar.metres_per_unit
    assert np.array(extras["canonical_from_world"]) == pytest.approx(avatar.canonical_from_world, abs=0)
    light = SGLight.from_dict(extras["light"])
    # Axes are normalised anew when read.
    assert light.axis == pytest.approx(avatar.light.axis, abs=1e-15)
    assert (light.sharpness == avatar.light.sharpness).all()
    assert (light.amplitude == avatar.light.amplitude).all()


def test_the_same_avatar_gives_the_same_bytes(avatar, tmp_path):
    write_glb(avatar, tmp_path / "a.glb")
    write_glb(avatar_of(smooth_maps()), tmp_path / "b.glb")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.glb", "b.glb"]


@pytest.mark.parametrize(("count", "kind"), [(65535, 5123), (65536, 5125)])
def test_indices_never_hold_the_value_that_restarts_primitives(count, kind):
    file = GlbFile()
    file.add_indices(np.array([[0, 1, count - 1]]), count)
    glb = read_glb(file.to_bytes({"asset": {"version": "2.0"}}))
    assert glb.document["accessors"][0]["componentType"] == kind
    assert glb.accessor(0).tolist() == [0, 1, count - 1]
    assert count - 1 < np.iinfo(glb.accessor(0).dtype).max


@pytest.mark.parametrize("size", range(1, 9))
def test_views_start_at_multiples_of_four_whatever_precedes_them(size):
    file = GlbFile()
    file.add_view(b"x" * size)
    file.add_vectors(np.eye(3))
    glb = read_glb(file.to_bytes({"asset": {"version": "2.0", "note": "é" * size}}))
    assert (glb.accessor(0) == np.eye(3)).all()
    assert glb.view(0) == b"x" * size


def test_numbers_that_json_cannot_say_are_refused():
    with pytest.raises(ValueError, match="finite"):
        GlbFile().add_vectors(np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(ValueError, match="JSON"):
        GlbFile().to_bytes({"extras": float("nan")})


def test_trimesh_reads_the_same_geometry_and_texels(avatar):
    import trimesh

    scene = trimesh.load(io.BytesIO(glb_bytes(avatar)), file_type="glb", process=False)
    (mesh,) = scene.geometry.values()
    assert (mesh.vertices[mesh.faces] == corners(avatar)[0].astype(np.float32)).all()
    # trimesh turns v back to a bottom-left origin; twice 1 - v in float32 rounds once.
    assert mesh.visual.uv[mesh.faces] == pytest.approx(corners(avatar)[1], abs=1e-7)
    material = mesh.visual.material
    assert (np.array(material.baseColorTexture) == encode_srgb(avatar.textures.diffuse)).all()
    assert material.metallicFactor == 0.0
    assert material.roughnessFactor == avatar.roughness


VALIDATOR = """
const fs = require("fs"), validator = require("gltf-validator");
(async () => { const said = [];
  for (const path of process.argv.slice(1)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)));
    said.push(report.issues.messages.map(m => [m.code, m.pointer])); }
  console.log(JSON.stringify(said)); })();
"""
CHOICES = [
    ExportConfig(form, quantise, quality)
    for form in ("color", "factor")
    for quantise in (False, True)
    for quality in (None, 90)
]


def test_khronos_validator_has_nothing_to_say(flat_avatar, tmp_path):
    node = shutil.which("node")
    modules = os.environ.get("SIRA_GLTF_VALIDATOR", "")
    if not node or not (Path(modules) / "gltf-validator").is_dir():
        pytest.skip("needs node, and SIRA_GLTF_VALIDATOR naming a node_modules folder with gltf-validator")
    avatars = [avatar_of(shaded_maps()), avatar_of(smooth_maps()), flat_avatar]
    paths = []
    for k, (avatar, config) in enumerate(itertools.product(avatars, CHOICES)):
        paths.append(tmp_path / f"{k}.glb")
        write_glb(avatar, paths[-1], config)
    run = subprocess.run(
        [node, "-e", VALIDATOR, *map(str, paths)],
        env={**os.environ, "NODE_PATH": modules},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout)
    # The one remark, of the lowest kind but one: without a picture nothing in the file uses the UVs; textures/ does.
    unused = [["UNUSED_OBJECT", "/meshes/0/primitives/0/attributes/TEXCOORD_0"]]
    assert said == [[]] * 2 * len(CHOICES) + [unused] * len(CHOICES)


def test_extras_carry_the_portraits_camera():
    lens = np.array([[700.25, 0.0, 251.5], [0.0, 690.0, 260.125], [0.0, 0.0, 1.0]])
    pose = np.eye(4)
    pose[:3, 3] = [0.1, -0.2, 0.7]
    camera = Camera(lens, pose, 512, 480)
    extras = read_glb(glb_bytes(dataclasses.replace(avatar_of(smooth_maps()), camera=camera))).document["scenes"][0]
    said = extras["extras"]["camera"]
    # JSON holds every digit of a double.
    assert (np.array(said["intrinsics"]) == camera.intrinsics).all()
    assert (np.array(said["world_from_camera"]) == camera.world_from_camera).all()
    assert (said["width"], said["height"]) == (512, 480)
