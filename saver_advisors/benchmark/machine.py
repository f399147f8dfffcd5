"""What every measurement needs: cores, clock, load, progress."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median


def timed(work: Callable[[], object]) -> float:
    """Do some work once and return its duration (s)."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def median_ratio(numerators: list[float], denominators: list[float]) -> float:
    """Median of the rounds' ratios: a round's disturbance weighs on both parts alike."""
    return median(a / b for a, b in zip(numerators, denominators, strict=True))


@contextmanager
def cores(count: int) -> Iterator[None]:
    """Keep this thread, and what it starts, on the first ``count`` of the cores it may use."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(allowed)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[], None]]:
    """A progress bar; yields what moves it on by one."""
    from tqdm import tqdm

    with tqdm(total=total, desc=what, unit="round", dynamic_ncols=True) as bar:

        def advance() -> None:
            bar.update()

        yield advance
