"""What is read off a learning curve: the four figures of the dissertation's Table 5.2, steps to a
success rate, and the area under the curve.

The dissertation defines them relative to a run's own maximum success rate, MSR: the inspired epoch
IE is the first at 10% of it, the rise time RT lasts from there to 90% of it, and the effective
learning rate ELR is 0.9 MSR over the epochs that it took to get there. Its table agrees with
ELR = 0.9 MSR / (IE + RT) in every row. Between two evaluations nothing is known, so a level is
reached at the first evaluation that shows it: nothing is interpolated, and what is said in epochs
is no finer than the evaluations are apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

EPOCH_STEPS: Final = 2_500
"""Environment steps of one of our epochs; the paper's cannot be counted in steps."""

INSPIRED: Final = 0.1
RISEN: Final = 0.9
"""Shares of a run's own maximum success rate between which it rises."""

SOLVED: Final = 0.9
"""Success rate, absolute, whose first appearance is reported."""

TOLERANCE: Final = 1e-9
"""So that 72 of 100 episodes count as 90% of 80 of 100, which floats deny."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LearningCurve:
    """Success rates of a run's evaluations.

    :param steps: (evaluations,) environment steps done, from 0 up and rising
    :param success: (evaluations,) success rates, in [0, 1]
    :param wall_clock_s: (evaluations,) seconds of training, or None where unknown
    :raises ValueError: for no evaluation, other shapes, NaN, rates outside [0, 1], or steps that do
        not rise
    """

    steps: Floats
    success: Floats
    wall_clock_s: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("steps", "success", "wall_clock_s"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, self._checked(name, values))
        if self.steps[0] < 0 or (np.diff(self.steps) <= 0).any():
            raise ValueError(f"steps={self.steps.tolist()} must rise, from 0 or more")
        if self.success.min() < 0 or self.success.max() > 1:
            raise ValueError(f"success={self.success.tolist()} must lie in [0, 1]")

    def _checked(self, name: str, values: ArrayLike) -> Floats:
        """A column as a float array of the curve's length."""
        array = np.asarray(values, np.float64)
        length = np.size(self.steps)
        if array.ndim != 1 or array.size == 0 or array.size != length:
            raise ValueError(
                f"{name} has shape {array.shape}: must be one number an evaluation, {length} as "
                "steps has, and at least one"
            )
        if not np.isfinite(array).all():
            raise ValueError(f"{name}={array.tolist()} must be finite numbers")
        return array

    @classmethod
    def from_points(cls, points: Sequence[Mapping[str, Any]]) -> LearningCurve:
        """The curve of a run.

        :param points: one mapping an evaluation, as ``curve.jsonl`` has them
        :return: the curve; without wall-clock where an evaluation does not tell it
        :raises ValueError: as the class, and for a point without steps or success rate
        """
        columns: dict[str, list[Any]] = {}
        for name in ("steps", "success_rate", "wall_clock_s"):
            columns[name] = [point.get(name) for point in points]
        for name in ("steps", "success_rate"):
            if None in columns[name]:
                raise ValueError(f"evaluation {columns[name].index(None)} has no {name}")
        seconds = columns["wall_clock_s"]
        return cls(
            np.asarray(columns["steps"], np.float64),
            np.asarray(columns["success_rate"], np.float64),
            None if None in seconds else np.asarray(seconds, np.float64),
        )

    def after(self, steps: float) -> LearningCurve:
        """The same curve when steps that were spent before the run count as well.

        :param steps: of a teacher's training or of demonstrations, 0 or more
        :return: the curve; its wall-clock is the run's own, since those steps' is not known
        :raises ValueError: for fewer than 0 steps, or NaN
        """
        if not 0 <= steps < np.inf:
            raise ValueError(f"steps={steps} must be a number of 0 or more")
        return replace(self, steps=self.steps + steps)


@dataclass(frozen=True)
class TimeToLevel:
    """When a success rate first appeared; censored where it never did.

    :param level: the success rate
    :param steps: environment steps at its first evaluation, None where it was never seen
    :param wall_clock_s: seconds of training there, None likewise or where unknown
    :param observed_steps: steps of the last evaluation: where ``steps`` is None it took more
    :param observed_s: seconds of training there, None where unknown
    """

    level: float
    steps: float | None
    wall_clock_s: float | None
    observed_steps: float
    observed_s: float | None

    @property
    def censored(self) -> bool:
        """Whether the run ended before the level was seen."""
        return self.steps is None


def maximum_success_rate(curve: LearningCurve) -> float:
    """MSR.

    :param curve: of a run
    :return: the highest success rate of its evaluations
    """
    return float(curve.success.max())


def inspired_epoch(curve: LearningCurve) -> float | None:
    """IE.

    :param curve: of a run
    :return: epochs at the first evaluation with 10% of MSR; None where nothing ever succeeded
    """
    return _epochs_at_share(curve, INSPIRED)


