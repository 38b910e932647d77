"""Errors say one line, and survive the way back from a worker process."""

import errno
import os
import pickle
import sys
from pathlib import Path

import pytest

from sira_assets.errors import InputError, MissingExtraError

sys.path.append(str(Path(__file__).resolve().parents[1] / "tools"))
import _cli


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


@pytest.mark.parametrize("code", ["ENOTDIR", "EEXIST", "EISDIR", "EBUSY", "ENAMETOOLONG"])
def test_a_path_that_is_something_else_is_one_line_and_exit_3(code, capsys):
    said = os.strerror(getattr(errno, code))

    def body():
        raise OSError(getattr(errno, code), said, "out")

    assert _cli.run(body) == 3
    assert capsys.readouterr().err == f"error: cannot write or read out: {said}\n"


def test_a_broken_machine_is_no_mistake_of_the_users():
    def body():
        raise OSError(errno.EIO, os.strerror(errno.EIO), "out")

    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        _cli.run(body)
