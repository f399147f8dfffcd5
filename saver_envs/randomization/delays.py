"""Delays of a whole number of actions, different in every episode."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def delay_line(n: int, longest: float, size: int) -> Array:
    """Return an empty line (n, longest + 1, size) of values that are on their way."""
    return np.zeros((n, int(longest) + 1, size))


def fill(line: Array, rows: NDArray[np.intp], values: Array) -> None:
    """Start anew: everything on the way is ``values`` (k, size)."""
    line[rows] = values[:, None]


def delayed(line: Array, rows: NDArray[np.intp], values: Array, delay: Array) -> Array:
    """Put values on the way and return those that arrive.

    :param line: from :func:`delay_line`; changed.
    :param rows: (k,) episodes.
    :param values: (k, size).
    :param delay: (n, 1) of every episode, whole numbers.
    :return: (k, size).
    """
    line[rows, 1:] = line[rows, :-1]
    line[rows, 0] = values
    arrived: Array = line[rows, delay[rows, 0].astype(np.intp)]
    return arrived
