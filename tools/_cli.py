"""What every command line here shares: how an error becomes an exit status.

A tool is a script, so Python puts this folder first on the path and `from _cli import run` finds this file.

Exit status: 0 done; 1 an unexpected failure (with its traceback); 2 wrong usage (argparse's own); 3 the input cannot be
used, one line on stderr says why and what to do; 130 interrupted.
"""

import errno
import sys
from collections.abc import Callable

# What a path of the user's may be instead of what it was taken for.
PATH_ERRORS = (
    errno.EACCES,
    errno.EPERM,
    errno.ENOTDIR,
    errno.EEXIST,
    errno.EISDIR,
    errno.EBUSY,
    errno.ENAMETOOLONG,
)


def device(name: str) -> str:
    """ "cpu" or "cuda" for auto, cpu or cuda.

    Raises
    ------
    InputError : "cuda" where torch finds none.
    """
    import torch

    from sira_assets.errors import InputError

    if name == "cuda" and not torch.cuda.is_available():
        raise InputError(expected="a CUDA device", received="none that torch finds", remedy="say --device cpu or auto")
    return name if name != "auto" else "cuda" if torch.cuda.is_available() else "cpu"


def run(body: Callable[[], int | None]) -> int:
    """Run a tool's body and give its exit status.

    Parameters
    ----------
    body : called without arguments; None counts as 0.

    Returns
    -------
    0, 3 or 130 as above, or what `body` returned. Any other exception passes through with its traceback: it is a
    defect, not the user's mistake.
    """
    from sira_assets.atomic import DISK_ERRORS
    from sira_assets.errors import InputError, MissingExtraError

    try:
        return int(body() or 0)
    except (InputError, MissingExtraError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 3
    except FileNotFoundError as error:
        # Readers say more where they can; this catches a path that vanished or was mistyped on the way.
        print(f"error: no such file: {error.filename or error}", file=sys.stderr)
        return 3
    except OSError as error:
        if error.errno not in (*DISK_ERRORS, *PATH_ERRORS):
            raise
        print(f"error: cannot write or read {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
