"""Result files of yours beside the shipped baselines: a table, intervals over seeds, a figure."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from saver_advisors.experiments.summary import MethodRow
    from saver_advisors.experiments.training_runs import Results

EXAMPLES: Final = """\
examples:
  saver benchmark compare results/*.json --baselines docs/results/teachers.json
  saver benchmark compare results/*.json --baselines docs/results/advising \\
      --table comparison.md --figure comparison.png --json comparison.json"""

DRAWN_BASELINES: Final = 5
"""So many are drawn, those with the highest mean success: a figure of a dozen says nothing."""

INTRODUCTION: Final = """\
Rendered by `saver benchmark compare` from result files, never typed. What was put beside the
baselines comes first. The page on the protocol says how each figure is measured.
"""

BESIDE: Final = """\
Against each baseline: how many times as soon a success rate of 0.9 was seen (above 1 is sooner),
and how likely a run's mean success is higher.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from saver_advisors.cli.arguments import add_figure, add_json, add_table

    parser.add_argument(
        "results",
        nargs="+",
        type=Path,
        metavar="RESULT.json",
        help="files of `saver benchmark run`, or folders of them",
    )
    parser.add_argument(
        "--baselines",
        nargs="+",
        type=Path,
        required=True,
        metavar="PATH",
        help="files, or folders of them, to stand beside",
    )
    add_table(parser)
    add_figure(parser, "--figure", "draw the curves there")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Read, compare, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.benchmark.run_tables import measured
    from saver_advisors.cli.arguments import write_json
    from saver_advisors.cli.result_files import read
    from saver_advisors.reporting.tables import show

    entries, baselines = read(args.results), read(args.baselines)
    tasks = compared(entries, baselines)
    for task, (own, others) in tasks.items():
        columns = ("row", "n", "IE", "RT", "MSR", "ELR", "final success")
        cells = [
            [row.name, *measured(row), row.final_success.text(3) if row.final_success else "-"]
            for row in (*own, *others)
        ]
        show(columns, cells, title=task)
    for one in (*entries.skipped, *baselines.skipped):
        print(f"left out {one.file}: {one.reason}")
    write_json(args.json, figures(tasks))  # before what changes the checkout
    if args.figure is not None:
        draw(tasks, args.figure)
        print(f"wrote {args.figure}")
    if args.table is not None:
        text = page(tasks, entries, baselines, args.figure, args.table.parent)
        args.table.write_text(text, encoding="utf-8")
        print(f"wrote {args.table}")
    return 0


Tasks = dict[str, "tuple[list[MethodRow], list[MethodRow]]"]
"""By environment: the rows that are put beside the baselines, and the baselines."""


def compared(entries: Results, baselines: Results) -> Tasks:
    """Rows of both kinds, over the same budget of steps, of the environments of the entries.

    :param entries: what is put beside the baselines
    :param baselines: theirs
    :return: rows with finished runs
    :raises UsageError: where no entry is finished
    """
    from saver_advisors.experiments.summary import summarize
    from saver_advisors.reporting.errors import UsageError

    tasks: Tasks = {}
    for task in dict.fromkeys(run.task for run in entries.runs):
        own, others = entries.of_task(task), baselines.of_task(task)
        # A name that a baseline has too stays tellable.
        named = {f"{name} (yours)" if name in others else name: own[name] for name in own}
        rows = summarize(task, {**named, **others}, [*named])
        finished = [row for row in rows if row.n]
        entered = [row for row in finished if row.name in named]
        if entered:
            tasks[task] = entered, [row for row in finished if row.name not in named]
    if not tasks:
        raise UsageError("argument RESULT.json: none of the runs is finished")
    return tasks


def page(
    tasks: Tasks, entries: Results, baselines: Results, figure: Path | None, folder: Path
) -> str:
    """The comparison as a page.

    :param tasks: as ``compared`` returns them
    :param entries: what was put beside the baselines
    :param baselines: theirs
    :param figure: the curves, where drawn
    :param folder: of the page, which the figure is linked from
    :return: Markdown
    """
    from saver_advisors.benchmark.run_tables import (
        DEFINITIONS,
        beside,
        beyond,
        metrics_table,
        origin,
        reference_table,
        run_table,
        skipped_list,
    )
    from saver_advisors.reporting.figures import link

    parts = ["# Beside the baselines", INTRODUCTION, DEFINITIONS]
    for task, (own, others) in tasks.items():
        rows = [*own, *others]
        parts += [f"## {task}", metrics_table(rows), beyond(rows)]
        if others:
            parts += [BESIDE, beside([(row, other) for row in own for other in others])]
        references = [one for one in baselines.references if one["env"] == task]
        if references:
            parts += ["Policies that were not trained here:\n", reference_table(references)]
        parts += ["Each run:\n", run_table([run for row in rows for run in row.runs])]
    if figure is not None:
        parts.append(f"![learning curves]({link(figure, folder)})\n")
    parts.append(skipped_list([*entries.skipped, *baselines.skipped]))
    parts.append(
        origin(
            [run for own, others in tasks.values() for row in (*own, *others) for run in row.runs]
        )
    )
    return "\n".join(part.rstrip("\n") + "\n" for part in parts if part)


def draw(tasks: Tasks, path: Path) -> None:
    """Draw the entries and the best baselines, a panel a task.

    :param tasks: as ``compared`` returns them
    :param path: of the figure
    """
    from saver_advisors.experiments.plots import Panel, draw_panels

    panels = []
    for task, (own, others) in tasks.items():
        chosen = best(others)
        grey = chosen[0].name if len(chosen) == 1 else None
        panels.append(Panel(task, {row.name: row.runs for row in (*own, *chosen)}, grey))
    draw_panels(panels).savefig(path)


def best(rows: Sequence[MethodRow], count: int = DRAWN_BASELINES) -> list[MethodRow]:
    """The rows with the highest mean success, in their old order.

    :param rows: of a task
    :param count: how many at most
    :return: the rows
    """
    ranked = sorted(rows, key=lambda row: row.area.value if row.area else 0.0, reverse=True)
    kept = {row.name for row in ranked[:count]}
    return [row for row in rows if row.name in kept]


def figures(tasks: Tasks) -> dict[str, Any]:
    """Everything that was computed, for JSON.

    :param tasks: as ``compared`` returns them
    :return: rows with intervals, and each entry against each baseline
    """
    from saver_advisors.benchmark.run_tables import areas, flat
    from saver_advisors.evaluation.statistics import probability_of_improvement

    rows = [row for own, others in tasks.values() for row in (*own, *others)]
    return {
        "title": "Beside the baselines",
        "kind": "comparison",
        "rows": [flat(row) for row in rows],
        "detail": [row.to_mapping() for row in rows],
        "improvement": [
            {
                "task": task,
                "row": row.name,
                "baseline": other.name,
                **probability_of_improvement(areas(row), areas(other)).to_mapping(),
            }
            for task, (own, others) in tasks.items()
            for row in own
            for other in others
        ],
    }
