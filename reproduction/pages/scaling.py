"""Render the page about more cores, more machines and a GPU, from what was measured."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any, Final

from reproduction.page_templates import page
from reproduction.warp_models import table_of
from saver_advisors.benchmark.scaling.scaling_page import loads_of, tables
from saver_advisors.evaluation.protocol import SEEDS
from saver_advisors.experiments.training_runs import TrainingRun, read_training_runs
from saver_advisors.reporting.provenance import measured_at
from saver_advisors.reporting.tables import Column, rows_table
from saver_envs.files import read_json

#: Result files that the page needs, and the folder of the grid's runs.
FILES: Final = ("scaling", "speed", "learning", "mujoco-warp")
GRID: Final = "advising"
CORES: Final = (1, 10, 100, 1000)
TRIALS: Final = 1000
HOUR: Final = 3600.0
#: Parts of the training's time that gradient steps take.
UPDATES: Final = ("drawing and relabelling", "critics' step", "actor's step")


def _hours(name: str) -> Column:
    """Return a column of a grid's hours, and how busy the cores are."""
    return lambda row: f"{row[name][0]:,.1f} h, {row[name][1]:.0%} busy"


GRID_COLUMNS: Final[Mapping[str, Column]] = {
    "cores": "{cores:,}",
    "the grid as it was run": _hours("measured"),
    f"{SEEDS} seeds in every row": _hours("protocol"),
    f"a search of {TRIALS:,} trials": _hours("search"),
}
RUN_COLUMNS: Final[Mapping[str, Column]] = {
    "environment": "{env}",
    "simulation": "{simulation:.0%}",
    "gradient steps": "{updates:.0%}",
    "simulation on 2 threads": "{threads:.2f}x",
    "the run then": "{threaded:.2f}x",
    "if the simulation took no time": "{no_simulation:.2f}x",
    "if gradient steps took no time": "{no_updates:.2f}x",
}


def scaling_page(results: Path) -> str | None:
    """Render the page.

    :param results: folder of the result files.
    :return: Markdown; None if something that it needs has not been measured.
    """
    paths = {name: results / f"{name}.json" for name in FILES}
    if not all(path.is_file() for path in paths.values()) or not (results / GRID).is_dir():
        return None
    measured = {name: read_json(path) for name, path in paths.items()}
    runs = read_training_runs([results / GRID]).runs
    overhead = overhead_s(measured["scaling"])
    evaluations = mean(evaluation_share(row) for row in measured["learning"]["rows"])
    grids = grids_of(runs, overhead, evaluations)
    steps = [step for row in measured["mujoco-warp"]["rows"] for step in row["steps"]]
    return page(
        "scaling",
        measured=tables(measured["scaling"]),
        scaling=measured["scaling"],
        loads=loads_of(measured["scaling"]),
        overhead=overhead,
        evaluations=evaluations,
        runs=len(runs),
        rows=len(rows_of(runs)),
        seeds=SEEDS,
        trials=TRIALS,
        longest=max(grids["measured"]) / HOUR,
        mean_run=mean(grids["measured"]) / HOUR,
        grid=rows_table([grid_row(grids, cores) for cores in CORES], GRID_COLUMNS),
        parts=rows_table(run_rows(measured["learning"], measured["speed"]), RUN_COLUMNS),
        models=measured["mujoco-warp"]["rows"],
        qpos=max((step["qpos_difference"] for step in steps), default=0.0),
        qvel=max((step["qvel_difference"] for step in steps), default=0.0),
        warp=table_of(measured["mujoco-warp"]),
        origins={name: measured_at(one) for name, one in measured.items()},
    )


def overhead_s(scaling: Mapping[str, Any]) -> float:
    """Return the seconds per run in which a node of the largest cluster did not train it.

    :param scaling: what ``saver benchmark scaling`` measured.
    """
    row = max(scaling["rows"], key=lambda one: (one["backend"] == "ray", one["workers"]))
    return float(row["idle_s"] + row["starting_s"])


