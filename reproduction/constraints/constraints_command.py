"""Compare variants, ablations and safe algorithms for learning under a constraint (chapter 6).

The command reads the JSON files of training runs on the distance task, those of the grid and those
of `saver benchmark run`, and evaluates the dissertation's findings on them.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from reproduction.command_parts import add_result_arguments, comparison_figures, write_comparison
from saver_advisors.cli.measured import read_training

if TYPE_CHECKING:
    from saver_advisors.experiments.summary import MethodRow
    from saver_advisors.experiments.training_runs import Results

EXAMPLES: Final = """\
examples:
  python -m reproduction constraints                            of docs/results/constraints
  python -m reproduction constraints --results docs/results/constraints \\
      --table docs/constraints-results.md --figures docs/results/constraints \\
      --json docs/results/constraints.json"""

TASK: Final = "DualJacoDistance-v0"
RESULTS: Final = Path("docs/results/constraints")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_result_arguments(parser, RESULTS)


def run(args: argparse.Namespace) -> int:
    """Read and summarise runs, print tables, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: if there is no run on the distance task.
    """
    from reproduction.constraints.constraints_page import (
        comparison_page,
        draw_all,
        evaluated,
        flat_row,
        show_all,
    )
    from saver_advisors.reporting.errors import UsageError

    results = read_training(args.results)
    rows = table(results)
    if not rows:
        others = ", ".join(sorted({one.task for one in results.runs}))
        raise UsageError(f"argument --results: no run of {TASK} there, only of {others}")
    findings = evaluated(rows)
    show_all(rows, findings, results)
    figures: dict[str, Any] = {
        "title": "Learning under a constraint",
        "kind": "constraints",
        "task": TASK,
        **comparison_figures(rows, [flat_row(row) for row in rows], findings, results),
    }
    return write_comparison(
        args,
        figures,
        lambda folder: draw_all(rows, folder),
        lambda pictures: comparison_page(rows, findings, results, pictures),
    )


def table(results: Results) -> list[MethodRow]:
    """Summarise the runs of the distance task.

    :param results: what was read.
    :return: the rows, those with the highest success first and those without a finished run last.
    """
    from saver_advisors.experiments.summary import summarize

    def success(row: MethodRow) -> float:
        return -1.0 if row.final_success is None else row.final_success.value

    return sorted(summarize(TASK, results.of_task(TASK)), key=success, reverse=True)
