"""Execute the trials of a search, each as runs of a grid, in processes here or on a cluster."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from optuna.trial import FrozenTrial, TrialState

from saver_advisors.experiments.grid import ExperimentRun
from saver_advisors.experiments.results import is_done, read_result, state_of
from saver_advisors.experiments.scheduler import LOOK_EVERY, RUNNING, Backend, Places, Progress
from saver_advisors.experiments.study import ClaimedTrial, SharedStudy, trial_name
from saver_advisors.training.stopping import Stop

Tell = Callable[[str, str], None]
"""Receives the name of a trial and its new state."""
COLUMNS: Final = ("trial", "state", "value", "steps")


class TrialStop(Stop):
    """A request to stop one trial: that of the whole search, or the pruner's.

    :param search: the request to stop the search
    """

    def __init__(self, search: Stop) -> None:
        super().__init__()
        self._search = search
        self.pruned = False

    def __bool__(self) -> bool:
        return self.pruned or bool(self._search)


@dataclass
class TrialWorker:
    """Work off the trials of a study that other processes may work on too.

    :param study: of the search
    :param places: folders of runs and results
    :param backend: executes the runs
    :param stop: when to stop; the active runs write their checkpoints
    :param tell: called when a trial starts and ends
    """

    study: SharedStudy
    places: Places
    backend: Backend
    stop: Stop
    tell: Tell
    failed: dict[str, str] = field(default_factory=dict)
    """Trial -> last line of its log; the next session tries it again."""
    _tried: set[int] = field(default_factory=set)

    def work_off(self) -> None:
        """Execute trials until there are enough, as many at once as the backend has places."""
        self.places.output.mkdir(parents=True, exist_ok=True)
        self.places.results.mkdir(parents=True, exist_ok=True)
        slots = self.backend.at_once
        with ThreadPoolExecutor(slots) as pool:
            for future in [pool.submit(self._take_trials) for _ in range(slots)]:
                future.result()

    def _take_trials(self) -> None:
        while not self.stop:
            with self.study.claimed(self._tried) as trial:
                if trial is None:
                    return
                self._try(trial)

    def _try(self, trial: ClaimedTrial) -> None:
        """Execute the runs of a trial one after another, and record its value."""
        search = self.study.search
        shown = ", ".join(f"{one.name}={trial.values[one.name]!r}" for one in search.space)
        self.tell(trial.name, f"{RUNNING} with {shown}")
        try:
            runs = search.runs(trial.name, trial.values)
        except (TypeError, ValueError) as error:  # values that do not fit together
            self.study.tell(trial, None, TrialState.FAIL)
            self._fail(trial, str(error))
            return
        stop = TrialStop(self.stop)
        for run in runs:
            # Its first seed alone decides whether a trial ends early: it is the first to be known.
            look = partial(self._report, trial, run, stop) if run is runs[0] else _ignore
            failure = self._execute(run, stop, look)
            if failure is not None:
                self._fail(trial, failure)
                return
            if stop.pruned:
                self.study.tell(trial, None, TrialState.PRUNED)
                self.tell(trial.name, "pruned")
                return
            if not is_done(self.places.result(run), run):
                self.tell(trial.name, "stopped")
                return
        curves = [read_result(self.places.result(run))["curve"] for run in runs]
        value = sum(map(search.objective.of_run, curves)) / len(curves)
        self.study.tell(trial, value, TrialState.COMPLETE)
        self.tell(trial.name, f"done: {search.objective.text(value)}")

    def _execute(
        self, run: ExperimentRun, stop: TrialStop, look: Callable[[Progress], None]
    ) -> str | None:
        """Execute a run until it is done or stopped; return the last line of the log of a failure.

        A process of an earlier session may still write its checkpoint: it is waited for.
        """
        result = self.places.result(run)
        while not is_done(result, run) and not stop:
            progress = Progress()
            self.backend.work([run], progress, stop, look)
            if progress.failed:
                return progress.failed[run.name]
            if not is_done(result, run) and not stop:
                time.sleep(LOOK_EVERY)
        look(Progress())
        return None

    def _report(
        self, trial: ClaimedTrial, run: ExperimentRun, stop: TrialStop, progress: Progress
    ) -> None:
        """Report new evaluations to the study, and stop the trial if it is one to prune."""
        curve = state_of(run, self.places.folder(run), self.places.result(run)).curve
        for point in curve:
            steps = int(point["steps"])
            if steps not in trial.reported:
                trial.optuna_trial.report(self.study.search.objective.midway(point), steps)
                trial.reported.add(steps)
        ended = bool(curve) and curve[-1]["steps"] >= run.config.total_steps
        if curve and not ended and not stop and trial.optuna_trial.should_prune():
            stop.pruned = True

    def _fail(self, trial: ClaimedTrial, words: str) -> None:
        self._tried.add(trial.number)
        self.failed[trial.name] = words
        self.tell(trial.name, f"failed: {words}")


def _ignore(progress: Progress) -> None:
    """Do nothing while the other seeds of a trial run."""


def trial_rows(study: SharedStudy, places: Places) -> list[list[str]]:
    """Return a row of cells per trial: ``COLUMNS``, then the settings of the space.

    :param study: of the search
    :param places: folders of runs and results
    """

    def row(trial: FrozenTrial) -> list[str]:
        name, values = trial_name(trial.number), study.values_of(trial)
        steps = 0
        with suppress(TypeError, ValueError):  # values that do not fit together have no runs
            for run in study.search.runs(name, values):
                steps += state_of(run, places.folder(run), places.result(run)).steps
        value = trial.value if trial.state is TrialState.COMPLETE else None
        cells = [name, study.state_of(trial), study.search.objective.text(value), f"{steps:,}"]
        return cells + [_shown(values.get(one.name, "-")) for one in study.search.space]

    return [row(trial) for trial in study.trials]


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