def rise_time(curve: LearningCurve) -> float | None:
    """RT.

    :param curve: of a run
    :return: epochs from the first evaluation with 10% of MSR to the first with 90% of it; None
        where nothing ever succeeded
    """
    inspired, risen = _epochs_at_share(curve, INSPIRED), _epochs_at_share(curve, RISEN)
    return None if inspired is None or risen is None else risen - inspired


def effective_learning_rate(curve: LearningCurve) -> float | None:
    """ELR.

    :param curve: of a run
    :return: 0.9 MSR over the epochs at the first evaluation with that rate; None where nothing ever
        succeeded, or where the rate was there before any step
    """
    risen = _epochs_at_share(curve, RISEN)
    return RISEN * maximum_success_rate(curve) / risen if risen else None


def time_to_level(curve: LearningCurve, level: float = SOLVED) -> TimeToLevel:
    """When a success rate was first seen.

    :param curve: of a run
    :param level: an absolute success rate, in (0, 1]
    :return: steps and seconds, or until when it had not been seen
    :raises ValueError: for another level
    """
    if not 0 < level <= 1:
        raise ValueError(f"level={level} must lie in (0, 1]")
    first = _first_at(curve, level)
    seconds = curve.wall_clock_s
    return TimeToLevel(
        level=level,
        steps=None if first is None else float(curve.steps[first]),
        wall_clock_s=None if first is None or seconds is None else float(seconds[first]),
        observed_steps=float(curve.steps[-1]),
        observed_s=None if seconds is None else float(seconds[-1]),
    )


def area_under_curve(
    curve: LearningCurve, up_to: float | None = None, *, spent_before: float = 0.0
) -> float:
    """The mean success rate over a budget of steps.

    Straight lines join the evaluations; the first starts from 0 where the run does, and counted
    steps before the run have no success.

    :param curve: of a run
    :param up_to: steps of the budget, ``spent_before`` among them; all that were observed where
        None. Give runs that are compared the same one
    :param spent_before: steps before the run that count as well, such as a teacher's
    :return: in [0, 1]
    :raises ValueError: for a budget beyond the last evaluation, or of 0 steps
    """
    shifted = curve.after(spent_before)
    end = float(shifted.steps[-1]) if up_to is None else float(up_to)
    if not 0 < end <= shifted.steps[-1]:
        raise ValueError(
            f"up_to={end:g} must be above 0 and at most the last evaluation's "
            f"{shifted.steps[-1]:g} steps"
        )
    steps, success = shifted.steps, shifted.success
    if curve.steps[0] > 0:
        steps, success = np.append(spent_before, steps), np.append(0.0, success)
    inside = steps < end
    x = np.append(steps[inside], end)
    # Left of the run nothing had succeeded; a run evaluated before its first step may jump there.
    y = np.append(success[inside], np.interp(end, steps, success, left=0.0))
    return float(np.trapezoid(y, x) / end)


@dataclass(frozen=True)
class LearningMetrics:
    """Everything that a table says about one run's curve.

    :param inspired_epoch: IE, None where nothing ever succeeded
    :param rise_time: RT, likewise
    :param maximum_success_rate: MSR
    :param effective_learning_rate: ELR, likewise
    :param solved: when ``SOLVED`` was first seen
    :param area: mean success rate over the run
    :param resolution: epochs between evaluations, the longest gap; what is said in epochs is no
        finer
    """

    inspired_epoch: float | None
    rise_time: float | None
    maximum_success_rate: float
    effective_learning_rate: float | None
    solved: TimeToLevel
    area: float
    resolution: float

    def to_mapping(self) -> dict[str, Any]:
        """:return: plain values, for JSON"""
        return asdict(self)


def learning_metrics(curve: LearningCurve, *, spent_before: float = 0.0) -> LearningMetrics:
    """Read everything off a curve.

    :param curve: of a run
    :param spent_before: steps before the run that count as well, such as a teacher's
    :return: the figures
    """
    counted = curve.after(spent_before)
    gaps = np.diff(curve.steps, prepend=0.0)
    # A run whose only evaluation is before its first step has no area to speak of but its rate.
    whole = counted.steps[-1] > 0
    return LearningMetrics(
        inspired_epoch=inspired_epoch(counted),
        rise_time=rise_time(counted),
        maximum_success_rate=maximum_success_rate(counted),
        effective_learning_rate=effective_learning_rate(counted),
        solved=time_to_level(counted),
        area=area_under_curve(curve, spent_before=spent_before)
        if whole
        else maximum_success_rate(counted),
        resolution=float(gaps.max()) / EPOCH_STEPS,
    )


def _first_at(curve: LearningCurve, level: float) -> int | None:
    """The first evaluation with a success rate of at least ``level``."""
    reached = np.flatnonzero(curve.success >= level - TOLERANCE)
    return int(reached[0]) if reached.size else None


def _epochs_at_share(curve: LearningCurve, share: float) -> float | None:
    """Epochs at the first evaluation with that share of the run's own maximum."""
    best = maximum_success_rate(curve)
    first = _first_at(curve, share * best) if best > 0 else None
    return None if first is None else float(curve.steps[first]) / EPOCH_STEPS
