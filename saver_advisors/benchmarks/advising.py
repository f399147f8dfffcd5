"""Table 5.2 of the dissertation beside our runs: every strategy, and which findings hold.

Reads the JSON files of finished and unfinished training runs; files that are cut short are named
and left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from saver_advisors.evaluation.findings import Finding
    from saver_advisors.evaluation.summary import Row
    from saver_advisors.evaluation.training_runs import Results

EXAMPLES: Final = """\
examples:
  saver benchmark advising                               of docs/results/advising
  saver benchmark advising --results docs/results/advising docs/results/teachers.json \\
      --table docs/advising-results.md --figures docs/results/advising \\
      --json docs/results/advising.json"""

NO_ADVICE: Final = "none"
RESULTS: Final = Path("docs/results/advising")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_result_arguments(parser, RESULTS)


def add_result_arguments(parser: argparse.ArgumentParser, results: Path) -> None:
    """``--results``, ``--table``, ``--figures`` and ``--json``, of what is told from runs' files.

    :param parser: gets them
    :param results: the folder that is read by default
    """
    from saver_advisors.cli.arguments import add_json, add_table

    parser.add_argument(
        "--results",
        nargs="+",
        type=Path,
        default=[results],
        metavar="PATH",
        help="folders of result files, and such files: training runs, the figures of `saver "
        f"curves`, evaluations of policies to stand beside them (default: {results})",
    )
    add_table(parser)
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="draw the figures there, made if need be"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Read, sum up, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.benchmarks.advising_figures import draw_all
    from saver_advisors.benchmarks.advising_report import page, show
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


def read(paths: Sequence[Path]) -> Results:
    """The results in files and folders.

    :param paths: as given to ``--results``
    :return: what they hold
    :raises UsageError: for a path that does not exist, or where there is no training run
    """
    from saver_advisors.cli.errors import UsageError, user_mistakes
    from saver_advisors.evaluation.training_runs import read_results

    with user_mistakes("argument --results"):
        results = read_results(paths)
    if not results.runs:
        left_out = "; ".join(f"{one.file} {one.reason}" for one in results.skipped)
        raise UsageError(
            f"argument --results: no training run in {', '.join(map(str, paths))}"
            + (f" ({left_out})" if left_out else "")
        )
    return results


def tables(results: Results) -> dict[str, list[Row]]:
    """The rows of every task, the paper's tasks and the paper's rows first.

    :param results: of the files
    :return: rows by environment
    """
    from saver_advisors.benchmarks.paper import table_5_2
    from saver_advisors.evaluation.summary import summarize

    paper = table_5_2()
    found = {run.task for run in results.runs}
    order = [env for env in paper.tasks.values() if env in found]
    order += sorted(found - set(order))
    return {task: summarize(task, results.of_task(task), list(paper.labels)) for task in order}


def judge_all(tasks: dict[str, list[Row]]) -> list[Finding]:
    """Every finding of the paper's about a task that there are runs of.

    :param tasks: as ``tables`` returns them
    :return: the findings
    """
    from saver_advisors.benchmarks.paper import table_5_2
    from saver_advisors.evaluation.findings import claims, judge, table_of

    paper = table_5_2()
    return [
        judge(claim, table_of(tasks[paper.tasks[claim.task]]))
        for claim in claims(list(paper.labels))
        if paper.tasks[claim.task] in tasks
    ]


def figures(
    tasks: dict[str, list[Row]], findings: Sequence[Finding], results: Results
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


def flat(row: Row) -> dict[str, Any]:
    """A row's figures without their intervals.

    :param row: of a task
    :return: one number each, None where there is none
    """
    short = {
        "IE": row.inspired_epoch,
        "RT": row.rise_time,
        "MSR": row.maximum_success_rate,
        "ELR": row.effective_learning_rate,
        "final_success": row.final_success,
        "collisions_per_episode": row.collisions,
    }
    solved = row.steps_to_solved
    return {
        "task": row.task,
        "row": row.name,
        "n": row.n,
        **{name: None if one is None else one.value for name, one in short.items()},
        "steps_to_solved": None if solved is None or solved.never else solved.estimate.value,
    }
