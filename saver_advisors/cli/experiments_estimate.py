"""The part of `saver experiments` that estimates how long a grid takes."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from saver_advisors.cli.arguments import write_json
from saver_advisors.reporting import tables
from saver_advisors.reporting.errors import UsageError, user_mistakes

if TYPE_CHECKING:
    from saver_advisors.experiments.grid import Grid

ESTIMATE_COLUMNS: Final[dict[str, tables.Column]] = {
    "row": lambda one: f"{one.group}: {one.row}",
    "runs": lambda one: str(one.runs),
    "steps": lambda one: f"{one.steps:,}",
    "ms a step": lambda one: f"{1000 * one.step_s:.3f}",
    "evaluation episodes": lambda one: f"{one.episodes:,}",
    "ms an episode": lambda one: f"{1000 * one.episode_s:.1f}",
    "core-hours": lambda one: f"{one.core_hours:.2f}",
}


def estimate_time(args: argparse.Namespace, grid: Grid) -> int:
    """Time each row, print the table, and write the given file.

    :param args: of ``saver experiments estimate``
    :param grid: the runs
    :return: exit status
    """
    from tqdm import tqdm

    from saver_advisors.experiments.estimate import estimate_row, rows_of
    from saver_advisors.experiments.grid import check_rows
    from saver_advisors.experiments.third_party import AlgorithmError

    with user_mistakes("argument GRID.yml"):
        check_rows(grid.runs)
    try:
        rows = [estimate_row(runs, args.steps) for runs in tqdm(rows_of(grid), unit="row")]
    except AlgorithmError as error:
        raise UsageError(f"argument GRID.yml: {error}") from error
    hours = sum(row.core_hours for row in rows)
    runs, total = len(grid.runs), sum(run.config.total_steps for run in grid.runs)
    title = f"{grid.title}: {runs:,} runs, {total:,} steps, {hours:.2f} core-hours"
    tables.show_rows(rows, ESTIMATE_COLUMNS, title)
    cells = [{**vars(row), "core_hours": row.core_hours} for row in rows]
    figures = {"kind": "estimate", "title": grid.title, "runs": runs, "steps": total}
    write_json(args.json, {**figures, "core_hours": hours, "rows": cells})
    return 0
