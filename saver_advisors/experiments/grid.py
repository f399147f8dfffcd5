"""Read a grid of runs from a YAML file: groups x rows x seeds.

::

    title: Advising
    final_episodes: 500         # per student after its run, on seeds from 0
    groups:
      push:                     # names of its runs: push-<row>-seed<seed>
        env_id: DualJacoPush-v0
        settings: {total_steps: 1000000}     # fields of RunConfig
        advice: {teacher: jaco-push}         # shared by the rows with advice
        budget_fraction: 0.22                # of total_steps, for rows without a budget
        seeds: [0]
        rows:
          none: {}
          early: {advice: {strategy: early}, seeds: [0, 1]}
          mine: {algorithm: mine.py:Mine, algo_kwargs: {hidden: 64}}

With ``shield: true``, a row of a task with a constraint is evaluated a second time at its end, with
a shield (``saver_advisors.evaluation.shield``).

A row starts from the defaults of ``saver train`` for that environment, without advice. The group's
settings override them, and the row's override those. A row with an algorithm of one's own, as
``saver benchmark run`` takes it, uses those settings that are not our learner's. Runs follow the
order of the file: the first seed of every row, then the second seed of every row, and so on.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from saver_advisors.evaluation.protocol import EVALUATE_EVERY
from saver_advisors.experiments.recorder import BenchmarkPlan
from saver_advisors.training.settings import RunConfig, naming, read_mapping

DEFAULT_FINAL_EPISODES: Final = 500
GRID_KEYS: Final = ("title", "final_episodes", "groups")
GROUP_KEYS: Final = ("env_id", "settings", "advice", "budget_fraction", "seeds", "rows")
THIRD_PARTY_KEYS: Final = ("algorithm", "algo_kwargs", "teacher_steps", "demonstration_steps")
ROW_KEYS: Final = ("settings", "advice", "budget_fraction", "seeds", "shield", *THIRD_PARTY_KEYS)
#: Settings that a third-party algorithm shares with our learner.
SHARED_SETTINGS: Final = (
    *("env_kwargs", "train_env_kwargs", "n_envs", "total_steps", "eval_every", "eval_episodes"),
)


@dataclass(frozen=True)
class ExperimentRun:
    """One run of a grid.

    :param name: unique name, used for its folder and its result file
    :param group: the part of the grid that it belongs to
    :param row: its name in tables; runs of one row differ only in their seed
    :param config: settings of the training run, ours or that of a third-party algorithm
    :param final_episodes: number of episodes, on seeds from 0, of the student's final evaluation
    :param shield: whether that evaluation is repeated with a shield, see
        :mod:`saver_advisors.evaluation.shield`
    """

    name: str
    group: str
    row: str
    config: RunConfig | BenchmarkPlan
    final_episodes: int = DEFAULT_FINAL_EPISODES
    shield: bool = False

    def to_mapping(self) -> dict[str, Any]:
        """Return JSON-able values for ``from_mapping``."""
        return {**vars(self), "config": self.config.to_mapping()}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> ExperimentRun:
        """Restore a run.

        :param values: what ``to_mapping`` returned
        :raises ValueError: for a missing or unknown entry
        """
        try:
            config = values["config"]
            if ":" in config["algorithm"]:
                return cls(**{**values, "config": BenchmarkPlan(**config)})
            return cls(**{**values, "config": RunConfig.from_mapping(config)})
        except (KeyError, TypeError) as error:
            raise ValueError(f"not a run of a grid: {error}") from error


@dataclass(frozen=True)
class Grid:
    """Runs in the order in which they are executed.

    :param title: of the grid
    :param runs: at least one
    """

    title: str
    runs: tuple[ExperimentRun, ...] = field(repr=False)

    def only(self, words: Sequence[str]) -> Grid:
        """Select the runs whose names contain at least one of some words.

        :param words: parts of names; none selects all runs
        :return: the selected runs, in order
        :raises ValueError: if no name contains any of them
        """
        if not words:
            return self
        chosen = tuple(run for run in self.runs if any(word in run.name for word in words))
        if not chosen:
            rows = ", ".join(dict.fromkeys(run.name.rpartition("-seed")[0] for run in self.runs))
            raise ValueError(
                f"no run has {' or '.join(words)} in its name; "
                f"names are one of {rows}, then -seed and a number"
            )
        return Grid(self.title, chosen)


def read_grid(path: str | Path) -> Grid:
    """Read and check a whole grid.

    :param path: of the YAML file
    :return: its runs
    :raises ValueError: for an invalid entry, with its place in the file
    :raises OSError: if the file cannot be read
    """
    content = read_mapping(Path(path))
    try:
        return _grid(checked_mapping(content, "the file", GRID_KEYS))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def _grid(content: Mapping[str, Any]) -> Grid:
    final_episodes = checked_whole("final_episodes", content, DEFAULT_FINAL_EPISODES, 1)
    ranked = []
    for group_name, group in checked_mapping(content.get("groups"), "groups").items():
        group = checked_mapping(group, group_name, GROUP_KEYS)
        for row_name, row in checked_mapping(group.get("rows"), f"{group_name}.rows").items():
            place = f"{group_name}.{row_name}"
            row = checked_mapping({} if row is None else row, place, ROW_KEYS)
            with naming(place):
                seeds = checked_seeds(row.get("seeds", group.get("seeds", [0])))
            for rank, seed in enumerate(seeds):
                label = f"{group_name}-{row_name}-seed{seed}".lower()
                name = re.sub(r"[^a-z0-9.]+", "-", label).strip("-")  # valid on every file system
                labels = {"name": name, "group": group_name, "row": row_name}
                with naming(place):
                    run = run_of_row(labels, group, row, seed, final_episodes)
                ranked.append((rank, run))
    # The sort is stable: within a rank, the order of the file stays.
    runs = tuple(run for _, run in sorted(ranked, key=lambda pair: pair[0]))
    if not runs:
        raise ValueError("groups: give at least one, with at least one row")
    names = [run.name for run in runs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"two runs would have the name {', '.join(twice)}: rename a row or a seed")
    return Grid(str(content.get("title", "Experiments")), runs)


def run_of_row(
    labels: Mapping[str, str],
    group: Mapping[str, Any],
    row: Mapping[str, Any],
    seed: int,
    final_episodes: int,
) -> ExperimentRun:
    """Create a run from the entries of its group and its row.

    :param labels: ``name``, ``group`` and ``row``
    :param group: with ``env_id``, and entries of ``ROW_KEYS`` that the row's override
    :param row: with entries of ``ROW_KEYS``
    :param seed: of the run
    :param final_episodes: of its last policy
    :raises ValueError: for an invalid entry
    :raises TypeError: for one of the wrong type
    """
    config: RunConfig | BenchmarkPlan
    if "algorithm" in row:
        config = third_party_plan(group, row, seed, final_episodes, labels)
    else:
        config = _config(group, row, seed)
    shield = _shield(row.get("shield", False), config)
    return ExperimentRun(**labels, config=config, final_episodes=final_episodes, shield=shield)


def _config(group: Mapping[str, Any], row: Mapping[str, Any], seed: int) -> RunConfig:
    """Merge the environment's defaults, the group's settings and the row's for one run."""
    from saver_advisors.training.defaults import default_settings
    from saver_envs.registration import row_of

    env_id = str(group.get("env_id"))
    row_of(env_id)
    values = {**default_settings(env_id), "advice": None}
    for part in (group, row):
        values |= checked_mapping(part.get("settings", {}), "settings")
    values |= {"env_id": env_id, "seed": seed}
    if row.get("advice") is not None:
        parts = (checked_mapping(one.get("advice", {}), "advice") for one in (group, row))
        advice = {name: value for part in parts for name, value in part.items()}
        fraction = row.get("budget_fraction", group.get("budget_fraction"))
        if "budget" not in advice and fraction is not None:
            advice["budget"] = _budget(fraction, RunConfig.from_mapping(values).total_steps)
        values["advice"] = advice
    return RunConfig.from_mapping(values)


