"""Limit the number of threads that linear algebra uses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from saver_envs.validation import require


@contextmanager
def threads_of_algebra(threads: int) -> Iterator[None]:
    """Let torch use this many threads, and NumPy's BLAS, whose matrices are small, one.

    :param threads: threads of torch.
    :raises ValueError: for less than one.
    """
    require("threads", threads, threads >= 1, "at least 1")
    import torch
    from threadpoolctl import threadpool_limits

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)


one_thread_of_algebra = partial(threads_of_algebra, 1)
"""Let torch and NumPy's BLAS use one thread, in a context or, with ``@``, in a function.

Networks as small as these gain little from a second thread, and waiting for it takes a core from
the simulator or from another run.
"""
