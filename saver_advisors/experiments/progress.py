"""Show the state of a grid's runs on the terminal, during their execution or afterwards."""

from __future__ import annotations

import sys
import time
from typing import Any, Final

from saver_advisors.experiments.grid import Grid
from saver_advisors.experiments.results import RunState, state_of
from saver_advisors.experiments.scheduler import RUNNING, Places, Progress

PROGRESS_COLUMNS: Final = ("run", "state", "steps", "of", "success", "best", "minutes")
#: Seconds between two updates, since every update reads the curves.
DRAW_EVERY: Final = 2.0


def rows(grid: Grid, places: Places, progress: Progress | None = None) -> list[list[str]]:
    """Return one row of cells per run, in the order of ``PROGRESS_COLUMNS``.

    :param grid: the runs
    :param places: their folders
    :param progress: of the present execution, if any
    """
    table = []
    for run in grid.runs:
        state = state_of(run, places.folder(run), places.result(run))
        total = f"{run.config.total_steps:,}"
        table.append([run.name, _word(run.name, state, progress), *_figures(state, total)])
    return table


def _word(name: str, state: RunState, progress: Progress | None) -> str:
    word = "" if progress is None else progress.words.get(name, "")
    if word == RUNNING:
        return RUNNING if state.state in ("waiting", "started") else f"{RUNNING} {state.state}"
    return word if word.startswith(("failed", "left")) else state.state


def _figures(state: RunState, total: str) -> list[str]:
    steps = f"{state.steps:,}"
    if not state.curve:
        return [steps, total, "-", "-", "-"]
    rates = [point["success_rate"] for point in state.curve]
    minutes = state.curve[-1]["wall_clock_s"] / 60
    return [steps, total, f"{rates[-1]:.2f}", f"{max(rates):.2f}", f"{minutes:.1f}"]


class ProgressTable:
    """Update a table in place on a terminal; elsewhere, print a line for each change of state.

    :param grid: the runs
    :param places: their folders
    """

    def __init__(self, grid: Grid, places: Places) -> None:
        self.grid = grid
        self.places = places
        self._words: dict[str, str] = {}
        self._drawn_at = 0.0
        self._live: Any = None

    def __enter__(self) -> ProgressTable:
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(refresh_per_second=1)
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.stop()

    def look(self, progress: Progress) -> None:
        """Show the present state.

        :param progress: of the execution
        """
        now = time.monotonic()
        if self._live is None:
            self._tell_changes(progress)
        elif now - self._drawn_at >= DRAW_EVERY:
            from saver_advisors.reporting.tables import table

            self._live.update(table(PROGRESS_COLUMNS, rows(self.grid, self.places, progress)))
            self._drawn_at = now

    def _tell_changes(self, progress: Progress) -> None:
        for run in self.grid.runs:
            word = progress.words.get(run.name, "waiting")
            if word != self._words.get(run.name, "waiting"):
                print(f"{time.strftime('%H:%M:%S')}  {run.name}  {word}", flush=True)
        self._words = dict(progress.words)
