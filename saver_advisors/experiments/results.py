"""What a run leaves behind: one JSON file, which tables and figures are rendered from."""

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
    """Where a run of a grid stands.

    :param state: ``waiting``, ``started`` (a part of it is done), ``done``
    :param steps: environment steps of the last evaluation
    :param success_rate: of the last evaluation, None before the first
    :param best_success_rate: of the best one
    :param wall_clock_s: seconds of training so far
    """

    state: str
    steps: int = 0
    success_rate: float | None = None
    best_success_rate: float | None = None
    wall_clock_s: float = 0.0


def result_path(results: str | Path, run: ExperimentRun) -> Path:
    """
    :param results: the folder of a grid's results
    :param run: one of its runs
    :return: the file that holds the run's result
    """
    return Path(results) / f"{run.name}.json"


def read_result(path: str | Path) -> dict[str, Any]:
    """Read one result.

    :param path: of the file
    :raises ValueError: where it is cut short, or no result of a run
    :raises OSError: where it cannot be read
    """
    path = Path(path)
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is cut short or no JSON: {error}") from error
    if not isinstance(values, dict) or values.get("kind") != KIND:
        raise ValueError(f"{path} is not the result of a run (kind={KIND!r})")
    missing = [key for key in RESULT_KEYS if key not in values]
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}")
    return values


def read_grid_results(folder: str | Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Read all results of a folder.

    :param folder: with a file a run; other JSON files are passed over
    :return: the results by name, and a line about each file that cannot be used
    """
    results, complaints = [], []
    for path in sorted(Path(folder).glob("*.json")):
        try:
            results.append(read_result(path))
        except ValueError as error:
            complaints.append(str(error))
    return results, complaints


def is_done(results: str | Path, run: ExperimentRun) -> bool:
    """Whether a run has a whole result of the configuration that is asked for.

    :param results: the folder of results
    :param run: of the grid
    """
    try:
        values = read_result(result_path(results, run))
    except (OSError, ValueError):
        return False
    try:
        # By way of the class: a setting that is younger than the file has its default there.
        config = RunConfig.from_mapping(values["config"])
    except (TypeError, ValueError):
        return False
    return bool(values["finished"]) and _as_json(config) == _as_json(run.config)


def state_of(run: ExperimentRun, folder: str | Path, results: str | Path) -> RunState:
    """Where a run stands, from what is on disk.

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
    """Sum a run up: its curve, and its student alone on the seeds that are reported.

    :param run: of the grid
    :param folder: the run's own; it may have stopped before its end
    :param path: of the result
    :param threads: of the simulation
    :return: what was written
    :raises OSError: where it cannot be written; an earlier file is then intact
    """
    from saver_advisors.training.release import evaluate_trained

    folder = Path(folder)
    record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    curve = read_curve(folder)
    finished = bool(curve) and curve[-1]["steps"] >= run.config.total_steps
    final = None
    if finished:
        # The last policy, not the best: choosing after the fact would flatter.
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
    """Environment steps that a run's teachers were trained for, each teacher once.

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
    """The settings as they are after a way through JSON: tuples as lists."""
    return json.loads(json.dumps(config.to_mapping()))
