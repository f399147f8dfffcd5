"""Show the state of a grid's runs on the terminal, during their execution or afterwards."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from saver_advisors.experiments.grid import Grid
from saver_advisors.experiments.results import state_of
from saver_advisors.experiments.scheduler import RUNNING, Look, Places, Progress

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
        figures = ["-", "-", "-"]
        if state.curve:
            rates = [point["success_rate"] for point in state.curve]
            minutes = state.curve[-1]["wall_clock_s"] / 60
            figures = [f"{rates[-1]:.2f}", f"{max(rates):.2f}", f"{minutes:.1f}"]
        word = _word("" if progress is None else progress.words.get(run.name, ""), state.state)
        steps = [f"{state.steps:,}", f"{run.config.total_steps:,}"]
        table.append([run.name, word, *steps, *figures])
    return table


def _word(word: str, state: str) -> str:
    """Combine how the execution goes and what the files show."""
    if word == RUNNING:
        return RUNNING if state in ("waiting", "started") else f"{RUNNING} {state}"
    return word if word.startswith(("failed", "left")) else state


@contextmanager
def shown_progress(grid: Grid, places: Places) -> Iterator[Look]:
    """Update a table in place on a terminal; elsewhere, print a line for each change of state.

    :param grid: the runs
    :param places: their folders
    :return: a context with a function that shows the present state
    """
    if not sys.stdout.isatty():
        known: dict[str, str] = {}
        yield lambda progress: _tell_changes(known, progress)
        return
    from rich.live import Live

    from saver_advisors.reporting.tables import table

    drawn_at = 0.0

    def draw(progress: Progress) -> None:
        nonlocal drawn_at
        if time.monotonic() - drawn_at >= DRAW_EVERY:
            live.update(table(PROGRESS_COLUMNS, rows(grid, places, progress)))
            drawn_at = time.monotonic()

    with Live(refresh_per_second=1) as live:
        yield draw


def _tell_changes(known: dict[str, str], progress: Progress) -> None:
    """Print the states that are not known yet, and remember them."""
    for name, word in progress.words.items():
        if word != known.get(name):
            print(f"{time.strftime('%H:%M:%S')}  {name}  {word}", flush=True)
    known.update(progress.words)
