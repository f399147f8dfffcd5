"""Compare advising strategies with Table 5.2 of the dissertation, and evaluate its findings.

The command reads the JSON files of finished and unfinished training runs. Files that are cut short
are listed and left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from reproduction.advising.advising_page import comparison_page, draw_all, show_all
from reproduction.advising.paper import table_5_2
from reproduction.command_parts import add_result_arguments, comparison_figures, write_comparison
from reproduction.findings import Finding, claims, evaluate_claim, table_of
from saver_advisors.benchmark.run_tables import flat
from saver_advisors.cli.measured import read_training
from saver_advisors.evaluation.metrics import EPOCH_STEPS, SOLVED
from saver_advisors.experiments.summary import MethodRow, summarize
from saver_advisors.experiments.training_runs import Results

EXAMPLES: Final = """\
examples:
  python -m reproduction advising                               of docs/results/advising
  python -m reproduction advising --results docs/results/advising docs/results/teachers.json \\
      --table docs/advising-results.md --figures docs/results/advising \\
      --json docs/results/advising.json"""

RESULTS: Final = Path("docs/results/advising")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_result_arguments(parser, RESULTS)


def run(args: argparse.Namespace) -> int:
    """Read and summarise runs, print tables, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: if there is no training run.
    """
    results = read_training(args.results)
    tasks = tables(results)
    findings = evaluate_findings(tasks)
    show_all(tasks, findings, results)
    return write_comparison(
        args,
        figures(tasks, findings, results),
        lambda folder: draw_all(results, folder),
        lambda pictures: comparison_page(tasks, findings, results, pictures),
    )


def tables(results: Results) -> dict[str, list[MethodRow]]:
    """Summarise the runs of every task, the paper's tasks and the paper's rows first.

    :param results: what was read.
    :return: rows by environment id.
    """
    paper = table_5_2()
    found = {run.task for run in results.runs}
    order = [env for env in paper.tasks.values() if env in found]
    order += sorted(found - set(order))
    return {task: summarize(task, results.of_task(task), paper.rows) for task in order}


def evaluate_findings(tasks: Mapping[str, Sequence[MethodRow]]) -> list[Finding]:
    """Evaluate the paper's claims about the tasks that were run.

    :param tasks: see :func:`tables`.
    :return: the findings.
    """
    paper = table_5_2()
    return [
        evaluate_claim(claim, table_of(tasks[paper.tasks[claim.task]]))
        for claim in claims(paper.rows)
        if paper.tasks[claim.task] in tasks
    ]


def figures(
    tasks: Mapping[str, Sequence[MethodRow]], findings: Sequence[Finding], results: Results
) -> dict[str, Any]:
    """Collect everything that was computed, for JSON.

    :param tasks: see :func:`tables`.
    :param findings: the paper's findings, evaluated.
    :param results: what was read.
    :return: ``rows`` is a flat table, ``detail`` has intervals.
    """
    rows = [row for rows in tasks.values() for row in rows]
    told = [finding.to_mapping() for finding in findings]
    return {
        "title": "Advising",
        "kind": "advising",
        "epoch_steps": EPOCH_STEPS,
        "solved_at": SOLVED,
        **comparison_figures(rows, [flat(row) for row in rows], told, results),
    }
