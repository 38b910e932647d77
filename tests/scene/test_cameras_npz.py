"""IDR's cameras.npz: decomposition against known cameras, and its traps."""

import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_on_disk import make_camera
from scipy.spatial.transform import Rotation

from sira_assets.errors import InputError
from sira_assets.scene.cameras_npz import decompose_projection
from sira_assets.scene.canonical import CANONICAL_LANDMARKS_M
from sira_assets.scene.image import write_png
from sira_assets.scene.read_scene import read_frames, read_scene


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), sign=st.sampled_from([-1.0, 1.0]), log_scale=st.floats(-6, 6))
def test_decomposition_recovers_camera_at_any_scale_and_sign(seed, sign, log_scale):
    rng = np.random.default_rng(seed)
    k = np.array(
        [[rng.uniform(50, 5000), rng.normal(), rng.uniform(0, 900)], [0, rng.uniform(50, 5000), 400], [0, 0, 1]]
    )
    rotation, t = Rotation.random(random_state=seed % 2**31).as_matrix(), rng.normal(size=3) * 3
    found_k, pose = decompose_projection(sign * 10**log_scale * k @ np.column_stack([rotation, t]))
    # Rounding of an RQ factorisation, relative to entries of up to 5000.
    assert np.abs(found_k - k).max() < 1e-8
    assert np.abs(pose[:3, :3] - rotation.T).max() < 1e-10
    assert np.abs(pose[:3, 3] + rotation.T @ t).max() < 1e-9


def write_scene(folder, views=2, scale=0.25, **extra):
    """A head in a world of which one normalised unit is `scale` original ones."""
    cameras = [make_camera(yaw=0.1 * i) for i in range(views)]
    arrays = {}
    for i, camera in enumerate(cameras):
        world = np.eye(4)
        k = camera.intrinsics.copy()
        k[:2, 2] -= 0.5  # pixel centres at integers there
        world[:3] = k @ camera.camera_from_world[:3]
        arrays[f"world_mat_{i}"], arrays[f"scale_mat_{i}"] = world.astype(np.float32), np.diag([scale] * 3 + [1.0])
        arrays[f"world_mat_inv_{i}"] = np.linalg.inv(world)
        for kind, pixels in (("image", np.full((64, 48, 3), 99, np.uint8)), ("mask", np.ones((64, 48), bool))):
            write_png(folder / kind / f"{i:03d}.png", pixels)
    np.savez(folder / "cameras.npz", **{**arrays, **extra})
    return cameras


def test_views_and_poses_in_the_normalised_world(tmp_path):
    cameras = write_scene(tmp_path)
    frames = read_frames(tmp_path)
    assert [f.image_path.name for f in frames] == ["000.png", "001.png"]
    for frame, camera in zip(frames, cameras, strict=True):
        assert frame.camera.intrinsics == pytest.approx(camera.intrinsics, abs=1e-3)  # float32 matrices
        assert frame.camera.centre_world == pytest.approx(camera.centre_world / 0.25, abs=1e-4)


def test_landmarks_beside_it_place_the_head_and_give_the_unit(tmp_path):
    import json

    write_scene(tmp_path)
    with pytest.raises(InputError, match="--landmarks"):
        read_scene(tmp_path)
    points = {name: (np.array(point) / 0.25).tolist() for name, point in CANONICAL_LANDMARKS_M.items()}
    (tmp_path / "landmarks.json").write_text(json.dumps({"landmarks_m": points}))
    portrait = read_scene(tmp_path)
    assert portrait.canonical_from_world == pytest.approx(np.diag([0.25, 0.25, 0.25, 1.0]), abs=1e-9)
    assert portrait.metres_per_unit == pytest.approx(0.25)
    assert any("metres_per_unit" in line for line in portrait.warnings)


def test_pickles_bombs_and_damage_are_refused(tmp_path):
    write_scene(tmp_path, world_mat_0=np.array([{"a": 1}], object))
    with pytest.raises(InputError, match="4x4 matrices"):
        read_frames(tmp_path)
    # A header that claims 7 TiB: seen before anything is allocated.
    header = (
        b"\x93NUMPY\x01\x00v\x00"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }".ljust(118)
    )
    with zipfile.ZipFile(tmp_path / "cameras.npz", "w") as archive:
        archive.writestr("world_mat_0.npy", header)
    with pytest.raises(InputError, match=r"1000000, 1000000"):
        read_frames(tmp_path)
    (tmp_path / "cameras.npz").write_bytes(b"PK\x03\x04 not a zip")
    with pytest.raises(InputError, match=r"whole \.npz"):
        read_frames(tmp_path)


def test_another_number_of_pictures_and_singular_matrices(tmp_path):
    write_scene(tmp_path)
    (tmp_path / "image" / "001.png").unlink()
    with pytest.raises(InputError, match="2 cameras, 1 pictures"):
        read_frames(tmp_path)
    with pytest.raises(InputError, match="invertible"):
        decompose_projection(np.zeros((3, 4)))
    with pytest.raises(InputError, match="invertible"):
        decompose_projection(np.full((3, 4), np.nan))
