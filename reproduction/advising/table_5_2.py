"""Table 5.2 of the dissertation beside our runs: every strategy, and which findings hold.

Reads the JSON files of finished and unfinished training runs; files that are cut short are named
and left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.benchmark.run_tables import flat
from saver_advisors.cli.result_files import add_result_arguments, read

if TYPE_CHECKING:
    from reproduction.findings import Finding
    from saver_advisors.experiments.summary import MethodRow
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
    """Read, sum up, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from reproduction.advising.advising_page import page, show
    from reproduction.advising.figures import draw_all
    from saver_advisors.cli.arguments import write_json

    results = read(args.results)
    tasks = tables(results)
    findings = judge_all(tasks)
    show(tasks, findings, results)
    write_json(args.json, figures(tasks, findings, results))  # before what changes the checkout
    drawn = [] if args.figures is None else draw_all(results, args.figures)
    if args.table is not None:
        text = page(tasks, findings, results, drawn, args.table.parent)
        args.table.write_text(text, encoding="utf-8")
        print(f"wrote {args.table}")
    return 0


def tables(results: Results) -> dict[str, list[MethodRow]]:
    """The rows of every task, the paper's tasks and the paper's rows first.

    :param results: of the files
    :return: rows by environment
    """
    from reproduction.advising.paper import table_5_2
    from saver_advisors.experiments.summary import summarize

    paper = table_5_2()
    found = {run.task for run in results.runs}
    order = [env for env in paper.tasks.values() if env in found]
    order += sorted(found - set(order))
    return {task: summarize(task, results.of_task(task), list(paper.labels)) for task in order}


def judge_all(tasks: dict[str, list[MethodRow]]) -> list[Finding]:
    """Every finding of the paper's about a task that there are runs of.

    :param tasks: as ``tables`` returns them
    :return: the findings
    """
    from reproduction.advising.paper import table_5_2
    from reproduction.findings import claims, judge, table_of

    paper = table_5_2()
    return [
        judge(claim, table_of(tasks[paper.tasks[claim.task]]))
        for claim in claims(list(paper.labels))
        if paper.tasks[claim.task] in tasks
    ]


def figures(
    tasks: dict[str, list[MethodRow]], findings: Sequence[Finding], results: Results
) -> dict[str, Any]:
    """Everything that was computed, for JSON.

    :param tasks: as ``tables`` returns them
    :param findings: as ``judge_all`` does
    :param results: of the files
    :return: ``rows`` is a flat table, ``detail`` has intervals
    """
    from saver_advisors.evaluation.metrics import EPOCH_STEPS, SOLVED

    rows = [row for rows in tasks.values() for row in rows]
    return {
        "title": "Advising",
        "kind": "advising",
        "epoch_steps": EPOCH_STEPS,
        "solved_at": SOLVED,
        "rows": [flat(row) for row in rows],
        "detail": [row.to_mapping() for row in rows],
        "findings": [finding.to_mapping() for finding in findings],
        "skipped": [{"file": one.file, "reason": one.reason} for one in results.skipped],
    }
