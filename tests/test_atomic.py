"""Nothing is half-written: on an error, on a full disk, in a folder that may not be written to."""

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from sira_assets import atomic
from sira_assets.atomic import check_file, replacing, replacing_folder, write_bytes
from sira_assets.errors import InputError

ROOT = Path(__file__).resolve().parents[1]


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path):
    write_bytes(tmp_path / "a.bin", b"old")
    with pytest.raises(ZeroDivisionError), replacing(tmp_path / "a.bin") as temporary:  # noqa: PT012
        temporary.write_bytes(b"half of the n")
        raise ZeroDivisionError
    assert (tmp_path / "a.bin").read_bytes() == b"old"
    assert names(tmp_path) == ["a.bin"]


def test_a_writers_own_error_for_a_full_disk_becomes_an_os_error(tmp_path):
    said = f"Failed to write pixel data. {os.strerror(errno.ENOSPC)}."
    with pytest.raises(OSError, match=r"a\.bin") as caught, replacing(tmp_path / "a.bin"):
        raise RuntimeError(said)
    assert caught.value.errno == errno.ENOSPC
    assert isinstance(caught.value.__cause__, RuntimeError)
    with pytest.raises(RuntimeError, match="else"), replacing(tmp_path / "a.bin"):
        raise RuntimeError("something else")
    assert names(tmp_path) == []


@pytest.mark.parametrize("exchange", [True, False], ids=["exchanged", "moved aside"])
def test_a_folder_takes_the_name_whole(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(atomic, "_exchanged", lambda one, other: False)
    for version in ("first", "second"):
        with replacing_folder(tmp_path / "out") as fresh:
            (fresh / version).write_text(version)
            if version == "second":
                assert names(tmp_path / "out") == ["first"]
        assert names(tmp_path / "out") == [version]
        assert names(tmp_path) == ["out"]
    with pytest.raises(ZeroDivisionError), replacing_folder(tmp_path / "out") as fresh:  # noqa: PT012
        (fresh / "third").write_text("half")
        raise ZeroDivisionError
    assert names(tmp_path / "out") == ["second"]
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("failing", ["out", "was"])
def test_a_folder_that_cannot_be_moved_stays_and_leaves_no_trace(tmp_path, monkeypatch, failing):
    with replacing_folder(tmp_path / "out") as fresh:
        (fresh / "old").touch()
    monkeypatch.setattr(atomic, "_exchanged", lambda one, other: False)
    replace, failed = os.replace, []

    def busy(source, target):
        if Path(target).name == failing and not failed:
            failed.append(target)
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        replace(source, target)

    monkeypatch.setattr(atomic.os, "replace", busy)
    with pytest.raises(OSError, match=os.strerror(errno.EBUSY)), replacing_folder(tmp_path / "out") as fresh:
        (fresh / "new").touch()
    assert failed
    assert names(tmp_path / "out") == ["old"]
    assert names(tmp_path) == ["out"]


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="needs links")
@pytest.mark.parametrize("there", [True, False])
def test_a_link_to_a_folder_is_followed(tmp_path, there):
    (tmp_path / "link").symlink_to("real", target_is_directory=True)
    if there:
        (tmp_path / "real").mkdir()
    with replacing_folder(tmp_path / "link") as fresh:
        (fresh / "new").touch()
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "real") == ["new"]
    assert names(tmp_path) == ["link", "real"]


def test_files_that_cannot_be_written_are_refused_beforehand(tmp_path):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    check_file(tmp_path / "new" / "deeper" / "a.bin", overwrite=False)
    check_file(taken, overwrite=True)
    for path, said in ((taken, "--overwrite"), (taken / "a.bin", "a file"), (tmp_path, "a folder")):
        with pytest.raises(InputError, match=f"received.*{said}"):
            check_file(path, overwrite=path != taken)
    assert names(tmp_path) == ["taken"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="renameat2 is Linux's")
def test_two_names_are_exchanged_in_one_step(tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    (one / "a").touch()
    if not atomic._exchanged(one, other):
        pytest.skip("this file system cannot exchange names")
    assert (names(one), names(other)) == ([], ["a"])
    assert not atomic._exchanged(one, tmp_path / "none")


READ_ONLY = """
import os, sys
from pathlib import Path
sys.path.insert(0, {tools!r})
import _cli
from sira_assets.atomic import write_bytes
if os.geteuid() == 0:
    os.seteuid(65534)  # root may write anywhere
sys.exit(_cli.run(lambda: write_bytes(Path({folder!r}) / "a.bin", b"new")))
"""


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="needs POSIX permissions")
def test_a_read_only_folder_is_one_line_and_exit_3():
    # Not under pytest's own folder, which another user may not enter.
    with tempfile.TemporaryDirectory() as root:
        Path(root).chmod(0o755)
        folder = Path(root) / "out"
        write_bytes(folder / "a.bin", b"old")
        folder.chmod(0o555)
        code = READ_ONLY.format(tools=str(ROOT / "tools"), folder=str(folder))
        run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
        folder.chmod(0o755)
        assert run.returncode == 3, run.stderr
        assert run.stderr.strip().splitlines() == [run.stderr.strip()]
        assert os.strerror(errno.EACCES) in run.stderr
        assert (folder / "a.bin").read_bytes() == b"old"
        assert names(folder) == ["a.bin"]
