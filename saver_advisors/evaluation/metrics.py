"""Metrics of a learning curve: the four of the dissertation's Table 5.2, steps to a success rate,
and the area under the curve.

The dissertation defines them relative to a run's own maximum success rate, MSR: the inspired epoch
IE is the first at 10% of it, the rise time RT lasts from there to 90% of it, and the effective
learning rate ELR is 0.9 MSR over the epochs until then. Its table agrees with
ELR = 0.9 MSR / (IE + RT) in every row. These levels count as reached at the first evaluation that
shows them; an absolute success rate at the first of two consecutive ones, since one may be luck.
Nothing is interpolated, so figures in epochs are no finer than the gaps between evaluations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

EPOCH_STEPS: Final = 2_500
"""Environment steps per epoch; the paper does not define its epochs in steps."""

INSPIRED: Final = 0.1
RISEN: Final = 0.9
"""Fractions of a run's own maximum success rate between which the rise time is measured."""

SOLVED: Final = 0.9
"""Absolute success rate of a solved task."""

CONSECUTIVE: Final = 2
"""Evaluations in a row that must show an absolute success rate."""

TOLERANCE: Final = 1e-9
"""Tolerance for floating-point error when success rates are compared."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LearningCurve:
    """Success rates of a run's evaluations.

    :param steps: (evaluations,) environment steps, at least 0 and increasing
    :param success: (evaluations,) success rates, in [0, 1]
    :param seconds: (evaluations,) of training until then, or None if unknown
    :raises ValueError: for no evaluation, different shapes, NaN, rates outside [0, 1], or steps
        that do not increase
    """

    steps: Floats
    success: Floats
    seconds: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("steps", "success", "seconds"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, self._checked(name, values))
        if self.steps[0] < 0 or (np.diff(self.steps) <= 0).any():
            raise ValueError(f"steps={self.steps.tolist()} must rise, from 0 or more")
        if self.success.min() < 0 or self.success.max() > 1:
            raise ValueError(f"success={self.success.tolist()} must lie in [0, 1]")

    def _checked(self, name: str, values: ArrayLike) -> Floats:
        """Return a column as a float array of the curve's length."""
        array = np.asarray(values, np.float64)
        length = np.size(self.steps)
        if array.ndim != 1 or array.size == 0 or array.size != length:
            raise ValueError(
                f"{name} has shape {array.shape}: must be one number per evaluation, {length} as "
                "in steps, and at least one"
            )
        if not np.isfinite(array).all():
            raise ValueError(f"{name}={array.tolist()} must be finite numbers")
        return array

    @classmethod
    def from_points(cls, points: Sequence[Mapping[str, Any]]) -> LearningCurve:
        """Build the curve of a run.

        :param points: one mapping per evaluation, as in ``curve.jsonl``
        :return: the curve; its seconds are processor time if every evaluation has it, else
            wall-clock time if every evaluation has that
        :raises ValueError: as the class, and for a point without steps or success rate
        """
        columns: dict[str, list[Any]] = {
            name: [point.get(name) for point in points]
            for name in ("steps", "success_rate", "processor_s", "wall_clock_s")
        }
        for name in ("steps", "success_rate"):
            if None in columns[name]:
                raise ValueError(f"evaluation {columns[name].index(None)} has no {name}")
        known = [
            np.asarray(column, np.float64) for column in columns.values() if None not in column
        ]
        return cls(*known[:3])


@dataclass(frozen=True)
class TimeToLevel:
    """When a success rate was reached; censored if it never was.

    :param steps: environment steps at the first of the evaluations that show it, None without them
    :param seconds: of training there, None if never reached or unknown
    :param observed_steps: steps of the last evaluation, a lower bound if ``steps`` is None
    :param observed_s: seconds of training there, None if unknown
    """

    steps: float | None
    seconds: float | None
    observed_steps: float
    observed_s: float | None


