"""Statistics over a few seeds: interquartile means, comparisons, and confidence intervals.

The estimators are those of Agarwal et al., Deep Reinforcement Learning at the Edge of the
Statistical Precipice (arXiv 2108.13264): the interquartile mean, the probability of improvement,
and percentile intervals from a bootstrap that draws seeds within each stratum. A stratum is a task:
seeds are never exchanged between tasks. Episodes of one seed are averaged, since one policy played
them all: the bootstrap draws seeds, not episodes.

A single seed has no interval: its estimate has a value and n = 1. The interval of two seeds extends
from one to the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

Floats = NDArray[np.float64]
Statistic = Callable[[Sequence[Floats]], Floats]
"""From one array (..., seeds) per stratum to a statistic (...)."""


@dataclass(frozen=True)
class Estimate:
    """A statistic over seeds.

    :param value: the statistic
    :param interval: its 95% interval; None unless a stratum has two seeds
    :param n: total number of seeds; of two compared groups, that of the smaller one
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


def estimate(*strata: ArrayLike, resamples: int = RESAMPLES) -> Estimate:
    """Compute the interquartile mean over seeds with its stratified bootstrap interval.

    A quarter of the seeds, rounded down, is left out at each end: none of three or fewer.

    :param strata: one array per task: (seeds,), or (seeds, episodes) whose episodes are averaged
    :param resamples: of the bootstrap
    :return: the estimate
    :raises ValueError: for no stratum, an empty one, or values that are not finite
    """
    samples = _seeds("strata", strata)
    return _estimate(samples, _pooled_iqm, sum(map(len, samples)), resamples)


def difference(x: Strata, y: Strata, *, resamples: int = RESAMPLES) -> Estimate:
    """Compute the difference between two groups.

    :param x: seeds of one group: one array, or a list of arrays, one per task
    :param y: those of the other group, for the same tasks
    :param resamples: of the bootstrap
    :return: IQM(x) - IQM(y)
    :raises ValueError: as ``estimate``, or for different numbers of tasks
    """
    return _compare(x, y, lambda a, b: _pooled_iqm(a) - _pooled_iqm(b), resamples)


def ratio(x: Strata, y: Strata, *, resamples: int = RESAMPLES) -> Estimate:
    """Compute the ratio of two groups.

    :param x: seeds of one group, as for ``difference``
    :param y: those of the other group, above 0
    :param resamples: of the bootstrap
    :return: IQM(x) / IQM(y)
    :raises ValueError: as ``difference``, or for a value of y that is not above 0
    """
    if any((sample <= 0).any() for sample in _seeds("y", _listed(y))):
        raise ValueError(f"y={y!r} must be above 0: x is divided by it")
    return _compare(x, y, lambda a, b: _pooled_iqm(a) / _pooled_iqm(b), resamples)


def probability_of_improvement(x: Strata, y: Strata, *, resamples: int = RESAMPLES) -> Estimate:
    """Compute the probability that a run of x is better than a run of y; ties count half.

    :param x: seeds of one group, as for ``difference``
    :param y: those of the other group
    :param resamples: of the bootstrap
    :return: the mean over tasks of P(x > y) + P(x = y) / 2
    :raises ValueError: as ``difference``
    """
    return _compare(x, y, _improvement, resamples)


Strata = ArrayLike | Sequence[ArrayLike]


def _improvement(x: Sequence[Floats], y: Sequence[Floats]) -> Floats:
    per_task = []
    for a, b in zip(x, y, strict=True):
        gap = a[..., :, None] - b[..., None, :]
        per_task.append(((gap > 0) + 0.5 * (gap == 0)).mean(axis=(-2, -1)))
    return np.mean(per_task, axis=0)


def _pooled_iqm(samples: Sequence[Floats]) -> Floats:
    """Compute the interquartile mean over all strata's seeds, (...,)."""
    return np.asarray(trim_mean(np.concatenate(samples, axis=-1), QUARTER, axis=-1))


def _compare(
    x: Strata, y: Strata, of: Callable[[Sequence[Floats], Sequence[Floats]], Floats], resamples: int
) -> Estimate:
    """Estimate a statistic of two groups, without an interval if one has a single run per task."""
    a, b = _seeds("x", _listed(x)), _seeds("y", _listed(y))
    if len(a) != len(b):
        raise ValueError(f"x has {len(a)} tasks and y {len(b)}: must be the same ones")

    def both(samples: Sequence[Floats]) -> Floats:
        return of(samples[: len(a)], samples[len(a) :])

    smaller = min(sum(map(len, a)), sum(map(len, b)))
    single = any(max(map(len, group)) == 1 for group in (a, b))
    return _estimate([*a, *b], both, smaller, 0 if single else resamples)


def _estimate(samples: Sequence[Floats], statistic: Statistic, n: int, resamples: int) -> Estimate:
    """Estimate a statistic, with the percentile interval of a bootstrap within each sample."""
    value = float(statistic(samples))
    varied = [index for index, sample in enumerate(samples) if len(sample) > 1]
    if not varied or resamples == 0:
        return Estimate(value, None, n)

    def of_drawn(*drawn: Floats, axis: int = -1) -> Floats:
        # A stratum with one seed cannot be resampled, so it is constant.
        leading = drawn[0].shape[:-1]
        full = [np.broadcast_to(sample, (*leading, len(sample))) for sample in samples]
        for index, values in zip(varied, drawn, strict=True):
            full[index] = values
        return statistic(full)

    found = bootstrap(
        [samples[index] for index in varied],
        of_drawn,
        vectorized=True,
        n_resamples=resamples,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(BOOTSTRAP_SEED),
    ).confidence_interval
    return Estimate(value, (float(found.low), float(found.high)), n)


def _listed(group: Strata) -> Sequence[ArrayLike]:
    """Return a group as a list of strata; a single array becomes the only one."""
    if isinstance(group, np.ndarray) or np.isscalar(group):
        return [group]
    items: Sequence[Any] = group  # type: ignore[assignment]  # neither array nor scalar: a sequence
    return items if any(np.ndim(item) for item in items) else [items]


def _seeds(name: str, strata: Sequence[ArrayLike]) -> list[Floats]:
    """Return each stratum as (seeds,), averaging its episodes."""
    if not strata:
        raise ValueError(f"{name} must have at least one array, one per task")
    arrays = [_checked(name, stratum) for stratum in strata]
    for array in arrays:
        if array.ndim > 2:
            raise ValueError(
                f"{name} has an array of shape {array.shape}: must be (seeds,) or (seeds, episodes)"
            )
    return [array.mean(axis=1) if array.ndim == 2 else np.atleast_1d(array) for array in arrays]


def _checked(name: str, values: ArrayLike) -> Floats:
    array = np.asarray(values, np.float64)
    if array.size == 0 or not np.isfinite(array).all():
        raise ValueError(f"{name}={values!r} must hold finite numbers, and at least one")
    return array
