"""Read training runs for tables and figures, from files of the experiment runner,
`saver benchmark run` and `saver curves`.

A truncated or damaged file is reported and skipped. The required entries of a ``training-run`` file
are ``curve`` and the environment (``task``, or ``env_id`` in ``config``); the others have defaults.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from saver_advisors.evaluation.metrics import LearningCurve, LearningMetrics, learning_metrics
from saver_advisors.evaluation.protocol import environment_text

KIND: Final = "training-run"
RENDERED: Final = ("advising", "comparison", "constraints")
"""Kinds of files that are generated from runs, and may be in the same folder."""

DEFAULT_EPISODES: Final = 100
"""Episodes per evaluation, for files that do not state the number."""


@dataclass(frozen=True)
class TrainingRun:
    """The curve and the cost of one run.

    :param name: of the run
    :param task: id of its environment
    :param row: its row in a table, such as ``mc-q 0.1``
    :param seed: of the run
    :param points: one mapping per evaluation, as in ``curve.jsonl``
    :param curve: their steps and success rates
    :param config: its settings
    :param final: the last policy's evaluation on report seeds, None before it
    :param chosen: that of the checkpoint that was best on the selection seeds, if one was kept
    :param shielded: the last policy's evaluation on report seeds with a shield, if there was one
    :param group: its group in a grid of experiments, None outside a grid
    :param teacher_steps: environment steps that trained its teachers, None if unknown
    :param demonstration_steps: environment steps of demonstrations
    :param finished: whether it did all its steps
    :param provenance: of the measurement
    :param world: digest of its world, None for older results
    :param file: that it was read from
    """

    name: str
    task: str
    row: str
    seed: int
    points: Sequence[Mapping[str, Any]]
    curve: LearningCurve
    config: Mapping[str, Any] = field(default_factory=dict)
    final: Mapping[str, Any] | None = None
    chosen: Mapping[str, Any] | None = None
    shielded: Mapping[str, Any] | None = None
    group: str | None = None
    teacher_steps: int | None = 0
    demonstration_steps: int = 0
    finished: bool = True
    provenance: Mapping[str, Any] = field(default_factory=dict)
    world: str | None = None
    file: str = ""

    @property
    def spent_before(self) -> int | None:
        """Environment steps before the run, of teachers and demonstrations; None if the teachers'
        are unknown.
        """
        return None if self.teacher_steps is None else self.teacher_steps + self.demonstration_steps

    @cached_property
    def metrics(self) -> LearningMetrics:
        """Metrics of its curve, counting its own steps."""
        return learning_metrics(self.curve)

    @cached_property
    def metrics_with_teacher(self) -> LearningMetrics | None:
        """The same, counting the steps before the run as well; None if those are unknown."""
        spent = self.spent_before
        return None if spent is None else learning_metrics(self.curve, spent_before=spent)

    @property
    def episodes(self) -> int:
        """Episodes per evaluation."""
        return int(self.config.get("eval_episodes") or DEFAULT_EPISODES)

    def final_rate(self, name: str) -> float | None:
        """Return a figure of the last policy on report seeds, None where there is none."""
        return None if self.final is None else self.final.get(name)

    @property
    def final_success(self) -> float | None:
        """The last policy's success rate on report seeds, None before that evaluation."""
        return self.final_rate("success_rate")

    @property
    def advice_spent(self) -> int:
        """Environment steps in which any arm was advised."""
        return int(self.points[-1].get("advice_spent") or 0)

    @property
    def advice_over(self) -> float | None:
        """Environment steps at the first evaluation after the last advice; None without advice."""
        if not self.advice_spent:
            return None
        spent = [int(point.get("advice_spent") or 0) for point in self.points]
        return float(self.points[spent.index(self.advice_spent)]["steps"])

    @property
    def collisions(self) -> float | None:
        """Steps with a collision per episode of the final evaluation, or of the curve's last."""
        means = {} if self.final is None else self.final.get("cost_means") or {}
        value = means.get("cost_collision", self.points[-1].get("cost_collision"))
        return None if value is None else float(value)


