"""How many threads linear algebra takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def threads_of_algebra(threads: int) -> Iterator[None]:
    """So many threads for torch, and one for NumPy's BLAS, whose matrices are small.

    :param threads: for torch
    :raises ValueError: for less than one
    """
    if threads < 1:
        raise ValueError(f"threads={threads!r} must be at least 1")
    import torch
    from threadpoolctl import threadpool_limits

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def one_thread_of_algebra() -> Iterator[None]:
    """One thread for torch and for NumPy's BLAS; a context, or with ``@`` a whole function.

    For networks as small as these a second thread gains little, and waiting for it takes a core
    from the simulator or from the run beside this one.
    """
    with threads_of_algebra(1):
        yield