def _shield(value: Any, config: RunConfig | BenchmarkPlan) -> bool:
    """Return whether a row's final evaluation is repeated with a shield."""
    from saver_envs.registration import task_and_settings

    if not isinstance(value, bool):
        raise TypeError(f"shield={value!r} must be true or false")
    if value and not isinstance(config, RunConfig):
        raise ValueError("shield=true needs our learner, whose last policy is kept")
    if value and task_and_settings(config.env_id, config.env_kwargs)[0].constraint is None:
        raise ValueError(f"shield=true needs a task with a constraint, which {config.env_id} lacks")
    return value


def third_party_plan(
    group: Mapping[str, Any],
    row: Mapping[str, Any],
    seed: int,
    final_episodes: int,
    labels: Mapping[str, Any],
) -> BenchmarkPlan:
    """Merge the group's settings and the row's for one run of a third-party algorithm.

    :param group: with ``env_id`` and ``settings``
    :param row: with those of ``THIRD_PARTY_KEYS``, and ``settings``
    :param seed: of the run
    :param final_episodes: of its last policy
    :param labels: ``name``, ``row`` and ``group`` of the plan
    :raises ValueError: for an invalid entry
    :raises TypeError: for one of the wrong type
    """
    from saver_advisors.experiments.third_party import file_sha256
    from saver_advisors.training.defaults import default_settings
    from saver_envs.registration import row_of

    env_id = str(group.get("env_id"))
    row_of(env_id)
    word = row["algorithm"]
    if not isinstance(word, str) or ":" not in word:
        raise ValueError(
            f"algorithm={word!r} must be MODULE:CLASS or FILE.py:CLASS; those of `saver train` are "
            "named in settings: {algorithm: td3}"
        )
    own = checked_mapping(row.get("settings", {}), "settings", SHARED_SETTINGS)
    wanted = {**checked_mapping(group.get("settings", {}), "settings"), **own}
    shared: dict[str, Any] = {name: wanted[name] for name in SHARED_SETTINGS if name in wanted}
    usual = {"total_steps": default_settings(env_id)["total_steps"], "eval_every": EVALUATE_EVERY}
    # Our learner's class checks the types and ranges of the settings that both have.
    checked = RunConfig.from_mapping({**usual, **shared, "env_id": env_id, "seed": seed})
    steps: dict[str, Any] = {name: checked_whole(name, row, 0, 0) for name in THIRD_PARTY_KEYS[2:]}
    return BenchmarkPlan(
        **labels,
        **{name: getattr(checked, name) for name in SHARED_SETTINGS},
        env_id=env_id,
        algorithm=word,
        algo_kwargs=checked_mapping(row.get("algo_kwargs", {}), "algo_kwargs"),
        source_sha256=file_sha256(word),
        seed=seed,
        report_episodes=final_episodes,
        **steps,
    )


