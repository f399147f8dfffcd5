"""The result of a run: one JSON file, the source of tables and figures."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from saver_advisors.evaluation.episodes import EpisodeOutcomes, joined
from saver_advisors.evaluation.protocol import REPORT_SEED, off_protocol
from saver_advisors.experiments.grid import ExperimentRun
from saver_advisors.experiments.recorder import BenchmarkPlan
from saver_advisors.experiments.training_runs import KIND
from saver_advisors.reporting.provenance import provenance, write_json_atomic
from saver_advisors.training.curve_file import POINT, is_point, read_curve
from saver_advisors.training.run_folder import read_record
from saver_advisors.training.settings import RunConfig
from saver_envs.digest import world_digest
from saver_envs.files import read_json, written_whole
from saver_envs.registration import task_and_settings, varied_in

STEPS_FILE: Final = "steps.json"
"""Environment steps of a third-party algorithm in progress, written every few seconds."""
FINAL_FOLDER: Final = "final-episodes"
FINAL_PART: Final = 32
"""Final episodes per file: two batches of the evaluation, whose outcomes stay the same."""
RESULT_KEYS: Final = ("kind", "name", "task", "row", "seed", "config", "curve", "finished")


@dataclass(frozen=True)
class RunState:
    """The state of a run of a grid.

    :param state: ``waiting``, ``started`` (partly done), ``final episodes 64 of 500`` or ``done``
    :param steps: environment steps so far
    :param curve: its evaluations so far
    """

    state: str
    steps: int
    curve: Sequence[Mapping[str, Any]]


def read_result(path: Path) -> dict[str, Any]:
    """Read one result.

    :param path: of the file
    :raises ValueError: if it is truncated, or not the result of a run
    :raises OSError: if it cannot be read
    """
    values = read_json(path)
    if not isinstance(values, dict) or values.get("kind") != KIND:
        raise ValueError(f"{path} is not the result of a run (kind={KIND!r})")
    missing = [key for key in RESULT_KEYS if key not in values]
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}")
    curve = values["curve"]
    if not isinstance(curve, list) or not curve or not all(map(is_point, curve)):
        raise ValueError(f"{path} has no curve: a list of points with {', '.join(POINT)}")
    return values


def is_done(path: Path, run: ExperimentRun) -> bool:
    """Whether a run has a complete result of the requested configuration.

    :param path: of its result
    :param run: of the grid
    """
    try:
        values = read_result(path)
        if isinstance(run.config, BenchmarkPlan):
            same = not changed_settings(run.config, values["config"])
        else:
            # Through the class: a setting that is newer than the file gets its default.
            config = RunConfig.from_mapping(values["config"])
            same = config.to_mapping() == run.config.to_mapping()
    except (OSError, TypeError, ValueError):
        return False
    return bool(values["finished"]) and same


def changed_settings(plan: BenchmarkPlan, config: Mapping[str, Any]) -> list[str]:
    """Return the names of the settings in which a result differs from a plan.

    :param plan: of a run
    :param config: of the result
    """
    # Through JSON, so that tuples compare equal to lists.
    wanted = json.loads(json.dumps(plan.config()))
    found = {"train_env_kwargs": {}, **config}  # newer than some files
    return sorted(name for name in wanted if wanted[name] != found.get(name))


def state_of(run: ExperimentRun, folder: Path, path: Path) -> RunState:
    """Determine the state of a run from its files.

    :param run: of the grid
    :param folder: the run's own
    :param path: of its result
    """
    done = is_done(path, run)
    if done or (isinstance(run.config, BenchmarkPlan) and path.is_file()):
        curve = read_json(path)["curve"]
    else:
        curve = read_curve(folder)
    steps = int(curve[-1]["steps"]) if curve else 0
    if not done and (folder / STEPS_FILE).is_file():
        steps = max(steps, int(read_json(folder / STEPS_FILE)))
    state = "done" if done else "started" if steps else "waiting"
    if not done and curve and curve[-1]["steps"] >= run.config.total_steps:
        parts = (folder / FINAL_FOLDER).glob("*-*.json")
        played = sum(int(part.stem.split("-")[1]) for part in parts)
        state = f"final episodes {played} of {run.final_episodes}"
    return RunState(state, steps, curve)


def final_outcomes(
    run: ExperimentRun, folder: Path, threads: int = 1, shield: bool = False
) -> EpisodeOutcomes:
    """Evaluate the last policy on the report seeds, in parts that an interruption does not lose.

    :param run: of the grid, with all its steps done
    :param folder: the run's own
    :param threads: of the simulation
    :param shield: see :func:`saver_advisors.training.release.evaluate_trained`
    :return: the outcomes of the run's final episodes
    """
    from saver_advisors.training.release import evaluate_trained

    played = folder / FINAL_FOLDER / ("shielded" if shield else "")
    played.mkdir(parents=True, exist_ok=True)
    parts = []
    for first in range(0, run.final_episodes, FINAL_PART):
        episodes = min(FINAL_PART, run.final_episodes - first)
        path = played / f"{first}-{episodes}.json"
        if not path.is_file():
            # The last policy, since choosing the best one would bias the result.
            outcomes = evaluate_trained(
                folder,
                "latest",
                episodes=episodes,
                seed=REPORT_SEED + first,
                threads=threads,
                shield=shield,
            )
            of_all = ("env_id", "seed", "unit", "world", "randomization")
            arrays = {k: v for k, v in vars(outcomes).items() if k not in of_all}
            with written_whole(path) as file:  # with NaN, of diverged simulations
                file.write(json.dumps(arrays, default=lambda array: array.tolist()).encode())
        parts.append(read_json(path))
    arrays = joined(parts, np.concatenate)
    assert isinstance(run.config, RunConfig)
    place = run.config.env_id, run.config.env_kwargs
    return EpisodeOutcomes(
        env_id=run.config.env_id,
        seed=REPORT_SEED,
        unit=task_and_settings(*place)[0].goal[0].unit,
        world=world_digest(*place),
        randomization=varied_in(*place),
        **arrays,
    )


def write_result(run: ExperimentRun, folder: Path, path: Path, threads: int = 1) -> dict[str, Any]:
    """Write the result of a run: its curve and, if it is finished, the final evaluation.

    The student acts without a teacher in the final evaluation, on the report seeds.

    :param run: of the grid
    :param folder: the run's own; the run may have stopped early
    :param path: of the result
    :param threads: of the simulation
    :return: the content of the file
    :raises OSError: if it cannot be written; an earlier file is then intact
    """
    assert isinstance(run.config, RunConfig)
    record = read_record(folder)
    curve = read_curve(folder)
    finished = bool(curve) and curve[-1]["steps"] >= run.config.total_steps
    final = final_outcomes(run, folder, threads).summary() if finished else None
    shielded = finished and run.shield
    values = {
        "kind": KIND,
        "name": run.name,
        "group": run.group,
        "task": run.config.env_id,
        "row": run.row,
        "seed": run.config.seed,
        "world": record.get("world"),
        "finished": finished,
        "final": final,
        "shielded": final_outcomes(run, folder, threads, shield=True).summary()
        if shielded
        else None,
        "off_protocol": off_protocol(run.config.to_mapping(), final) if finished else None,
        "teacher_steps": teacher_steps(run),
        "config": run.config.to_mapping(),
        "curve": curve,
        "sessions": record["sessions"],
        "provenance": provenance(),
    }
    write_json_atomic(path, values)
    shutil.rmtree(folder / FINAL_FOLDER, ignore_errors=True)
    return values


def teacher_steps(run: ExperimentRun) -> int | None:
    """Sum the environment steps that a run's teachers were trained for, each teacher once.

    :param run: of the grid
    :return: None if a teacher is not a weight file, whose card has them
    """
    from saver_advisors.pretrained import load_policy

    advice = run.config.advice if isinstance(run.config, RunConfig) else None
    if advice is None:
        return 0
    try:
        return sum(load_policy(name).card.steps for name in sorted(set(advice.teachers)))
    except ValueError:
        return None
