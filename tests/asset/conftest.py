"""The sample avatars as fixtures."""

import pytest
from sample_avatar import avatar_of, flat_maps, smooth_maps

from sira_assets.asset.avatar import Avatar


@pytest.fixture(scope="session")
def avatar() -> Avatar:
    return avatar_of(smooth_maps())


@pytest.fixture(scope="session")
def flat_avatar() -> Avatar:
    return avatar_of(flat_maps())
