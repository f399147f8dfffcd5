"""Execute a grid's runs in order, in processes of this machine or on a cluster."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from saver_advisors.experiments import worker
from saver_advisors.experiments.grid import ExperimentRun, Grid
from saver_advisors.experiments.results import is_done
from saver_advisors.training.stopping import Stop

#: Seconds between two polls of the running processes.
LOOK_EVERY: Final = 0.5


@dataclass(frozen=True)
class Places:
    """The folders of a grid's runs and results.

    :param output: contains a folder per run, with its checkpoints
    :param results: contains a JSON file per run
    """

    output: Path
    results: Path

    def folder(self, run: ExperimentRun) -> Path:
        """Return the folder of a run."""
        return self.output / run.name

    def result(self, run: ExperimentRun) -> Path:
        """Return the path of a run's result."""
        return self.results / f"{run.name}.json"


RUNNING: Final = "running"
#: Exit status of a run's process -> the run's state, in words.
ENDINGS: Final = {
    worker.DONE: "done",
    worker.STOPPED: "stopped",
    worker.BUSY: "left to another process",
}


@dataclass
class Progress:
    """The present states of the runs.

    :param words: name -> ``RUNNING``, or how it ended: one of ``ENDINGS``
    :param failed: name -> last line of the log
    """

    words: dict[str, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def end(self, name: str, status: int, words: str) -> None:
        """Record how a run's process ended.

        :param name: of the run
        :param status: its exit status
        :param words: the last line of its log
        """
        if status not in ENDINGS:
            self.failed[name] = words or f"exit status {status}"
        self.words[name] = ENDINGS.get(status) or f"failed: {self.failed[name]}"


Look = Callable[[Progress], None]


class Backend(Protocol):
    """Executes runs."""

    @property
    def at_once(self) -> int:
        """How many runs it executes at the same time."""

    def work(self, runs: list[ExperimentRun], progress: Progress, stop: Stop, look: Look) -> None:
        """Execute runs until all are done or ``stop`` is set; wait for the running ones to end."""


def work_off(grid: Grid, places: Places, backend: Backend, stop: Stop, look: Look) -> Progress:
    """Execute all runs of a grid that have no complete result yet.

    :param grid: the runs, in order
    :param places: folders of runs and results, created if missing
    :param backend: executes the runs
    :param stop: when to stop
    :param look: called with the progress whenever it may have changed
    :return: the final state of the runs
    """
    places.output.mkdir(parents=True, exist_ok=True)
    places.results.mkdir(parents=True, exist_ok=True)
    waiting = [run for run in grid.runs if not is_done(places.result(run), run)]
    done = {run.name: ENDINGS[worker.DONE] for run in grid.runs if run not in waiting}
    progress = Progress(done)
    look(progress)
    backend.work(waiting, progress, stop, look)
    look(progress)
    return progress


@dataclass(frozen=True)
class LocalProcesses:
    """Execute runs in processes of this machine.

    :param places: folders of runs and results
    :param processes: number of simultaneous processes, at least 1
    :param threads: per process, one core each
    """

    places: Places
    processes: int
    threads: int = 1

    @property
    def at_once(self) -> int:
        """The number of processes."""
        return self.processes

    def work(self, runs: list[ExperimentRun], progress: Progress, stop: Stop, look: Look) -> None:
        """Keep all processes busy; send them SIGTERM on a request to stop."""
        waiting = list(runs)
        running: dict[str, tuple[ExperimentRun, subprocess.Popen[bytes]]] = {}
        asked = False
        try:
            while running or (waiting and not stop):
                while waiting and len(running) < self.processes and not stop:
                    run = waiting.pop(0)
                    folder, result = self.places.folder(run), self.places.result(run)
                    process = worker.start(run, folder, result, threads=self.threads)
                    running[run.name] = (run, process)
                    progress.words[run.name] = RUNNING
                if stop and not asked:
                    _ask_to_stop(running)
                    asked = True
                time.sleep(LOOK_EVERY)
                for name, (run, process) in list(running.items()):
                    status = process.poll()
                    if status is not None:
                        progress.end(name, status, worker.last_words(self.places.folder(run)))
                        del running[name]
                look(progress)
        finally:
            # After a second Ctrl-C the processes still write their checkpoints.
            _ask_to_stop(running)


def _ask_to_stop(running: dict[str, tuple[ExperimentRun, subprocess.Popen[bytes]]]) -> None:
    for _, process in running.values():
        if process.poll() is None:
            process.terminate()
