"""Summarize the seeds of one method in one task as a row of a table.

Only finished runs count: the metrics of the dissertation's table are relative to a run's maximum,
which an unfinished run may not have reached.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from saver_advisors.evaluation.metrics import LearningMetrics, area_under_curve
from saver_advisors.evaluation.protocol import SEEDS, off_protocol
from saver_advisors.evaluation.statistics import Estimate, estimate
from saver_advisors.experiments.training_runs import TrainingRun

MINUTE: Final = 60.0


@dataclass(frozen=True)
class Censored:
    """The time of an event over seeds, some of which may have ended before it.

    :param values: one time per seed: of the event, or of the run's end without it
    :param never: number of seeds without the event
    """

    values: Sequence[float]
    never: int

    @cached_property
    def estimate(self) -> Estimate:
        """The estimate over all seeds; a lower bound if ``never`` is above 0."""
        return estimate(self.values)

    def text(self, digits: int = 0, scale: float = 1.0) -> str:
        """Format the estimate, such as ``> 1,600,000 (1 of 2 never)``."""
        if not self.never:
            return self.estimate.text(digits, scale)
        value = f"{scale * self.estimate.value:,.{digits}f}"
        return f"> {value} ({self.never} of {self.estimate.n} never)"

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {**self.estimate.to_mapping(), "never": self.never}


def _figure(of: Callable[[TrainingRun], float | None]) -> cached_property[Estimate | None]:
    """Define a figure of a row: the estimate over the runs that have it, None if none does."""

    def over_seeds(row: MethodRow) -> Estimate | None:
        values = [value for run in row.runs if (value := of(run)) is not None]
        return estimate(values) if values else None

    return cached_property(over_seeds)


def _time(
    of: Callable[[TrainingRun], tuple[float | None, float | None]],
) -> cached_property[Censored | None]:
    """Define the time of an event, from that time and the end of the observation of each run; None
    if the observation of a run without the event is unknown.
    """

    def over_seeds(row: MethodRow) -> Censored | None:
        pairs = [of(run) for run in row.runs]
        values = [observed if reached is None else reached for reached, observed in pairs]
        known = [value for value in values if value is not None]
        if not values or len(known) < len(values):
            return None
        return Censored(known, sum(reached is None for reached, _ in pairs))

    return cached_property(over_seeds)


def _steps_of(metrics: LearningMetrics | None) -> tuple[float | None, float | None]:
    """Return the steps to 0.9, or None, and the steps of the last evaluation."""
    if metrics is None:
        return None, None
    return metrics.solved.steps, metrics.solved.observed_steps


@dataclass(frozen=True)
class MethodRow:
    """A method in a task.

    :param task: id of the environment
    :param name: of the row
    :param runs: its finished runs, one per seed
    :param under_way: its unfinished runs
    :param budget: steps over which the mean success is taken, the same for all rows of a task
    """

    task: str
    name: str
    runs: Sequence[TrainingRun]
    under_way: Sequence[TrainingRun] = ()
    budget: float | None = None

    inspired_epoch = _figure(lambda run: run.metrics.inspired_epoch)
    """IE of the seeds that ever succeeded; None if none did."""
    rise_time = _figure(lambda run: run.metrics.rise_time)
    """RT of the seeds that ever succeeded."""
    maximum_success_rate = _figure(lambda run: run.metrics.maximum_success_rate)
    """MSR."""
    effective_learning_rate = _figure(lambda run: run.metrics.effective_learning_rate or 0.0)
    """ELR, which is 0 for a seed that never succeeded."""
    steps_to_solved = _time(lambda run: _steps_of(run.metrics))
    """Steps of the run to a success rate of 0.9."""
    all_steps_to_solved = _time(lambda run: _steps_of(run.metrics_with_teacher))
    """The same including steps before the run, of teachers and demonstrations; None if those of a
    run are unknown.
    """
    seconds_to_solved = _time(
        lambda run: (run.metrics.solved.seconds, run.metrics.solved.observed_s)
    )
    """Training time (s) to a success rate of 0.9; None if that of a run is unknown."""
    final_success = _figure(lambda run: run.final_success)
    """Success rate on report seeds, of the runs that were evaluated there."""
    final_safe_success = _figure(lambda run: run.final_rate("safe_success_rate"))
    """The same without a step of collision."""
    final_success_2cm = _figure(lambda run: run.final_rate("success_rate_2cm"))
    """The same with every object within 2 cm of its target."""
    collision_force = _figure(lambda run: run.final_rate("collision_force_mean"))
    """Highest force (N) of collisions in an episode, on average."""
    last_success = _figure(lambda run: float(run.curve.success[-1]))
    """Success rate of the last evaluation of the curve."""

    @cached_property
    def area(self) -> Estimate | None:
        """Mean success over the budget."""
        return estimate(self.areas) if self.runs else None

    advice_spent = _figure(lambda run: float(run.advice_spent))
    """Environment steps with advice."""
    advice_over = _figure(lambda run: run.advice_over)
    """Environment steps until the last advice was given; None without advice."""
    collisions = _figure(lambda run: run.collisions)
    """Steps with a collision per episode."""
    training_s = _figure(lambda run: run.metrics.solved.observed_s)
    """Training time (s) of a whole run, of the runs that recorded it."""

    @property
    def n(self) -> int:
        """Finished seeds."""
        return len(self.runs)

    @property
    def areas(self) -> list[float]:
        """Each seed's mean success over the budget."""
        return [area_under_curve(run.curve, self.budget) for run in self.runs]

    @property
    def steps_before(self) -> list[int]:
        """Distinct numbers of steps before its runs; empty if unknown."""
        return sorted({run.spent_before for run in self.runs if run.spent_before is not None})

    @property
    def off_protocol(self) -> str:
        """In which points the row deviates from the protocol; empty where it follows it."""
        told = [] if self.n >= SEEDS else [f"{self.n} of {SEEDS} seeds"]
        told += [point for run in self.runs for point in off_protocol(run.config, run.final)]
        return "; ".join(dict.fromkeys(told))

    @property
    def unsolved_seeds(self) -> list[int]:
        """Seeds that never reached a success rate of 0.9."""
        return [run.seed for run in self.runs if run.metrics.solved.steps is None]

    def to_mapping(self) -> dict[str, Any]:
        """Return all figures as plain values, for JSON."""
        told: dict[str, Any] = {
            "task": self.task,
            "row": self.name,
            "n": self.n,
            "seeds": [run.seed for run in self.runs],
            "under_way": [
                {"seed": run.seed, "steps": float(run.curve.steps[-1])} for run in self.under_way
            ],
            "unsolved_seeds": self.unsolved_seeds,
            "steps_before": self.steps_before,
            "off_protocol": self.off_protocol,
        }
        for name in FIGURES:
            figure = getattr(self, name)
            told[name] = None if figure is None else figure.to_mapping()
        return told


FIGURES: Final = tuple(
    name for name, value in vars(MethodRow).items() if isinstance(value, cached_property)
)
"""The properties of a row that are figures over its seeds: all that are cached."""


def summarize(
    task: str, by_row: Mapping[str, Sequence[TrainingRun]], order: Sequence[str] = ()
) -> list[MethodRow]:
    """Build the rows of a task's table.

    :param task: id of the environment
    :param by_row: its runs by row
    :param order: rows that come first; the others follow by name
    :return: all rows, including those without a finished run
    """
    finished = [run for runs in by_row.values() for run in runs if run.finished]
    budget = min((float(run.curve.steps[-1]) for run in finished), default=0.0)
    names = [name for name in order if name in by_row]
    names += sorted(set(by_row) - set(names))
    return [
        MethodRow(
            task,
            name,
            [run for run in by_row[name] if run.finished],
            [run for run in by_row[name] if not run.finished],
            budget or None,
        )
        for name in names
    ]
