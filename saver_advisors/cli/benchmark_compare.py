"""Compare your result files with the baselines: a table, intervals over seeds, and a figure."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from itertools import product
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli.arguments import add_figure, add_json, add_path, add_table, write_json
from saver_advisors.cli.measured import read_training
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.tables import link, show_records
from saver_advisors.reporting.templates import rendered

if TYPE_CHECKING:
    from saver_advisors.experiments.summary import MethodRow
    from saver_advisors.experiments.training_runs import Results, TrainingRun

EXAMPLES: Final = """\
examples:
  saver benchmark compare results/*.json --baselines docs/results/teachers.json
  saver benchmark compare results/*.json --baselines docs/results/advising \\
      --table comparison.md --figure comparison.png --json comparison.json"""

NO_DIGEST: Final = "Older results without a digest of the world, which may have another:"

DRAWN_BASELINES: Final = 5
"""Number of baselines in the figure: those with the highest mean success."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    text = "files of `saver benchmark run`, or folders of them"
    add_path(parser, "results", text, metavar="RESULT.json", nargs="+")
    text = "files of the baselines, or folders of them"
    add_path(parser, "--baselines", text, metavar="PATH", nargs="+", required=True)
    add_table(parser)
    add_figure(parser, "--figure", "plot the curves in this file")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Compare, print the tables, and write the given files.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.benchmark.run_tables import final_rates, measured

    entries, baselines = read_training(args.results), read_training(args.baselines)
    check_worlds([*entries.runs, *baselines.runs], {run.task for run in entries.runs})
    tasks = compared(entries, baselines)
    for task, (own, others) in tasks.items():
        cells = [
            {**measured(row), **final_rates(row), "off protocol": row.off_protocol}
            for row in (*own, *others)
        ]
        show_records(cells, task)
    for one in (*entries.skipped, *baselines.skipped):
        print(f"left out {one.file}: {one.reason}")
    if older := unknown_worlds(tasks):
        print(f"{NO_DIGEST} {', '.join(older)}")
    write_json(args.json, figures(tasks))  # before what changes the checkout
    if args.figure is not None:
        draw(tasks, args.figure)
        print(f"wrote {args.figure}")
    if args.table is not None:
        text = page(tasks, entries, baselines, args.figure, args.table.parent)
        args.table.write_text(text, encoding="utf-8")
        print(f"wrote {args.table}")
    return 0


def check_worlds(runs: Sequence[TrainingRun], tasks: Iterable[str]) -> None:
    """Check that the runs of each environment have one world, as far as their files tell.

    :param runs: of the results and of the baselines
    :param tasks: the environments that are compared
    :raises UsageError: for two worlds; the message names a file of each and what differs
    """
    for task in sorted(tasks):
        known = [run for run in runs if run.task == task and run.world is not None]
        for other in known[1:]:
            first = known[0]
            if other.world != first.world:
                raise UsageError(
                    f"argument RESULT.json: {first.file} and {other.file} measure {task} in "
                    f"different worlds, with the digests {first.world} and {other.world}: "
                    f"{_difference(first, other)}; compare them separately"
                )


def _difference(first: TrainingRun, other: TrainingRun) -> str:
    """Say in which keyword arguments two runs' environments differ."""
    options = [run.config.get("env_kwargs") or {} for run in (first, other)]
    names = sorted(set(options[0]) | set(options[1]))
    told = [
        f"{name} is {' and '.join(str(one.get(name, 'the default')) for one in options)}"
        for name in names
        if options[0].get(name) != options[1].get(name)
    ]
    return ", ".join(told) or "their options are equal, so the code of the world has changed"


def unknown_worlds(tasks: Tasks) -> list[str]:
    """Return the files of compared runs without a digest."""
    runs = [run for rows in tasks.values() for row in (*rows[0], *rows[1]) for run in row.runs]
    return sorted({run.file for run in runs if run.world is None})


Tasks = dict[str, "tuple[list[MethodRow], list[MethodRow]]"]
"""Compared rows and baselines, by environment."""


def compared(entries: Results, baselines: Results) -> Tasks:
    """Summarize the runs and their baselines per environment, over the same number of steps.

    :param entries: the compared results
    :param baselines: the baselines' results
    :return: rows with finished runs, for the environments of the entries
    :raises UsageError: if no entry is finished
    """
    from saver_advisors.experiments.summary import summarize

    tasks: Tasks = {}
    for task in dict.fromkeys(run.task for run in entries.runs):
        own, others = entries.of_task(task), baselines.of_task(task)
        # Entries and baselines of the same name stay distinguishable.
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
    """Render the comparison as a page.

    :param tasks: from :func:`compared`
    :param entries: the compared results
    :param baselines: the baselines' results
    :param figure: file of the curves, or None
    :param folder: folder of the page, for the link to the figure
    :return: Markdown
    """
    from saver_advisors.benchmark import run_tables

    runs = [run for own, others in tasks.values() for row in (*own, *others) for run in row.runs]
    return rendered(
        "saver_advisors.benchmark",
        "comparison.md.j2",
        run_tables=run_tables,
        row_name=attrgetter("name"),
        deviations=attrgetter("off_protocol"),
        pairs=product,
        tasks=tasks,
        references=baselines.references,
        figure=None if figure is None else link(figure, folder),
        skipped=run_tables.skipped_list([*entries.skipped, *baselines.skipped]),
        older=unknown_worlds(tasks),
        no_digest=NO_DIGEST,
        origin=run_tables.origin(runs),
    )


def draw(tasks: Tasks, path: Path) -> None:
    """Plot the entries and the best baselines, one panel per environment.

    :param tasks: from :func:`compared`
    :param path: file of the figure
    """
    from saver_advisors.experiments.plots import Panel, draw_panels

    panels = []
    for task, (own, others) in tasks.items():
        chosen = best(others)
        grey = chosen[0].name if len(chosen) == 1 else None
        panels.append(Panel(task, {row.name: row.runs for row in (*own, *chosen)}, grey))
    draw_panels(panels).savefig(path)


def best(rows: Sequence[MethodRow], count: int = DRAWN_BASELINES) -> list[MethodRow]:
    """Return the rows with the highest mean success, in their original order.

    :param rows: rows of one environment
    :param count: largest number of rows
    """
    ranked = sorted(rows, key=lambda row: row.area.value if row.area else 0.0, reverse=True)
    kept = {row.name for row in ranked[:count]}
    return [row for row in rows if row.name in kept]


def figures(tasks: Tasks) -> dict[str, Any]:
    """Return the rows with intervals, and each entry against each baseline, for JSON.

    :param tasks: from :func:`compared`
    """
    from saver_advisors.benchmark import run_tables
    from saver_advisors.evaluation.statistics import probability_of_improvement

    rows = [row for own, others in tasks.values() for row in (*own, *others)]
    return {
        "title": "Beside the baselines",
        "kind": "comparison",
        "rows": [run_tables.flat(row) for row in rows],
        "detail": [row.to_mapping() for row in rows],
        "improvement": [
            {
                "task": task,
                "row": row.name,
                "baseline": other.name,
                **probability_of_improvement(row.areas, other.areas).to_mapping(),
            }
            for task, (own, others) in tasks.items()
            for row in own
            for other in others
        ],
    }