@dataclass(frozen=True)
class Skipped:
    """A file, or a part of one, that tables and figures omit.

    :param file: its name
    :param reason: why it is omitted
    """

    file: str
    reason: str


@dataclass(frozen=True)
class Results:
    """The content of result files.

    :param runs: training runs, one per task, group, row and seed
    :param references: evaluations of policies that were not trained there, such as two teachers
        side by side, as ``saver evaluate`` writes them
    :param skipped: omitted files
    """

    runs: Sequence[TrainingRun]
    references: Sequence[Mapping[str, Any]]
    skipped: Sequence[Skipped]

    def of_task(self, task: str) -> dict[str, list[TrainingRun]]:
        """Return the runs of an environment by row, ordered by seed."""
        rows: dict[str, list[TrainingRun]] = {}
        for run in sorted(self.runs, key=lambda run: run.seed):
            if run.task == task:
                rows.setdefault(run.row, []).append(run)
        return rows


def read_training_runs(paths: Iterable[str | Path]) -> Results:
    """Read training runs and evaluations.

    :param paths: JSON files, and folders whose JSON files are read in the order of their names
    :return: their content
    :raises FileNotFoundError: for a path that does not exist
    """
    runs: dict[tuple[str, str | None, str, int], TrainingRun] = {}
    references: list[Mapping[str, Any]] = []
    skipped: list[Skipped] = []
    for path in _files(paths):
        try:
            content = _content(path)
            found = [replace(run, file=path.name) for run in _runs_of(content, path.stem)]
        except ValueError as error:
            skipped.append(Skipped(path.name, str(error)))
            continue
        if content["kind"] == "evaluation":
            references.append(content)
        for run in found:
            key = (run.task, run.group, run.row, run.seed)
            if key in runs:
                reason = f"{run.task}, {run.row}, seed {run.seed} is already in {runs[key].name}"
                skipped.append(Skipped(path.name, reason))
            else:
                runs[key] = run
    return Results(told_apart(list(runs.values())), references, skipped)


def told_apart(runs: Sequence[TrainingRun]) -> list[TrainingRun]:
    """Rename rows of groups with different settings, so that they are not mistaken for one another.

    Groups are compared by their settings, apart from advice and seed. The settings with most runs
    (in a tie, those of the group with the shortest name) keep their rows' names. In other groups, a
    row that also exists there, or is named after an advice strategy, becomes ``ROW (GROUP)``.

    :param runs: of any tasks
    :return: the same runs, renamed if necessary
    """
    kept = {task: _main_settings(runs, task) for task in {run.task for run in runs}}
    main_rows = {(run.task, run.row) for run in runs if _settings(run) == kept[run.task]}
    return [
        replace(run, row=f"{run.row} ({run.group})")
        if run.group is not None
        and _settings(run) != kept[run.task]
        and ((run.task, run.row) in main_rows or _is_strategy(run))
        else run
        for run in runs
    ]


def _main_settings(runs: Sequence[TrainingRun], task: str) -> str | None:
    """Return the settings that most of a task's runs with strategies share; None without any."""
    counted: dict[str, list[TrainingRun]] = {}
    for run in runs:
        if run.task == task and run.group is not None and _is_strategy(run):
            counted.setdefault(_settings(run), []).append(run)
    names = {key: min(len(run.group or "") for run in found) for key, found in counted.items()}
    return max(counted, key=lambda key: (len(counted[key]), -names[key]), default=None)


def _is_strategy(run: TrainingRun) -> bool:
    """Return whether the row is named after its advice strategy."""
    return run.row.split(" ")[0] == row_name(run.config).split(" ")[0]


def _settings(run: TrainingRun) -> str:
    """Return the settings of a grid's run as comparable text, without advice and seed."""
    if run.group is None:
        return ""
    from saver_advisors.training.settings import RunConfig

    config: Mapping[str, Any] = run.config
    # Through the class: a setting that is newer than the file gets its default.
    with contextlib.suppress(TypeError, ValueError):
        config = RunConfig.from_mapping({**config, "advice": None}).to_mapping()
    others = {name: value for name, value in config.items() if name not in ("advice", "seed")}
    return json.dumps(others, sort_keys=True, default=str)


