"""How many threads linear algebra takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread_of_algebra() -> Iterator[None]:
    """One thread for torch and for NumPy's BLAS; a context, or with ``@`` a whole function.

    For networks as small as these a second thread gains little, and waiting for it takes a core
    from the simulator or from the run beside this one.
    """
    import torch
    from threadpoolctl import threadpool_limits

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)