def time_to_level(curve: LearningCurve, level: float = SOLVED) -> TimeToLevel:
    """Find the first of ``CONSECUTIVE`` evaluations with a success rate.

    :param curve: of a run
    :param level: an absolute success rate, in (0, 1]
    :return: steps and seconds until then, and until the last evaluation
    :raises ValueError: for another level
    """
    if not 0 < level <= 1:
        raise ValueError(f"level={level} must lie in (0, 1]")
    first = _first_at(curve, level, CONSECUTIVE)
    seconds = curve.seconds
    return TimeToLevel(
        steps=None if first is None else float(curve.steps[first]),
        seconds=None if first is None or seconds is None else float(seconds[first]),
        observed_steps=float(curve.steps[-1]),
        observed_s=None if seconds is None else float(seconds[-1]),
    )


def area_under_curve(curve: LearningCurve, up_to: float | None = None) -> float:
    """Compute the mean success rate over a budget of steps.

    Straight lines join the evaluations; the curve starts from 0 at step 0, unless the run was
    evaluated there.

    :param curve: of a run
    :param up_to: steps of the budget, the same for all compared runs; all observed steps if None
    :return: in [0, 1]
    :raises ValueError: for a budget beyond the last evaluation, or of 0 steps
    """
    steps, success = curve.steps, curve.success
    end = float(steps[-1]) if up_to is None else float(up_to)
    if not 0 < end <= steps[-1]:
        raise ValueError(
            f"up_to={end:g} must be above 0 and at most the last evaluation's {steps[-1]:g} steps"
        )
    if steps[0] > 0:
        steps, success = np.append(0.0, steps), np.append(0.0, success)
    inside = steps < end
    x = np.append(steps[inside], end)
    y = np.append(success[inside], np.interp(end, steps, success))
    return float(np.trapezoid(y, x) / end)


@dataclass(frozen=True)
class LearningMetrics:
    """The metrics of one run's curve, as tables report them.

    :param inspired_epoch: IE, epochs at the first evaluation with 10% of MSR; None if no episode
        ever succeeded
    :param rise_time: RT, epochs from there to the first evaluation with 90% of MSR; None as above
    :param maximum_success_rate: MSR, the highest success rate of the evaluations
    :param effective_learning_rate: ELR, 0.9 MSR over the epochs at the first evaluation with that
        rate; None as above, or if that evaluation precedes the first step
    :param solved: when ``SOLVED`` was reached
    :param resolution: longest gap between evaluations in epochs, which limits the precision of
        figures in epochs
    """

    inspired_epoch: float | None
    rise_time: float | None
    maximum_success_rate: float
    effective_learning_rate: float | None
    solved: TimeToLevel
    resolution: float


def learning_metrics(curve: LearningCurve, *, spent_before: float = 0.0) -> LearningMetrics:
    """Compute the metrics of a curve.

    :param curve: of a run
    :param spent_before: steps before the run that count as well, such as a teacher's, 0 or more
    :return: the metrics
    """
    counted = replace(curve, steps=curve.steps + spent_before)
    best = float(curve.success.max())
    inspired, risen = (_epochs_at(counted, share * best) for share in (INSPIRED, RISEN))
    gaps = np.diff(curve.steps, prepend=0.0)
    return LearningMetrics(
        inspired_epoch=inspired,
        rise_time=None if inspired is None or risen is None else risen - inspired,
        maximum_success_rate=best,
        effective_learning_rate=RISEN * best / risen if risen else None,
        solved=time_to_level(counted),
        resolution=float(gaps.max()) / EPOCH_STEPS,
    )


def _first_at(curve: LearningCurve, level: float, consecutive: int = 1) -> int | None:
    """Return the index of the first of some evaluations in a row of at least ``level``."""
    reached = curve.success >= level - TOLERANCE
    if reached.size < consecutive:
        return None
    found = np.flatnonzero(sliding_window_view(reached, consecutive).all(axis=1))
    return int(found[0]) if found.size else None


def _epochs_at(curve: LearningCurve, level: float) -> float | None:
    """Return the epochs at the first evaluation with a level; None if the level is 0."""
    first = _first_at(curve, level) if level > 0 else None
    return None if first is None else float(curve.steps[first]) / EPOCH_STEPS