def row_name(config: Mapping[str, Any]) -> str:
    """Name a run's advice for a table.

    :param config: its settings
    :return: ``none``, or the strategy with its threshold, if any, such as ``mc-q 0.1``
    """
    advice = config.get("advice")
    if not advice:
        return "none"
    threshold = advice.get("threshold")
    strategy = str(advice["strategy"])
    return strategy if threshold is None else f"{strategy} {threshold:g}"


def _files(paths: Iterable[str | Path]) -> list[Path]:
    found: list[Path] = []
    for path in map(Path, paths):
        if not path.exists():
            raise FileNotFoundError(f"{str(path)!r} does not exist")
        found += sorted(path.glob("*.json")) if path.is_dir() else [path]
    return list(dict.fromkeys(found))


def _content(path: Path) -> dict[str, Any]:
    """Read a file.

    :raises ValueError: if it is not a result file
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"is not JSON, or truncated: {error}") from error
    if not isinstance(content, dict) or "kind" not in content:
        raise ValueError("is not a result file: it has no kind")
    return content


def _runs_of(content: Mapping[str, Any], stem: str) -> list[TrainingRun]:
    """Return the training runs in a file.

    :raises ValueError: for a missing entry or an unknown kind
    """
    kind = content["kind"]
    try:
        if kind == KIND:
            return [training_run(content, stem)]
        if kind == "curves":
            return [drawn_run(one, content) for one in content["runs"]]
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"has a missing or invalid entry: {error!r}") from error
    if kind in RENDERED:
        return []
    if kind == "evaluation":
        if not {"env", "policy", "success_rate", "ci95", "episodes"} <= content.keys():
            raise ValueError("is an evaluation without env, policy, success_rate, ci95 or episodes")
        return []
    raise ValueError(f"has kind {kind!r}: must be {KIND}, curves or evaluation")


def training_run(content: Mapping[str, Any], stem: str) -> TrainingRun:
    """Read a run as the experiment runner and `saver benchmark run` write it.

    :param content: of the file
    :param stem: name of a run without a name
    """
    config = content.get("config") or {}
    points = content["curve"]
    env_id = str(content.get("task") or config["env_id"])
    # The number of arms, if it was changed, changes the task.
    options = config.get("env_kwargs") or {}
    steps = points[-1]["steps"] if points else 0
    # By default 0 without advice and None (unknown) with advice.
    teacher_steps = content.get("teacher_steps")
    if teacher_steps is None and not config.get("advice"):
        teacher_steps = 0
    return TrainingRun(
        name=str(content.get("name") or stem),
        task=environment_text(env_id, {k: v for k, v in options.items() if k == "n_arms"}),
        row=str(content.get("row") or row_name(config)),
        seed=int(content.get("seed", config.get("seed", 0))),
        points=points,
        curve=LearningCurve.from_points(points),
        config=config,
        final=content.get("final"),
        chosen=content.get("chosen"),
        shielded=content.get("shielded"),
        group=content.get("group"),
        teacher_steps=None if teacher_steps is None else int(teacher_steps),
        demonstration_steps=int(content.get("demonstration_steps") or 0),
        finished=bool(content.get("finished", steps >= config.get("total_steps", 0))),
        provenance=content.get("provenance") or {},
        world=content.get("world"),
    )


def drawn_run(one: Mapping[str, Any], content: Mapping[str, Any]) -> TrainingRun:
    """Read a run from the figures of `saver curves`.

    :param one: summary of the run
    :param content: with the ``provenance``, if it is known
    """
    advice = one.get("advice")
    config = {
        "env_id": one["env"],
        "env_kwargs": one.get("env_kwargs") or {},
        "algorithm": one.get("algorithm"),
        "advice": None if advice is None else {"strategy": advice},
    }
    return training_run(
        {
            "seed": one.get("seed") or 0,
            "curve": one["points"],
            "config": config,
            "provenance": content.get("provenance"),
            "world": one.get("world"),
        },
        one["name"],
    )