def evaluation_share(row: Mapping[str, Any]) -> float:
    """Return the time of evaluations in proportion to that of training.

    :param row: of an environment, of ``python -m reproduction learning``.
    """
    seconds = row["parts"]["evaluations"]
    return float(seconds / (row["total"] - seconds))


def rows_of(runs: Sequence[TrainingRun]) -> list[list[TrainingRun]]:
    """Group runs that differ in their seed alone."""
    found: dict[tuple[str, str | None, str], list[TrainingRun]] = {}
    for run in runs:
        found.setdefault((run.task, run.group, run.row), []).append(run)
    return list(found.values())


def grids_of(
    runs: Sequence[TrainingRun], overhead: float, evaluations: float
) -> dict[str, list[float]]:
    """Return the durations (s) of the runs of three grids.

    :param runs: of a grid, whose training was timed.
    :param overhead: seconds per run in which it does not train.
    :param evaluations: time of evaluations in proportion to that of training.
    :return: ``measured``, those runs; ``protocol``, with the protocol's seeds in every row, where a
        further seed takes as long as the mean of its row; ``search``, trials of one mean run.
    """

    def seconds(run: TrainingRun) -> float:
        assert run.curve.seconds is not None
        return overhead + (1.0 + evaluations) * float(run.curve.seconds[-1])

    measured = [seconds(run) for run in runs]
    protocol = []
    for row in rows_of(runs):
        known = [seconds(run) for run in row][:SEEDS]
        protocol += known + [mean(known)] * (SEEDS - len(known))
    search = [mean(measured)] * TRIALS
    return {"measured": measured, "protocol": protocol, "search": search}


def grid_row(grids: Mapping[str, Sequence[float]], cores: int) -> dict[str, Any]:
    """Return how long each grid takes on a number of cores, and the share of them that is busy.

    :param grids: durations (s) of runs, by name of the grid.
    :param cores: that each execute one run at a time.
    :return: ``cores``, and hours and share by name.
    """
    row: dict[str, Any] = {"cores": cores}
    for name, durations in grids.items():
        end = makespan(durations, cores)
        row[name] = end / HOUR, sum(durations) / (cores * end)
    return row


def makespan(durations: Iterable[float], cores: int) -> float:
    """Return when the last run ends if each one begins, in order, on the first free core.

    :param durations: (s) of the runs.
    :param cores: number of cores.
    """
    free = [0.0] * cores
    for duration in durations:
        heapq.heappush(free, heapq.heappop(free) + duration)
    return max(free)


def run_rows(learning: Mapping[str, Any], speed: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return, by environment, the parts of a run's time and what less of them would give.

    :param learning: what ``python -m reproduction learning`` measured.
    :param speed: what ``saver benchmark speed`` measured.
    :return: shares of ``simulation`` and ``updates``; the gain of the simulation from two
        ``threads``; and of the whole run from those (``threaded``), and if either took no time.
    """
    gains = {
        (row["env"], row["n_envs"]): row["speed_up_of_threads"]
        for row in speed["rows"]
        if row["threads"] == 2
    }
    rows = []
    for row in learning["rows"]:
        shares = {name: part / row["total"] for name, part in row["parts"].items()}
        simulation, updates = shares["simulation"], sum(shares[name] for name in UPDATES)
        threads = gains[row["env"], row["n_envs"]]
        rows.append(
            {
                "env": row["env"],
                "simulation": simulation,
                "updates": updates,
                "threads": threads,
                "threaded": faster(simulation, threads),
                "no_simulation": faster(simulation, float("inf")),
                "no_updates": faster(updates, float("inf")),
            }
        )
    return rows


def faster(share: float, times: float) -> float:
    """Return how many times as fast the whole is if a part is so many times as fast (Amdahl).

    :param share: of the part in the time of the whole.
    :param times: how many times as fast the part becomes.
    """
    return 1.0 / (1.0 - share + share / times)
