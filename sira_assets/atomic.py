"""Nothing is ever half-written: write beside the target, flush to disk, then rename over it.

`os.replace` is atomic within one file system, so a reader sees the old file, the new one, or none. Linux can also
exchange two names at once (renameat2), so that a folder's name never stands empty; elsewhere there is such a moment.
`check_file` and `check_parent` refuse, before any work, what could not be written after it.
"""

import contextlib
import ctypes
import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from sira_assets.errors import InputError

# <fcntl.h>'s "relative to the current folder" and <linux/fs.h>'s RENAME_EXCHANGE.
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
# What a disk says when it takes no more.
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)


@contextlib.contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Give a temporary path in `path`'s folder; on success it replaces `path`, on any error it is removed.

    The temporary name keeps `path`'s suffix, since many writers choose their format by it.

    Raises
    ------
    OSError : the disk takes no more, whatever the writer's own kind of error for that.

    Examples
    --------
    >>> with replacing("mesh.ply") as temporary:      # doctest: +SKIP
    ...     mesh.export(temporary)
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        # mkstemp makes files private; give what the user's umask would have given.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        os.replace(temporary, path)
    except Exception as error:
        # Writers in other languages (OpenEXR, USD, safetensors) say it by errors of their own.
        said = [code for code in DISK_ERRORS if os.strerror(code) in str(error)]
        if said and not isinstance(error, OSError):
            raise OSError(said[0], os.strerror(said[0]), str(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing_folder(folder: str | os.PathLike) -> Iterator[Path]:
    """Give a fresh folder beside `folder`; on success it takes that name, on any error it is removed.

    What stood there is deleted last: the two exchange names in one step where the system can (Linux), else what stood
    there is moved aside first, and put back if the second move fails. A link is followed to the folder it names.
    """
    folder = Path(folder).resolve()
    folder.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield fresh
        umask = os.umask(0)
        os.umask(umask)
        fresh.chmod(0o777 & ~umask)
        if not folder.exists():
            os.replace(fresh, folder)
            return
        if not _exchanged(fresh, folder):
            _moved_over(fresh, folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _moved_over(fresh: Path, folder: Path) -> None:
    """Move `folder` aside and `fresh` in its place; on an error what stood there is put back."""
    old = Path(tempfile.mkdtemp(prefix=f".{folder.name}-old-", dir=folder.parent))
    try:
        os.replace(folder, old / "was")
        try:
            os.replace(fresh, folder)
        except BaseException:
            os.replace(old / "was", folder)
            raise
    except BaseException:
        # Only if it is empty: where even putting back failed, this is all that is left of what stood there.
        with contextlib.suppress(OSError):
            old.rmdir()
        raise
    shutil.rmtree(old, ignore_errors=True)


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two names atomically; False where the system or the file system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0


def check_file(path: str | os.PathLike, *, overwrite: bool) -> None:
    """Refuse, before any work, a file that cannot be written or was not said to go.

    Raises
    ------
    InputError : a folder of that name, a file without `overwrite`, or as `check_parent`.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(expected=f"a file at {path}", received="a folder", remedy="choose another --out")
    if path.exists() and not overwrite:
        raise InputError(
            expected=f"no file yet at {path}", received="one", remedy="choose another name, or say --overwrite"
        )
    check_parent(path)


def check_parent(path: str | os.PathLike) -> None:
    """Refuse a path that nothing can be written at, for what it would stand in.

    Raises
    ------
    InputError : the nearest thing above it is a file, or a folder that may not be written to.
    """
    above = Path(path).parent.resolve()
    parent = next(p for p in (above, *above.parents) if p.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise InputError(
            expected=f"a folder to write in at {parent}",
            received="a read-only one" if parent.is_dir() else "a file",
            remedy="choose another --out",
        )


def write_bytes(path: str | os.PathLike, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | os.PathLike, text: str) -> None:
    """Write `text` (UTF-8) to `path`, whole or not at all."""
    write_bytes(path, text.encode())
