"""Distances, rewards and success as functions of achieved and desired goals alone.

All functions are pure and vectorised over leading dimensions. A goal holds three coordinates (m)
per arm, in that arm's base frame; the distance-constrained task appends the distance (m).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]


def object_distances(achieved: FloatArray, desired: FloatArray, n_arms: int) -> FloatArray:
    """Return each object's distance to its target.

    :param achieved: (..., at least 3 * n_arms), metres.
    :param desired: (..., at least 3 * n_arms), metres.
    :param n_arms: number of objects.
    :return: (..., n_arms), metres.
    """
    difference = (achieved - desired)[..., : 3 * n_arms]
    blocks = difference.reshape(*difference.shape[:-1], n_arms, 3)
    return np.sqrt((blocks * blocks).sum(axis=-1))


def goal_reached(
    achieved: FloatArray, desired: FloatArray, n_arms: int, threshold: float
) -> NDArray[np.bool_]:
    """Say where every object is within ``threshold`` metres of its own target, shape (...)."""
    near = object_distances(achieved, desired, n_arms) <= threshold
    return np.logical_and.reduce(near, axis=-1)


def constraint_met(
    achieved: FloatArray, desired: FloatArray, tolerance: float
) -> NDArray[np.bool_]:
    """Say where the last entries, distances (m), differ by at most ``tolerance`` (eq. 6.3)."""
    return np.abs(achieved[..., -1] - desired[..., -1]) <= tolerance
