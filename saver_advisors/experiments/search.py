"""Read a search over settings from a YAML file.

::

    title: Learning rate and width
    env_id: JacoPush-v0
    settings: {total_steps: 300000}            # fields of RunConfig, as in a grid's row
    space:
      learning_rate: {log_uniform: [1.0e-4, 3.0e-3]}
      gradient_steps: {int: [20, 80]}
      net_arch: {choice: [[128, 128], [256, 256, 256]]}
      train_env_kwargs.rated: {choice: [true, false]}
    seeds: [0, 1]                              # the runs of a trial
    objective: {mean_success: 3}               # of the last 3 evaluations; or steps_to_0.9
    trials: 40
    pruner: {startup_trials: 5, warmup_steps: 100000}    # null: no trial ends early
    final_episodes: 100

The entries of a grid's row are valid too: ``advice``, ``budget_fraction``, and ``algorithm`` with
``algo_kwargs``, where the space names keyword arguments of the algorithm.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

from saver_advisors.evaluation.metrics import SOLVED, LearningCurve, time_to_level
from saver_advisors.experiments.grid import (
    DEFAULT_FINAL_EPISODES,
    ROW_KEYS,
    SHARED_SETTINGS,
    ExperimentRun,
    check_rows,
    checked_mapping,
    checked_seeds,
    checked_whole,
    is_whole,
    run_of_row,
)
from saver_advisors.experiments.space import SearchedSetting, parse_space
from saver_advisors.training.settings import naming, read_mapping

JOURNAL_FILE: Final = "study.journal"
"""The study of a search, in its folder."""
STEPS_TO_SOLVED: Final = f"steps_to_{SOLVED:g}"
MEAN_SUCCESS: Final = "mean_success"
#: Entries that may change while a search goes on.
MAY_CHANGE: Final = ("title", "trials", "pruner")
PRUNER_KEYS: Final = ("startup_trials", "warmup_steps")
SEARCH_KEYS: Final = (
    *MAY_CHANGE,
    *("env_id", "space", "objective", "final_episodes"),
    *ROW_KEYS,
)


@dataclass(frozen=True)
class Objective:
    """What is best in a search.

    :param last: maximise the mean success rate of so many last evaluations; None: minimise the
        steps to a success rate of 0.9
    """

    last: int | None

    @property
    def direction(self) -> Literal["minimize", "maximize"]:
        """``maximize`` or ``minimize``."""
        return "minimize" if self.last is None else "maximize"

    def of_run(self, curve: Sequence[Mapping[str, Any]]) -> float:
        """Return the value of a finished run.

        A run that never reaches 0.9 counts as longer than it is, the more so the lower its best
        rate.

        :param curve: its evaluations
        """
        points = LearningCurve.from_points(curve)
        if self.last is not None:
            return float(points.success[-self.last :].mean())
        reached = time_to_level(points)
        if reached.steps is not None:
            return reached.steps
        return reached.observed_steps * (1.0 + max(0.0, SOLVED - float(points.success.max())))

    def midway(self, point: Mapping[str, Any]) -> float:
        """Return what an evaluation shows so far, in the direction of the objective.

        :param point: of the curve
        """
        rate = float(point["success_rate"])
        return 1.0 - rate if self.last is None else rate

    def text(self, value: float | None) -> str:
        """Format a value; a dash for None."""
        form = ",.0f" if self.last is None else ".3f"
        return "-" if value is None else format(value, form)


@dataclass(frozen=True)
class Search:
    """A search over settings.

    :param content: of the file
    :raises ValueError: for an invalid entry, naming it
    :raises TypeError: for one of the wrong type
    """

    content: Mapping[str, Any] = field(repr=False)

    def __post_init__(self) -> None:
        checked_mapping(self.content, "the file", SEARCH_KEYS)
        for name in ("objective", "seeds", "trials", "pruner"):
            getattr(self, name)
        for place, values in self.examples():
            with naming(place):
                self.runs(place, values)

    @property
    def title(self) -> str:
        """The title of its tables, and the group of its runs."""
        return str(self.content.get("title", "Search"))

    @cached_property
    def space(self) -> tuple[SearchedSetting, ...]:
        """What differs between trials."""
        return parse_space(self.content.get("space"))

    @property
    def seeds(self) -> list[int]:
        """The seeds of the runs of each trial."""
        return checked_seeds(self.content.get("seeds", [0]))

    @property
    def trials(self) -> int:
        """The number of trials."""
        return checked_whole("trials", self.content, 0, 1)

    @property
    def objective(self) -> Objective:
        """What is best."""
        value = self.content.get("objective", {MEAN_SUCCESS: 3})
        if value == STEPS_TO_SOLVED:
            return Objective(None)
        last = value.get(MEAN_SUCCESS) if isinstance(value, Mapping) and len(value) == 1 else None
        if is_whole(last, 1):
            return Objective(last)
        raise ValueError(
            f"objective={value!r} must be {STEPS_TO_SOLVED}, or {{{MEAN_SUCCESS}: N}} for the mean "
            "of the last N evaluations"
        )

    @property
    def pruner(self) -> tuple[int, int] | None:
        """Finished trials, and steps of a trial, before a trial may end early; None: never."""
        value = self.content.get("pruner", {})
        if value is None:
            return None
        with naming("pruner"):
            entries = checked_mapping(value, "the entry", PRUNER_KEYS)
            trials, steps = (checked_whole(PRUNER_KEYS[i], entries, (5, 0)[i], 0) for i in (0, 1))
        return trials, steps

    def examples(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Return values of trials that have each end of each range, and each choice, once.

        :return: the entry that differs from the first example, such as ``space.gamma=0.9``, and the
            values by setting
        """
        first = {one.name: one.values[0] for one in self.space}
        yield "the file", first
        for one in self.space:
            for value in one.values[1:]:
                yield f"space.{one.name}={value}", {**first, one.name: value}

    def runs(self, trial: str, values: Mapping[str, Any]) -> list[ExperimentRun]:
        """Return the runs of a trial, one per seed.

        :param trial: its name
        :param values: of the settings of the space
        :raises ValueError: for values that do not fit together
        :raises TypeError: likewise
        """
        row: dict[str, Any] = {key: self.content[key] for key in ROW_KEYS if key in self.content}
        for name, value in values.items():
            with naming(f"space.{name}"):
                row = _with_entry(row, self._path(name), value)
        final_episodes = checked_whole("final_episodes", self.content, DEFAULT_FINAL_EPISODES, 1)
        group = {"env_id": self.content.get("env_id")}
        return [
            run_of_row(
                {"name": f"{trial}-seed{seed}", "group": self.title, "row": trial},
                group,
                row,
                seed,
                final_episodes,
            )
            for seed in self.seeds
        ]

    def _path(self, name: str) -> tuple[str, ...]:
        """Return where a setting of the space is among the entries of a row."""
        parts = tuple(name.split("."))
        if parts[0] == "advice" and self.content.get("advice") is not None:
            return parts
        foreign = "algorithm" in self.content and parts[0] not in SHARED_SETTINGS
        return ("algo_kwargs" if foreign else "settings", *parts)


