"""A small scene on disk, made afresh for each test that spoils it."""

import pytest
from scene_on_disk import SceneOnDisk


@pytest.fixture
def scene(tmp_path):
    return SceneOnDisk(tmp_path)
