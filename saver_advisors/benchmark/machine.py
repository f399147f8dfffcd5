"""Helpers of measurements: clock, cores, ratios, progress bars."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from statistics import median
from typing import Any


def timed(work: Callable[[], object]) -> float:
    """Return the duration (s) of one call."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def time_of_all(
    work: Callable[[Any], object],
    items: Iterable[Any],
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Return the duration (s) of calls with each of the items, by a clock."""
    began = clock()
    for item in items:
        work(item)
    return clock() - began


def median_ratio(numerators: list[float], denominators: list[float]) -> float:
    """Return the median of the rounds' ratios: a disturbance of a round affects both parts."""
    return median(a / b for a, b in zip(numerators, denominators, strict=True))


@contextmanager
def cores(count: int) -> Iterator[None]:
    """Restrict this thread, and those that it starts, to the first ``count`` available cores."""
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
    """Show a progress bar; yields a function that advances it by one."""
    from tqdm import tqdm

    with tqdm(total=total, desc=what, unit="round", dynamic_ncols=True) as bar:
        yield bar.update
