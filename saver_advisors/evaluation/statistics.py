"""Statistics over a few seeds: interquartile means, comparisons, and confidence intervals.

The estimators are those of Agarwal et al., Deep Reinforcement Learning at the Edge of the
Statistical Precipice (arXiv 2108.13264): the interquartile mean, the probability of improvement,
and percentile intervals from a bootstrap over the seeds of one task.

A single seed has no interval: its estimate has a value and n = 1. The interval of two seeds extends
from one to the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest, bootstrap, trim_mean

CONFIDENCE: Final = 0.95
RESAMPLES: Final = 10_000
BOOTSTRAP_SEED: Final = 0
"""Fixed, so that the same data give the same interval and generated pages do not change."""

QUARTER: Final = 0.25

WORST: Final = 0.1
"""Fraction of episodes whose mean cost is the CVaR of the cost."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A statistic over seeds.

    :param value: the statistic
    :param interval: its 95% interval; None for a single seed
    :param n: number of seeds; of two compared groups, that of the smaller one
    """

    value: float
    interval: tuple[float, float] | None
    n: int

    def excludes(self, value: float) -> bool:
        """Return whether there is an interval that does not contain ``value``."""
        return self.interval is not None and not self.interval[0] <= value <= self.interval[1]

    def text(self, digits: int = 2, scale: float = 1.0) -> str:
        """Format the estimate.

        :param digits: after the decimal point
        :param scale: factor of all numbers
        :return: such as ``0.95 [0.93, 0.97]``; the value alone without an interval
        """
        told = f"{scale * self.value:,.{digits}f}"
        if self.interval is None:
            return told
        low, high = (f"{scale * end:,.{digits}f}" for end in self.interval)
        return f"{told} [{low}, {high}]"

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON; ``ci95`` is None without an interval."""
        ends = None if self.interval is None else list(self.interval)
        return {"value": self.value, "ci95": ends, "n": self.n}


def success_interval(successes: int, episodes: int) -> tuple[float, float]:
    """Compute the 95% Wilson score interval of a success rate.

    :param successes: number of successful episodes
    :param episodes: number of episodes, at least 1
    :return: lower and upper end
    :raises ValueError: for more successes than episodes, or no episode
    """
    found = binomtest(successes, episodes).proportion_ci(CONFIDENCE, method="wilson")
    return float(found.low), float(found.high)


def worst_mean(costs: ArrayLike) -> float:
    """Compute the mean of the largest tenth of costs: their conditional value at risk (CVaR).

    :param costs: (episodes,); a tenth of them is rounded up to whole episodes
    :raises ValueError: for no episode, or values that are not finite
    """
    values = np.sort(_checked("costs", costs))
    return float(values[-math.ceil(WORST * len(values)) :].mean())


def estimate(values: ArrayLike) -> Estimate:
    """Compute the interquartile mean over seeds with its bootstrap interval.

    A quarter of the seeds, rounded down, is left out at each end: none of three or fewer.

    :param values: (seeds,)
    :return: the estimate
    :raises ValueError: for no seed, or values that are not finite
    """
    return _estimate(_iqm, values=values)


def difference(x: ArrayLike, y: ArrayLike) -> Estimate:
    """Compute the difference between two groups.

    :param x: seeds of one group
    :param y: those of the other group, for the same task
    :return: IQM(x) - IQM(y), without an interval if a group has a single seed
    :raises ValueError: as ``estimate``
    """
    return _estimate(lambda a, b: _iqm(a) - _iqm(b), x=x, y=y)


def ratio(x: ArrayLike, y: ArrayLike) -> Estimate:
    """Compute the ratio of two groups.

    :param x: seeds of one group, as for ``difference``
    :param y: those of the other group, above 0
    :return: IQM(x) / IQM(y)
    :raises ValueError: as ``difference``, or for a value of y that is not above 0
    """
    if (np.asarray(y) <= 0).any():
        raise ValueError(f"y={y!r} must be above 0: x is divided by it")
    return _estimate(lambda a, b: _iqm(a) / _iqm(b), x=x, y=y)


def probability_of_improvement(x: ArrayLike, y: ArrayLike) -> Estimate:
    """Compute the probability that a run of x is better than a run of y; ties count half.

    :param x: seeds of one group, as for ``difference``
    :param y: those of the other group
    :return: P(x > y) + P(x = y) / 2
    :raises ValueError: as ``difference``
    """
    return _estimate(_improvement, x=x, y=y)


def _improvement(x: Floats, y: Floats) -> Floats:
    gap = x[..., :, None] - y[..., None, :]
    return np.asarray(((gap > 0) + 0.5 * (gap == 0)).mean(axis=(-2, -1)))


def _iqm(values: Floats) -> Floats:
    return np.asarray(trim_mean(values, QUARTER, axis=-1))


def _estimate(statistic: Callable[..., Floats], **groups: ArrayLike) -> Estimate:
    """Estimate a statistic of groups (..., seeds), with the percentile interval of a bootstrap
    within each; a single seed cannot be resampled.
    """
    samples = [_checked(name, values) for name, values in groups.items()]
    value, n = float(statistic(*samples)), min(map(len, samples))
    if n == 1:
        return Estimate(value, None, n)
    found = bootstrap(
        samples,
        lambda *drawn, axis: statistic(*drawn),
        vectorized=True,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(BOOTSTRAP_SEED),
    ).confidence_interval
    return Estimate(value, (float(found.low), float(found.high)), n)


def _checked(name: str, values: ArrayLike) -> Floats:
    array = np.asarray(values, np.float64)
    if array.ndim != 1 or array.size == 0 or not np.isfinite(array).all():
        raise ValueError(f"{name}={values!r} must hold finite numbers, and at least one")
    return array