def read_search(path: str | Path, trials: int | None = None) -> Search:
    """Read and check a search.

    :param path: of the YAML file
    :param trials: in place of the file's number; None keeps it
    :raises ValueError: for an invalid entry, naming file and entry
    :raises OSError: if the file cannot be read
    """
    content = read_mapping(Path(path))
    try:
        return Search(content if trials is None else {**content, "trials": trials})
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def check_search(search: Search) -> None:
    """Build the environment and the learner of every example once; see ``check_rows``.

    :param search: to check
    :raises ValueError: for settings that do not fit; the message names the entry of the space
    :raises TypeError: likewise
    """
    first, *others = search.examples()
    runs = search.runs("the first values of the space", first[1])[:1]
    for place, values in others:
        group, _, row = place.partition(".")
        runs += [replace(search.runs(place, values)[0], group=group, row=row)]
    check_rows(runs)


def _with_entry(mapping: Mapping[str, Any], path: Sequence[str], value: Any) -> dict[str, Any]:
    """Return a copy of nested mappings with another value at a path."""
    name, *inner = path
    if not inner:
        return {**mapping, name: value}
    nested = mapping.get(name)
    nested = {} if nested is None else checked_mapping(nested, name)
    return {**mapping, name: _with_entry(nested, inner, value)}
