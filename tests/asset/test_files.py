import dataclasses
import json

import numpy as np
import pytest
from PIL import Image
from sample_avatar import WORLD_FROM_CANONICAL, sphere

from sira_assets.asset.avatar import Avatar
from sira_assets.asset.encoding import decode_ks, decode_normal, decode_srgb
from sira_assets.asset.lights import MAX_HEIGHT, MIN_HEIGHT, envmap_height, write_lights
from sira_assets.asset.obj import write_obj
from sira_assets.asset.textures import irradiance_white, write_textures
from sira_assets.asset.write_avatar import write_avatar
from sira_assets.errors import InputError
from sira_assets.scene.exr import read_exr
from sira_assets.scene.sg_light import SGLight


def test_textures_hold_what_their_metadata_says(avatar, tmp_path):
    maps, files = avatar.textures, write_textures(avatar.textures, tmp_path / "textures")
    texels = {}
    for path in (files.diffuse, files.specular, files.normal, files.irradiance):
        with Image.open(path) as image:
            assert image.text["Description"]
            texels[path.stem] = np.array(image)
    # Half a step of sRGB at its steepest (2.4 / 1.055 / 510), of ks's range, and of eight-bit normals (0.4 degrees).
    assert decode_srgb(texels["diffuse"]) == pytest.approx(maps.diffuse, abs=0.0045)
    assert decode_ks(texels["specular"]) == pytest.approx(maps.specular_f0, abs=0.04 / 255 + 1e-7)
    assert (decode_normal(texels["normal"]) * maps.normal_tangent).sum(-1).min() > np.cos(np.radians(0.4))
    white = irradiance_white(maps)
    assert decode_srgb(texels["irradiance"]) * white == pytest.approx(
        np.minimum(maps.irradiance, white), abs=0.0045 * white
    )
    assert (read_exr(files.irradiance_exr) == maps.irradiance).all()
    assert (read_exr(files.specular_exr) == maps.specular_f0).all()
    assert (read_exr(files.normal_exr) == maps.normal_tangent).all()


def test_black_irradiance_is_written_as_black(flat_avatar, tmp_path):
    files = write_textures(flat_avatar.textures, tmp_path)
    with Image.open(files.irradiance) as image:
        assert np.array(image).max() == 0


def test_obj_keeps_welded_positions_and_bottom_left_uv(avatar, tmp_path):
    write_obj(avatar, tmp_path / "avatar.obj")
    rows = [line.split() for line in (tmp_path / "avatar.obj").read_text().splitlines()]
    v, vt, vn = (np.array([r[1:] for r in rows if r[0] == key], float) for key in ("v", "vt", "vn"))
    f = np.array([[c.split("/") for c in r[1:]] for r in rows if r[0] == "f"], int) - 1
    # Nine digits name a float32.
    assert (v.astype(np.float32) == avatar.mesh.vertices.astype(np.float32)).all()
    assert (vt.astype(np.float32) == avatar.atlas.uv.astype(np.float32)).all()
    # Six digits.
    assert vn == pytest.approx(avatar.mesh.normals, abs=1e-6)
    assert (f[..., 0] == avatar.mesh.faces).all()
    assert (f[..., 1] == avatar.atlas.faces_uv).all()
    assert (f[..., 2] == avatar.mesh.faces).all()


def test_material_names_agree_and_its_maps_exist(avatar, tmp_path):
    write_avatar(avatar, tmp_path)
    obj, mtl = ((tmp_path / f"avatar.{kind}").read_text() for kind in ("obj", "mtl"))
    assert "mtllib avatar.mtl\n" in obj
    named = [line.split(maxsplit=1)[1] for line in mtl.splitlines() if line.startswith("newmtl")]
    assert named == [line.split(maxsplit=1)[1] for line in obj.splitlines() if line.startswith("usemtl")]
    maps = [line.split()[-1] for line in mtl.splitlines() if line.startswith(("map_", "norm"))]
    assert len(maps) == 4
    assert all((tmp_path / name).is_file() for name in maps)
    assert not list(tmp_path.rglob(".*")), "temporary files are left"


def test_trimesh_reads_the_obj(avatar, tmp_path):
    import trimesh

    write_avatar(avatar, tmp_path)
    mesh = trimesh.load(tmp_path / "avatar.obj", process=False, maintain_order=True)
    assert mesh.vertices[mesh.faces] == pytest.approx(avatar.mesh.vertices[avatar.mesh.faces], rel=1e-7)
    with Image.open(tmp_path / "textures" / "diffuse.png") as image:
        assert (np.array(mesh.visual.material.image) == np.array(image)).all()


def test_lights_are_read_back_and_the_map_holds_their_energy(avatar, tmp_path):
    light = avatar.light
    write_lights(light, tmp_path)
    read = SGLight.from_dict(json.loads((tmp_path / "lights.json").read_text()))
    assert read.axis == pytest.approx(light.axis, abs=1e-15)
    assert (read.sharpness == light.sharpness).all()
    assert (read.amplitude == light.amplitude).all()
    radiance = read_exr(tmp_path / "envmap.exr")
    height = len(radiance)
    assert radiance.shape == (height, 2 * height, 3)
    theta = (np.arange(height) + 0.5) * np.pi / height
    total = (radiance.astype(np.float64) * np.sin(theta)[:, None, None]).sum((0, 1)) * (np.pi / height) ** 2
    exact = (2 * np.pi * light.amplitude * (-np.expm1(-2 * light.sharpness) / light.sharpness)[:, None]).sum(0)
    # The midpoint rule errs by (pi/height)^2 lambda / 24 or so: 0.4 % at 64 rows and lambda = 40.
    assert total == pytest.approx(exact, rel=0.005)


def test_the_map_is_as_fine_as_the_sharpest_lobe_asks():
    def one(sharpness):
        return SGLight([[0, 0, 1]], [sharpness], [[1, 1, 1]])

    assert envmap_height(SGLight(np.zeros((0, 3)), [], np.zeros((0, 3)))) == MIN_HEIGHT
    assert envmap_height(one(1e-6)) == MIN_HEIGHT
    assert envmap_height(one(1e9)) == MAX_HEIGHT
    for sharpness in (100.0, 1000.0, 10_000.0):
        assert np.sqrt(2 / sharpness) >= 2 * np.pi / envmap_height(one(sharpness))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"roughness": 0.0}, "roughness"),
        ({"roughness": float("nan")}, "roughness"),
        ({"metres_per_unit": -1.0}, "metres_per_unit"),
        ({"mesh": dataclasses.replace(sphere()[0], faces=np.zeros((0, 3)))}, "triangles"),
        ({"mesh": sphere(6, 8)[0]}, "atlas"),
    ],
)
def test_what_cannot_be_an_avatar_is_refused(avatar, change, said):
    with pytest.raises(InputError, match=said):
        dataclasses.replace(avatar, **change)


def test_positions_are_those_of_the_scene(avatar):
    assert isinstance(avatar, Avatar)
    centre = avatar.mesh.vertices.mean(0)
    # The sphere's centre is the canonical origin.
    assert centre == pytest.approx(WORLD_FROM_CANONICAL[:3, 3], abs=1e-12)
