"""The result of a run: one JSON file, the source of tables and figures."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from saver_advisors.evaluation.protocol import REPORT_SEED
from saver_advisors.experiments.grid import ExperimentRun
from saver_advisors.experiments.training_runs import KIND
from saver_advisors.reporting.provenance import provenance, write_json_atomic
from saver_advisors.training.curve_file import read_curve
from saver_advisors.training.settings import RunConfig

RESULT_KEYS: Final = ("kind", "name", "task", "row", "seed", "config", "curve", "finished")


@dataclass(frozen=True)
class RunState:
    """The state of a run of a grid.

    :param state: ``waiting``, ``started`` (partly done) or ``done``
    :param steps: environment steps at the last evaluation
    :param success_rate: of the last evaluation, None before the first
    :param best_success_rate: of the best evaluation
    :param wall_clock_s: seconds of training so far
    """

    state: str
    steps: int = 0
    success_rate: float | None = None
    best_success_rate: float | None = None
    wall_clock_s: float = 0.0


def result_path(results: str | Path, run: ExperimentRun) -> Path:
    """Return the path of a run's result.

    :param results: the folder of a grid's results
    :param run: one of its runs
    """
    return Path(results) / f"{run.name}.json"


def read_result(path: str | Path) -> dict[str, Any]:
    """Read one result.

    :param path: of the file
    :raises ValueError: if it is truncated, or not the result of a run
    :raises OSError: if it cannot be read
    """
    path = Path(path)
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is truncated or not JSON: {error}") from error
    if not isinstance(values, dict) or values.get("kind") != KIND:
        raise ValueError(f"{path} is not the result of a run (kind={KIND!r})")
    missing = [key for key in RESULT_KEYS if key not in values]
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}")
    return values


def is_done(results: str | Path, run: ExperimentRun) -> bool:
    """Whether a run has a complete result of the requested configuration.

    :param results: the folder of results
    :param run: of the grid
    """
    try:
        values = read_result(result_path(results, run))
        # Through the class: a setting that is newer than the file gets its default.
        config = RunConfig.from_mapping(values["config"])
    except (OSError, TypeError, ValueError):
        return False
    return bool(values["finished"]) and _as_json(config) == _as_json(run.config)


def state_of(run: ExperimentRun, folder: str | Path, results: str | Path) -> RunState:
    """Determine the state of a run from its files.

    :param run: of the grid
    :param folder: the run's own
    :param results: the folder of results
    """
    done = is_done(results, run)
    curve = read_result(result_path(results, run))["curve"] if done else read_curve(folder)
    if not curve:
        return RunState("done" if done else "waiting")
    last = curve[-1]
    return RunState(
        "done" if done else "started",
        int(last["steps"]),
        float(last["success_rate"]),
        max(float(line["success_rate"]) for line in curve),
        float(last["wall_clock_s"]),
    )


def write_result(
    run: ExperimentRun, folder: str | Path, path: str | Path, threads: int = 1
) -> dict[str, Any]:
    """Write the result of a run: its curve and, if it is finished, the final evaluation.

    The student acts without a teacher in the final evaluation, on the report seeds.

    :param run: of the grid
    :param folder: the run's own; the run may have stopped early
    :param path: of the result
    :param threads: of the simulation
    :return: the content of the file
    :raises OSError: if it cannot be written; an earlier file is then intact
    """
    from saver_advisors.training.release import evaluate_trained

    folder = Path(folder)
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    curve = read_curve(folder)
    finished = bool(curve) and curve[-1]["steps"] >= run.config.total_steps
    final = None
    if finished:
        # The last policy, since choosing the best one would bias the result.
        outcomes = evaluate_trained(
            folder, "latest", episodes=run.final_episodes, seed=REPORT_SEED, threads=threads
        )
        final = outcomes.summary()
    values = {
        "kind": KIND,
        "name": run.name,
        "group": run.group,
        "task": run.config.env_id,
        "row": run.row,
        "seed": run.config.seed,
        "finished": finished,
        "final": final,
        "teacher_steps": teacher_steps(run),
        "config": _as_json(run.config),
        "curve": curve,
        "sessions": record["sessions"],
        "provenance": provenance(),
    }
    write_json_atomic(path, values)
    return values


def teacher_steps(run: ExperimentRun) -> int:
    """Sum the environment steps that a run's teachers were trained for, each teacher once.

    :param run: of the grid
    """
    from saver_advisors.pretrained import load_policy

    advice = run.config.advice
    if advice is None:
        return 0
    given: Any = advice.teacher
    names: Iterable[str] = [given] if isinstance(given, str) else given
    return sum(load_policy(name).card.steps for name in sorted(set(names)))


def _as_json(config: RunConfig) -> Any:
    """Return the settings as JSON restores them: tuples become lists."""
    return json.loads(json.dumps(config.to_mapping()))
