"""Errors say one line, and survive the way back from a worker process."""

import pickle

import pytest

from sira_assets.errors import InputError, MissingExtraError


@pytest.mark.parametrize(
    "error",
    [InputError(expected="a", received="b\nc", remedy="d"), MissingExtraError("dask", "cluster")],
    ids=["input", "extra"],
)
def test_an_error_comes_back_as_it_was_raised(error):
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is type(error)
    assert str(back) == str(error)
    assert vars(back) == vars(error)
    assert "\n" not in str(error)
