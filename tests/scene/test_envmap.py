"""The lat-long map: its axes, its measure, and the energy of gaussians on it."""

import numpy as np
import pytest

from sira_assets.errors import InputError
from sira_assets.scene.envmap import EnvironmentMap, envmap_from_sg, lat_long_directions, read_envmap, write_envmap
from sira_assets.scene.exr import write_exr
from sira_assets.scene.hdr import write_hdr
from sira_assets.scene.sg_light import SGLight


def blank(height):
    return EnvironmentMap(np.zeros((height, 2 * height, 3), np.float32))


def test_axes_stand_where_openexr_puts_them():
    d = lat_long_directions(512)
    # Directions at the four columns and two rows named in the notation; half a pixel is 3e-3 radians.
    for row, column, axis in [
        (256, 512, [0, 0, 1]),
        (256, 256, [1, 0, 0]),
        (256, 768, [-1, 0, 0]),
        (256, 0, [0, 0, -1]),
        (0, 0, [0, 1, 0]),
        (511, 0, [0, -1, 0]),
    ]:
        assert np.abs(d[row, column] - axis).max() < 5e-3


@pytest.mark.parametrize("height", [1, 2, 7, 64])
def test_solid_angles_cover_the_sphere(height):
    env = blank(height)
    # Exact bands: only rounding is left.
    assert env.solid_angles().sum() == pytest.approx(4 * np.pi, rel=1e-12)
    assert np.abs(np.linalg.norm(env.directions(), axis=-1) - 1).max() < 1e-12


def test_odd_moments_vanish():
    env = blank(32)
    assert np.abs((env.directions() * env.solid_angles()[..., None]).sum((0, 1))).max() < 1e-12


@pytest.mark.parametrize("sharpness", [1e-6, 0.3, 5.0, 100.0, 1e4, 1e8])
def test_energy_of_a_lobe_is_exact_at_any_sharpness(sharpness):
    axis = np.array([0.3, -0.8, 0.5])
    light = SGLight(axis, sharpness, [1.0, 2.0, 3.0])
    env = envmap_from_sg(light, 64)
    expected = -2 * np.pi * np.expm1(-2 * sharpness) / sharpness * light.amplitude[0]
    measured = (env.radiance * env.solid_angles()[..., None]).sum((0, 1))
    assert measured == pytest.approx(expected, rel=1e-5)  # float32 pixels
    # Seen from afar it points where the lobe points: to a pixel (3 degrees) once it is narrow.
    if sharpness > 10:
        mean = (env.radiance[..., :1] * env.solid_angles()[..., None] * env.directions()).sum((0, 1))
        assert mean @ light.axis[0] / np.linalg.norm(mean) > np.cos(np.radians(2.8))


def test_wide_lobes_are_sampled_unchanged():
    light = SGLight([[0, 0, 1], [1, 1, 0]], [4.0, 30.0], [[1, 1, 1], [0.5, 1, 2]])
    env = envmap_from_sg(light, 128)
    exact = light.radiance(env.directions())
    # The energy factor of the sharper lobe, 8 pixels wide, is within 1e-3 of one.
    assert np.abs(env.radiance - exact).max() < 1e-3 * exact.max()


def test_round_trip_and_refusals(tmp_path):
    env = envmap_from_sg(SGLight([0, 1, 0], 50.0, [1e5, 2, 3]), 16)
    write_envmap(tmp_path / "envmap.exr", env)
    # 1e5 is beyond half floats: the file is float32.
    assert np.array_equal(read_envmap(tmp_path / "envmap.exr").radiance, env.radiance)
    with pytest.raises(InputError, match="2H"):
        EnvironmentMap(np.zeros((4, 4, 3)))
    with pytest.raises(InputError, match="NaN"):
        EnvironmentMap(np.full((4, 8, 3), np.nan))
    with pytest.raises(InputError, match="row"):
        envmap_from_sg(SGLight([0, 1, 0], 50.0, [1, 1, 1]), 0)


def test_radiance_files_hold_maps_too(tmp_path):
    env = envmap_from_sg(SGLight([0, 1, 0], 50.0, [1e5, 2, 3]), 16)
    write_envmap(tmp_path / "envmap.HDR", env)
    assert (tmp_path / "envmap.HDR").read_bytes().startswith(b"#?RADIANCE")
    back = read_envmap(tmp_path / "envmap.HDR").radiance
    # RGBE shares one exponent: within 1/256 of the pixel's largest channel.
    assert (np.abs(back - env.radiance) <= env.radiance.max(-1, keepdims=True) / 256 * (1 + 1e-6)).all()


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_other_shapes_and_other_files_are_refused(tmp_path, suffix):
    path = tmp_path / f"square{suffix}"
    (write_exr if suffix == ".exr" else write_hdr)(path, np.ones((8, 8, 3), np.float32))
    with pytest.raises(InputError, match=r"twice as wide.*square.*8x8.*equirectangular"):
        read_envmap(path)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(InputError, match="whole"):
        read_envmap(path)
    path.write_bytes(b"\xff\xd8\xff\xe0" + bytes(100))
    with pytest.raises(InputError, match="8-bit"):
        read_envmap(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match="empty"):
        read_envmap(path)


def test_agrees_with_the_real_scenes_own_map(real_data):
    import json

    scene = real_data / "scenes" / "james_soft" / "gt"
    light = SGLight.from_dict(json.loads((scene / "lights.json").read_text()))
    theirs = read_envmap(scene / "envmap.exr").radiance
    ours = envmap_from_sg(light, theirs.shape[0]).radiance
    assert np.abs(ours - theirs).max() < 1e-3 * theirs.max()  # half floats there