def check_rows(runs: Sequence[ExperimentRun]) -> None:
    """Build each row's environment and learner once, so that no mistake shows after hours.

    Modules that rows name are imported last.

    :param runs: of a grid
    :raises ValueError: for settings, environments, teachers or algorithms that do not fit; the
        message names the row
    :raises TypeError: likewise
    """
    from saver_advisors.experiments.third_party import load_class, resolved
    from saver_advisors.training.launch import open_run
    from saver_envs.registration import make_episodes

    rows = {(run.group, run.row): run.config for run in runs}  # they differ in their seed alone
    for (group, row), config in rows.items():
        with naming(f"{group}.{row}"):
            if isinstance(config, BenchmarkPlan):
                make_episodes(config.env_id, **config.env_kwargs)
                with naming("train_env_kwargs"):
                    make_episodes(config.env_id, **config.training_options)
            else:
                with open_run(config, row):
                    pass
    for (group, row), config in rows.items():
        if isinstance(config, BenchmarkPlan):
            with naming(f"{group}.{row}"):
                load_class(config.algorithm)
                resolved(config.algo_kwargs)


def _budget(fraction: Any, total_steps: int) -> int:
    number = isinstance(fraction, (int, float)) and not isinstance(fraction, bool)
    if not number or not 0.0 <= fraction <= 1.0:
        raise ValueError(f"budget_fraction={fraction!r} must be a number from 0 to 1")
    return round(fraction * total_steps)


def checked_seeds(values: Any) -> list[int]:
    """Return a list of seeds after checking it.

    :param values: as the file has them
    :raises ValueError: for anything but a list of integers of at least 0, one or more
    """
    if not isinstance(values, list) or not values or not all(is_whole(v, 0) for v in values):
        raise ValueError(f"seeds={values!r} must be a list of integers of at least 0")
    return values


def checked_whole(name: str, content: Mapping[str, Any], default: int, least: int) -> int:
    """Return an integer entry after checking it.

    :param name: of the entry
    :param content: that may have it
    :param default: without it
    :param least: smallest allowed value
    :raises ValueError: for another value
    """
    value = content.get(name, default)
    if not is_whole(value, least):
        raise ValueError(f"{name}={value!r} must be an integer of at least {least}")
    return int(value)


def is_whole(value: Any, least: int) -> bool:
    """Return whether a value is an integer, not a truth value, with a lower bound."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def checked_mapping(content: Any, place: str, keys: Sequence[str] | None = None) -> dict[str, Any]:
    """Return a mapping with string keys after checking it.

    :param content: as the file has it
    :param place: of the entry, for messages
    :param keys: the valid keys; all if None
    :raises TypeError: for anything but a mapping
    :raises ValueError: for another key
    """
    if not isinstance(content, Mapping):
        raise TypeError(f"{place} must be a mapping, not {content!r}")
    surplus = [key for key in content if keys is not None and key not in keys]
    if surplus:
        raise ValueError(f"{place}: unknown {surplus}; must be among {', '.join(keys or ())}")
    return {str(key): value for key, value in content.items()}
