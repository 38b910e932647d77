"""Shared fixtures. Real heads are found through SIRA_TEST_DATA; without them those tests skip, with the reason."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real heads and scenes that CONTRIBUTING describes."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SIRA_TEST_DATA", default))
    if not (folder / "scenes").is_dir():
        pytest.skip(f"no real heads at {folder}; set SIRA_TEST_DATA")
    return folder
