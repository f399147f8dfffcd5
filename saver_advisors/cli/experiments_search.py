"""The parts of `saver experiments` that run and show a search over settings."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from saver_advisors.reporting import tables
from saver_advisors.reporting.errors import user_mistakes

if TYPE_CHECKING:
    from saver_advisors.experiments.scheduler import Backend, Places
    from saver_advisors.experiments.study import SharedStudy


def holds_search(folder: Path) -> bool:
    """Return whether a folder is that of a search."""
    from saver_advisors.experiments.search import JOURNAL_FILE

    return (folder / JOURNAL_FILE).is_file()


def run_search(args: argparse.Namespace, places: Places, backend: Callable[[], Backend]) -> int:
    """Start, join or continue a search, and show its trials.

    :param args: of ``saver experiments search``
    :param places: folders of runs and results
    :param backend: creates what executes the runs
    :return: exit status: 0 where all trials are done or the time is over, 1 after a failure, 130
        after Ctrl-C
    """
    from saver_advisors.experiments.search import check_search, read_search
    from saver_advisors.experiments.study import SharedStudy
    from saver_advisors.experiments.trials import TrialWorker
    from saver_advisors.training.stopping import Stop

    with user_mistakes("argument SEARCH.yml"):
        search = read_search(args.search, args.trials)
        check_search(search)
        study = SharedStudy(places.output, search)
    stop = Stop(args.time_limit)
    worker = TrialWorker(study, places, backend(), stop, _tell)
    with stop.on_signals():
        worker.work_off()
    _show(study, places)
    for name, words in worker.failed.items():
        print(f"saver: {name} failed: {words} (see its log in {places.output})", file=sys.stderr)
    if worker.failed:
        return 1
    return 130 if stop and args.time_limit is None else 0


def show_search(places: Places, only: Sequence[str]) -> int:
    """Show the trials of a search.

    :param places: folders of runs and results
    :param only: words of which a shown trial's name contains one; none shows all
    :return: exit status
    """
    from saver_advisors.experiments.study import open_study

    with user_mistakes("argument DIR"):
        study = open_study(places.output)
    _show(study, places, only)
    return 0


def _show(study: SharedStudy, places: Places, only: Sequence[str] = ()) -> None:
    from saver_advisors.experiments.trials import COLUMNS, trial_rows

    columns = [*COLUMNS, *(one.name for one in study.search.space)]
    rows = trial_rows(study, places)
    shown = [row for row in rows if not only or any(word in row[0] for word in only)]
    tables.show(
        columns, shown, f"{study.search.title}: {len(rows)} of {study.search.trials} trials"
    )
    if (best := study.best) is not None:
        values = ", ".join(f"{name}={value}" for name, value in study.values_of(best).items())
        print(f"best: {study.search.objective.text(best.value)} with {values}")


def _tell(name: str, words: str) -> None:
    print(f"{time.strftime('%H:%M:%S')}  {name}  {words}", flush=True)
