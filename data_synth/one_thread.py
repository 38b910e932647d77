"""Numerical libraries on one thread: they round differently with other numbers of threads, and the same seed must give
the same bytes wherever a head is built.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Hold the numerical libraries that are loaded by then, torch among them, to one thread while `function` runs."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with _torch_on_one_thread(), threadpool_limits(1):
            return function(*args, **kwargs)

    return limited


@contextmanager
def _torch_on_one_thread() -> Iterator[None]:
    """Its own setting reaches the MKL inside it, which threadpoolctl does not see."""
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
