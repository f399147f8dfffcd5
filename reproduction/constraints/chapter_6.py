"""Learning under a constraint (chapter 6): variants, ablations and safe algorithms side by side.

Reads the JSON files of training runs on the distance task, of the stages' grid and of
`saver benchmark run` alike, and tells which of the dissertation's findings hold.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli.result_files import add_result_arguments, read

if TYPE_CHECKING:
    from reproduction.constraints.constraints_findings import ConstraintFinding
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
    """Read, sum up, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from reproduction.constraints.constraints_findings import judge_all
    from reproduction.constraints.constraints_page import draw_all, page, show
    from saver_advisors.cli.arguments import write_json
    from saver_advisors.reporting.errors import UsageError

    results = read(args.results)
    rows = table(results)
    if not rows:
        others = ", ".join(sorted({one.task for one in results.runs}))
        raise UsageError(f"argument --results: no run of {TASK} there, only of {others}")
    findings = judge_all(rows)
    show(rows, findings, results)
    write_json(args.json, figures(rows, findings, results))  # before what changes the checkout
    drawn = [] if args.figures is None else draw_all(rows, args.figures)
    if args.table is not None:
        text = page(rows, findings, results, drawn, args.table.parent)
        args.table.write_text(text, encoding="utf-8")
        print(f"wrote {args.table}")
    return 0


def table(results: Results) -> list[MethodRow]:
    """The rows of the distance task, those with the highest success first.

    :param results: of the files
    :return: the rows; those without a finished run last
    """
    from saver_advisors.experiments.summary import summarize

    def success(row: MethodRow) -> float:
        return -1.0 if row.final_success is None else row.final_success.value

    return sorted(summarize(TASK, results.of_task(TASK)), key=success, reverse=True)


def figures(
    rows: Sequence[MethodRow], findings: Sequence[ConstraintFinding], results: Results
) -> dict[str, Any]:
    """Everything that was computed, for JSON.

    :param rows: as ``table`` returns them
    :param findings: of the dissertation
    :param results: of the files
    :return: ``rows`` is a flat table
    """
    from reproduction.constraints.constraints_page import RATES, final_rate

    flat = []
    for row in rows:
        one: dict[str, Any] = {"row": row.name, "n": row.n}
        for name in RATES:
            rate = final_rate(row, name)
            one[name] = None if rate is None else rate.to_mapping()
        flat.append(one)
    return {
        "title": "Learning under a constraint",
        "kind": "constraints",
        "task": TASK,
        "rows": flat,
        "detail": [row.to_mapping() for row in rows],
        "findings": [finding.to_mapping() for finding in findings],
        "skipped": [{"file": one.file, "reason": one.reason} for one in results.skipped],
    }
