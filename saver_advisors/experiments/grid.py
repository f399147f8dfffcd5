"""A grid of runs, read from a YAML file: tasks by rows by seeds.

::

    title: Advising
    final_episodes: 500         # of each student, on seeds from 0, when its run has ended
    groups:
      push:                     # the runs are called push-<row>-seed<seed>
        env_id: DualJacoPush-v0
        settings: {total_steps: 1000000}     # fields of RunConfig
        advice: {teacher: jaco-push}         # what the rows with advice have in common
        budget_fraction: 0.22                # of total_steps, for rows that give no budget
        seeds: [0]
        rows:
          none: {}
          early: {advice: {strategy: early}, seeds: [0, 1]}

A row starts from what ``saver train`` starts from for that environment, its advice left out; then
come the group's settings, then the row's. The order of the file is the order of work: every row's
first seed, then every row's second, and so on.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from saver_advisors.training.settings import RunConfig

DEFAULT_FINAL_EPISODES: Final = 500
GRID_KEYS: Final = ("title", "final_episodes", "groups")
GROUP_KEYS: Final = ("env_id", "settings", "advice", "budget_fraction", "seeds", "rows")
ROW_KEYS: Final = ("settings", "advice", "budget_fraction", "seeds")


@dataclass(frozen=True)
class ExperimentRun:
    """One run of a grid.

    :param name: of its folder and of its result file; unlike every other of the grid
    :param group: the part of the grid that it belongs to
    :param row: what tables call it; runs of one row differ in their seed alone
    :param config: what to do
    :param final_episodes: episodes on seeds from 0 that the student is reported on
    """

    name: str
    group: str
    row: str
    config: RunConfig
    final_episodes: int = DEFAULT_FINAL_EPISODES

    def to_mapping(self) -> dict[str, Any]:
        """:return: JSON-able values, for ``from_mapping``"""
        return {**vars(self), "config": self.config.to_mapping()}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> ExperimentRun:
        """
        :param values: what ``to_mapping`` returned
        :raises ValueError: where something is missing or unknown
        """
        try:
            return cls(**{**values, "config": RunConfig.from_mapping(values["config"])})
        except (KeyError, TypeError) as error:
            raise ValueError(f"not an experiment's run: {error}") from error


@dataclass(frozen=True)
class Grid:
    """Runs in the order in which they are to be done.

    :param title: of the whole
    :param runs: at least one
    """

    title: str
    runs: tuple[ExperimentRun, ...] = field(repr=False)

    def named(self, name: str) -> ExperimentRun:
        """The run of that name."""
        return next(run for run in self.runs if run.name == name)

    def only(self, words: Sequence[str]) -> Grid:
        """The runs whose names contain any of some words.

        :param words: parts of names; all runs where there are none
        :return: those runs, in order
        :raises ValueError: where no name contains any of them
        """
        if not words:
            return self
        chosen = tuple(run for run in self.runs if any(word in run.name for word in words))
        if not chosen:
            names = ", ".join(run.name for run in self.runs)
            raise ValueError(f"no run is called like {' or '.join(words)}; there are {names}")
        return Grid(self.title, chosen)


def read_grid(path: str | Path) -> Grid:
    """Read and check a whole grid before anything of it runs.

    :param path: of the YAML file
    :return: its runs
    :raises ValueError: for whatever is wrong in it, with the place
    :raises OSError: where it cannot be read
    """
    import yaml

    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is no YAML: {error}") from error
    try:
        return _grid(_mapping(content, "the file", GRID_KEYS))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def _grid(content: Mapping[str, Any]) -> Grid:
    final_episodes = content.get("final_episodes", DEFAULT_FINAL_EPISODES)
    if isinstance(final_episodes, bool) or not isinstance(final_episodes, int):
        raise TypeError(f"final_episodes={final_episodes!r} must be a whole number")
    if final_episodes < 1:
        raise ValueError(f"final_episodes={final_episodes} must be at least 1")
    ranked = []
    for group_name, group in _mapping(content.get("groups"), "groups").items():
        group = _mapping(group, group_name, GROUP_KEYS)
        for row_name, row in _mapping(group.get("rows"), f"{group_name}.rows").items():
            place = f"{group_name}.{row_name}"
            row = _mapping({} if row is None else row, place, ROW_KEYS)
            for rank, seed in enumerate(_seeds(row.get("seeds", group.get("seeds", [0])), place)):
                try:
                    config = _config(group, row, seed)
                except (TypeError, ValueError) as error:
                    raise ValueError(f"{place}: {error}") from error
                name = _slug(f"{group_name}-{row_name}-seed{seed}")
                ranked.append((rank, ExperimentRun(name, group_name, row_name, config)))
    # Sorting keeps the order of the file among equals.
    runs = tuple(run for _, run in sorted(ranked, key=lambda pair: pair[0]))
    if not runs:
        raise ValueError("groups: give at least one, with at least one row")
    names = [run.name for run in runs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"two runs would be called {', '.join(twice)}: rename a row or a seed")
    runs = tuple(
        ExperimentRun(run.name, run.group, run.row, run.config, final_episodes) for run in runs
    )
    return Grid(str(content.get("title", "Experiments")), runs)


def _config(group: Mapping[str, Any], row: Mapping[str, Any], seed: int) -> RunConfig:
    """The configuration of one run: the environment's defaults, the group's settings, the row's."""
    from saver_advisors.training.defaults import default_settings
    from saver_envs.registration import row_of

    env_id = str(group.get("env_id"))
    row_of(env_id)
    values = {**default_settings(env_id), "advice": None}
    for part in (group, row):
        values |= _mapping(part.get("settings", {}), "settings")
    values |= {"env_id": env_id, "seed": seed}
    if row.get("advice") is not None:
        advice = {
            **_mapping(group.get("advice", {}), "advice"),
            **_mapping(row["advice"], "advice"),
        }
        fraction = row.get("budget_fraction", group.get("budget_fraction"))
        if "budget" not in advice and fraction is not None:
            advice["budget"] = _budget(fraction, RunConfig.from_mapping(values).total_steps)
        values["advice"] = advice
    return RunConfig.from_mapping(values)


def _budget(fraction: Any, total_steps: int) -> int:
    number = isinstance(fraction, (int, float)) and not isinstance(fraction, bool)
    if not number or not 0.0 <= fraction <= 1.0:
        raise ValueError(f"budget_fraction={fraction!r} must be a number from 0 to 1")
    return round(fraction * total_steps)


def _seeds(values: Any, place: str) -> list[int]:
    numbers = isinstance(values, list) and all(
        isinstance(v, int) and not isinstance(v, bool) and v >= 0 for v in values
    )
    if not numbers or not values:
        raise ValueError(f"{place}: seeds={values!r} must be a list of whole numbers of at least 0")
    return list(values)


def _mapping(content: Any, place: str, keys: Sequence[str] | None = None) -> dict[str, Any]:
    """A mapping with text keys, known ones where it says which."""
    if not isinstance(content, Mapping):
        raise TypeError(f"{place} must hold names and values, not {content!r}")
    surplus = [key for key in content if keys is not None and key not in keys]
    if surplus:
        raise ValueError(f"{place}: unknown {surplus}; there may be {', '.join(keys or ())}")
    return {str(key): value for key, value in content.items()}


def _slug(text: str) -> str:
    """A name that every file system takes."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-")
