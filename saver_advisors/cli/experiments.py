"""Run a grid of training runs (tasks x methods x seeds), or search for settings.

A grid is a file such as zoo_configs/advising.yml. Every run writes a JSON file to the results
folder. On Ctrl-C the active runs write their checkpoints; `resume` continues all unfinished runs.
`estimate` trains each row for a short time, and computes how long the whole grid takes here.
A search shares its trials between all processes that are started with the same file and folder;
the same command continues it.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from saver_advisors.cli.arguments import (
    add,
    add_count,
    add_folder,
    add_json,
    add_seconds,
    add_threads,
)
from saver_advisors.reporting import tables
from saver_advisors.reporting.errors import UsageError, user_mistakes

if TYPE_CHECKING:
    from saver_advisors.experiments.grid import Grid
    from saver_advisors.experiments.scheduler import Backend, Places

EXAMPLES = """\
examples:
  saver experiments estimate zoo_configs/baselines.yml
  saver experiments run zoo_configs/advising.yml --output runs/advising --results results
  saver experiments run zoo_configs/advising.yml --output runs/advising --only mc-q --processes 2
  saver experiments resume runs/advising --time-limit 3600
  saver experiments status runs/advising
  saver experiments run zoo_configs/advising.yml --output /shared/runs --ray auto
  saver experiments search search.yml --output runs/search --processes 2"""

GRID_FILE: Final = "grid.yml"
PLACES_FILE: Final = "places.json"
RESULTS: Final = "results"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    run_action = actions.add_parser("run", help="start or continue a grid")
    estimate = actions.add_parser("estimate", help="say how long a grid takes on this machine")
    for action in (run_action, estimate):
        action.add_argument("grid", type=Path, metavar="GRID.yml")
    text = "least environment steps that are timed in each row, after as many of warm-up"
    add_count(estimate, "--steps", 4000, text)
    add_json(estimate)
    add_folder(run_action, "--output", "folder of the runs", required=True)
    add_folder(run_action, "--results", f"folder of the JSON files (default: DIR/{RESULTS})")
    resume = actions.add_parser("resume", help="continue a grid from its folder")
    status = actions.add_parser("status", help="show the state of every run or trial")
    search = actions.add_parser("search", help="start, join or continue a search over settings")
    search.add_argument("search", type=Path, metavar="SEARCH.yml")
    add_folder(search, "--output", "folder of the study and its runs", required=True)
    add_count(search, "--trials", None, "number of trials, in place of the file's")
    for action in (resume, status):
        action.add_argument("output", type=Path, metavar="DIR", help="that was given as --output")
    for action in (run_action, estimate, resume, status):
        text = "only runs whose names contain any of these words"
        add(action, "--only", text, [], nargs="+", action="extend", metavar="WORD")
    for action in (run_action, resume, search):
        add_count(action, "--processes", 1, "parallel runs on this machine")
        add_threads(action)
        add(action, "--ray", "run on a Ray cluster: auto, or ray://host:10001", metavar="ADDRESS")
        text = "stop after this time; active runs write their checkpoints"
        add_seconds(action, "--time-limit", text)


def run(args: argparse.Namespace) -> int:
    """Run a grid or a search, show its state, or estimate its time."""
    from saver_advisors.cli.experiments_search import holds_search, run_search, show_search
    from saver_advisors.experiments.scheduler import Places

    if args.action == "estimate":
        from saver_advisors.cli.experiments_estimate import estimate_time

        return estimate_time(args, _read_grid(args.grid, args.only))
    places = Places(args.output, args.output / RESULTS)
    if args.action == "search":
        return run_search(args, places, lambda: _backend(args, places))
    if args.action == "run" or not holds_search(args.output):
        return _run_grid(args)
    if args.action == "status":
        return show_search(places, args.only)
    raise UsageError(
        f"argument DIR: {str(args.output)!r} holds a search: the command that started it, "
        "`saver experiments search`, continues it"
    )


def _read_grid(path: Path, only: Sequence[str]) -> Grid:
    """Read the wanted runs of a grid."""
    from saver_advisors.experiments.grid import read_grid

    with user_mistakes("argument GRID.yml"):
        grid = read_grid(path)
    with user_mistakes("argument --only"):
        return grid.only(only)


def _run_grid(args: argparse.Namespace) -> int:
    """Run a grid, or show its state."""
    from saver_advisors.experiments.grid import check_rows
    from saver_advisors.experiments.progress import PROGRESS_COLUMNS, rows
    from saver_advisors.experiments.results import is_done
    from saver_advisors.experiments.scheduler import Places

    path, results = _starting_point(args)
    grid, places = _read_grid(path, args.only), Places(args.output, results)
    status = 0
    if args.action != "status":
        with user_mistakes("argument GRID.yml"):
            check_rows([run for run in grid.runs if not is_done(places.result(run), run)])
        if args.action == "run":
            _remember(args, places.results)
        status = execute(grid, places, _backend(args, places), args.time_limit)
    tables.show(PROGRESS_COLUMNS, rows(grid, places), grid.title)
    return status


def _starting_point(args: argparse.Namespace) -> tuple[Path, Path]:
    """Return the grid's file and the results folder, from the arguments or the saved state."""
    if args.action == "run":
        return args.grid, args.results or args.output / RESULTS
    try:
        places = json.loads((args.output / PLACES_FILE).read_text(encoding="utf-8"))
        return args.output / GRID_FILE, Path(places["results"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"argument DIR: {str(args.output)!r} holds no grid of `saver experiments run`"
        ) from error


def _remember(args: argparse.Namespace, results: Path) -> None:
    """Copy the grid into its folder, so that `resume` continues the same grid."""
    from saver_advisors.reporting.provenance import write_json_atomic

    with user_mistakes("argument --output"):
        args.output.mkdir(parents=True, exist_ok=True)
        (args.output / GRID_FILE).write_bytes(args.grid.read_bytes())
        write_json_atomic(args.output / PLACES_FILE, {"results": str(results.resolve())})


def execute(grid: Grid, places: Places, backend: Backend, time_limit: float | None = None) -> int:
    """Do the runs, and show their progress.

    :param grid: the runs
    :param places: folders of runs and results
    :param backend: executes the runs
    :param time_limit: seconds, or None
    :return: exit status: 0 where all are done or the time is over, 1 after a failure, 130 after
        Ctrl-C
    """
    from saver_advisors.experiments.progress import shown_progress
    from saver_advisors.experiments.scheduler import work_off
    from saver_advisors.experiments.worker import LOG_FILE
    from saver_advisors.training.stopping import Stop

    stop = Stop(time_limit)
    with stop.on_signals(), shown_progress(grid, places) as look:
        progress = work_off(grid, places, backend, stop, look)
    if progress.failed:
        for name, words in progress.failed.items():
            log = places.output / name / LOG_FILE
            print(f"saver: {name} failed: {words} (see {log})", file=sys.stderr)
        return 1
    # A requested time limit is a normal end; Ctrl-C is not.
    done = list(progress.words.values()).count("done") == len(grid.runs)
    return 0 if done or time_limit is not None else 130


def _backend(args: argparse.Namespace, places: Places) -> Backend:
    if args.ray is None:
        from saver_advisors.experiments.scheduler import LocalProcesses

        return LocalProcesses(places, args.processes, args.threads)
    from saver_advisors.experiments.cluster import RayCluster

    try:
        return RayCluster(places, args.ray, args.threads)
    except (ImportError, ConnectionError, ValueError) as error:
        raise UsageError(f"argument --ray: {' '.join(str(error).split())}") from error
