"""Execute small grids on 1, 2, ... workers, and time where their time goes."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import mean, median
from typing import Any, Final

from saver_advisors.benchmark.machine import timed
from saver_advisors.experiments import worker
from saver_advisors.experiments.cluster import RayCluster, local_cluster
from saver_advisors.experiments.grid import ExperimentRun, Grid, run_of_row
from saver_advisors.experiments.results import read_result
from saver_advisors.experiments.scheduler import Backend, LocalProcesses, Places, work_off
from saver_advisors.training.checkpoint import load_checkpoint, save_checkpoint
from saver_advisors.training.launch import open_run
from saver_advisors.training.run_folder import RECORD_FILE
from saver_advisors.training.settings import RunConfig
from saver_advisors.training.stopping import Stop

PROCESSES, RAY = "processes", "ray"
BACKENDS: Final = (PROCESSES, RAY)
#: Episodes of the only evaluation and of the last policy: the training is what is timed.
EPISODES: Final = 10


def timed_grid(env_id: str, steps: int, runs: int) -> Grid:
    """Return a grid of runs that differ in their seed, with an environment's default settings.

    :param env_id: its id
    :param steps: of each run
    :param runs: number of runs
    """
    settings = {"total_steps": steps, "eval_every": steps, "eval_episodes": EPISODES}

    def run(seed: int) -> ExperimentRun:
        labels = {"name": f"seed{seed}", "group": "scaling", "row": "timed"}
        return run_of_row(labels, {"env_id": env_id}, {"settings": settings}, seed, EPISODES)

    return Grid("Scaling", tuple(map(run, range(runs))))


def scaling_row(backend: str, workers: int, grid: Grid, folder: Path) -> dict[str, Any]:
    """Execute a grid on a number of workers.

    :param backend: ``processes`` of this machine, or ``ray``, a cluster of nodes with a processor
        each that is started here
    :param workers: number of processes or nodes
    :param grid: of equal runs
    :param folder: of the runs, new
    :return: ``seconds`` of the grid, ``runs_per_hour``, and in seconds, medians over the runs:
        ``placing_s`` from submitting a run that does not wait to its first step, ``starting_s``,
        the part from the start of its process, ``training_s``, and ``process_s``, the whole
        process; and ``idle_s``, the mean time per run in which a worker had no process
    :raises RuntimeError: if a run fails
    """
    places = Places(folder, folder / "results")
    with _backend(backend, workers, places) as chosen:
        submitted = time.time()
        progress = work_off(grid, places, chosen, Stop(), lambda _: None)
        seconds = time.time() - submitted
    if progress.failed:
        raise RuntimeError(f"runs failed: {progress.failed}")
    began = {run.name: _written(places.folder(run) / worker.RUN_FILE) for run in grid.runs}
    stepped = {run.name: _written(places.folder(run) / RECORD_FILE) for run in grid.runs}
    ended = {run.name: _written(places.result(run)) for run in grid.runs}
    # Ray places runs in any order: those that did not wait are the first to begin.
    at_once = sorted(began, key=lambda name: began[name])[:workers]
    whole = [ended[name] - began[name] for name in began]
    lasts = [read_result(places.result(run))["curve"][-1] for run in grid.runs]
    return {
        "backend": backend,
        "workers": workers,
        "runs": len(grid.runs),
        "seconds": seconds,
        "runs_per_hour": 3600 * len(grid.runs) / seconds,
        "placing_s": median(stepped[name] - submitted for name in at_once),
        "starting_s": median(stepped[name] - began[name] for name in began),
        "training_s": median(point["wall_clock_s"] for point in lasts),
        "training_processor_s": median(point["processor_s"] for point in lasts),
        "process_s": median(whole),
        "idle_s": workers * seconds / len(grid.runs) - mean(whole),
    }


def with_efficiency(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Add to each row its ``efficiency``, and the share of the loss that the processor explains.

    ``efficiency`` is the runs per hour and worker relative to the row of the same backend with the
    fewest workers, and ``processor_speed`` is that row's processor time of a run's training
    relative to this row's: hardware threads that share a core are slower together, whoever places
    the runs. Time in which other processes have the processor lowers the first, and not the second.

    :param rows: of ``scaling_row``
    """
    found = []
    for row in rows:
        same = (one for one in rows if one["backend"] == row["backend"])
        first = min(same, key=lambda one: one["workers"])
        per_worker = [one["runs_per_hour"] / one["workers"] for one in (row, first)]
        speed = first["training_processor_s"] / row["training_processor_s"]
        row = {**row, "efficiency": per_worker[0] / per_worker[1], "processor_speed": speed}
        found.append(row)
    return found


def resuming_s(run: ExperimentRun, places: Places) -> float:
    """Resume a finished run for another step, and return the seconds from its process to that step.

    :param run: of a grid
    :param places: where it has been executed
    :raises RuntimeError: if it fails
    """
    assert isinstance(run.config, RunConfig)
    longer = replace(run, config=replace(run.config, total_steps=run.config.total_steps + 1))
    folder = places.folder(run)
    if worker.start(longer, folder, places.result(run)).wait() != worker.DONE:
        raise RuntimeError(f"the resumed run failed: {worker.last_words(folder)}")
    return _written(folder / RECORD_FILE) - _written(folder / worker.RUN_FILE)


def checkpoint_row(run: ExperimentRun, folder: Path, rounds: int) -> dict[str, Any]:
    """Time checkpoints of a run with a full replay.

    :param run: of a grid
    :param folder: of its files, new
    :param rounds: number of checkpoints written and read
    :return: ``transitions`` in the replay, ``megabytes`` of the checkpoint, and the medians
        ``writing_s`` and ``reading_s``
    """
    assert isinstance(run.config, RunConfig)
    written, read = [], []
    with open_run(run.config, folder) as opened:
        replay = opened.model.replay_buffer
        replay.full, replay.pos = True, 0  # of zeros: they take as much time and space as others
        for _ in range(rounds):
            written.append(timed(lambda: save_checkpoint(folder / "latest", opened.model, {})))
            read.append(timed(lambda: load_checkpoint(folder / "latest", opened.model)))
    size = sum(path.stat().st_size for path in (folder / "latest").iterdir())
    return {
        "env": run.config.env_id,
        "transitions": run.config.buffer_size,
        "megabytes": size / 1e6,
        "writing_s": median(written),
        "reading_s": median(read),
        "every_steps": run.config.checkpoint_every,
    }


@contextmanager
def _backend(name: str, workers: int, places: Places) -> Iterator[Backend]:
    """Provide a backend; a cluster lives as long as the context."""
    with ExitStack() as stack:
        if name == PROCESSES:
            yield LocalProcesses(places, workers)
        else:
            yield RayCluster(places, stack.enter_context(local_cluster(workers)))


def _written(path: Path) -> float:
    """Return when a file was written last (s)."""
    return path.stat().st_mtime
