"""Compare variants, ablations and safe algorithms for learning under a constraint (chapter 6).

The command reads the JSON files of training runs on the distance task and evaluates the
dissertation's findings on them: first on the runs of the grid `constraints_shared_arms.yml`, then
on those of the learner before it.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from reproduction.command_parts import (
    Drawn,
    add_result_arguments,
    comparison_figures,
    print_skipped,
    save_panels,
    under_way_list,
    write_comparison,
)
from reproduction.constraints.constraint_findings import (
    NEVER,
    PAPER_BEST,
    SUCCEEDS,
    ChapterFinding,
    advantage,
    evaluated,
)
from reproduction.findings import MIN_SEEDS, beyond_seeds
from reproduction.page_templates import page
from saver_advisors.benchmark.run_tables import (
    figure_text,
    origin,
    outcome_cell,
    skipped_list,
)
from saver_advisors.cli.measured import read_training
from saver_advisors.evaluation.statistics import Estimate, estimate
from saver_advisors.experiments.grid import read_grid
from saver_advisors.experiments.plots import Panel
from saver_advisors.experiments.summary import MINUTE, MethodRow, summarize
from saver_advisors.experiments.training_runs import Results, TrainingRun
from saver_advisors.reporting.errors import UsageError
from saver_advisors.reporting.tables import (
    Column,
    markdown,
    optional,
    records_table,
    show_records,
    show_rows,
)

#: Finds the number of threads in the command of `saver experiments run`.
THREADS: Final = re.compile(r"--threads[ =](\d+)")

EXAMPLES: Final = """\
examples:
  python -m reproduction constraints                            of docs/results/constraints
  python -m reproduction constraints --results docs/results/constraints \\
      --table docs/constraints-results.md --figures docs/results/constraints \\
      --json docs/results/constraints.json"""

TASK: Final = "DualJacoDistance-v0"
RESULTS: Final = Path("docs/results/constraints")

GRID: Final = Path(__file__).parents[2] / "zoo_configs/constraints_shared_arms.yml"
BEST: Final = "shaped value, starts as teachers"
"""The row with which the others are compared."""
#: Names of rows that `saver benchmark run` takes from classes -> names in tables.
CLASSES: Final = {"TRPOLagrangian": "TRPO-Lagrangian", "PPOLagrangian": "PPO-Lagrangian"}
RATES: Final = {"SR": "success_rate", "GSR": "goal_success_rate", "CMR": "constraint_met_rate"}
CAPTIONS: Final = {
    "SR": "SR: both at their targets, the distance kept at every step.",
    "GSR": "GSR: both at their targets.",
    "CMR": "CMR: the distance kept at every step.",
}
MILLIMETRES: Final = 1000.0


REFERENCE_COLUMNS: Final[Mapping[str, Column]] = {
    "policy": "{policy}",
    "episodes": "{episodes}",
    **{label: optional(name, ".3f") for label, name in RATES.items()},
}
FINDING_COLUMNS: Final[Mapping[str, Column]] = {
    "finding": lambda one: one.text,
    "in these runs": lambda one: one.verdict,
    "beyond seeds": lambda one: one.beyond,
    "evidence": lambda one: one.evidence,
}
#: Shares of a run at which the table of curves shows them.
QUARTERS: Final = (0.25, 0.5, 0.75, 1.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_result_arguments(parser, RESULTS)


def run(args: argparse.Namespace) -> int:
    """Read and summarise runs, print tables, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: if there is no run on the distance task.
    """
    results = read_training(args.results)
    rows, earlier = tables(results)
    if not rows and not earlier:
        others = ", ".join(sorted({one.task for one in results.runs}))
        raise UsageError(f"argument --results: no run of {TASK} there, only of {others}")
    findings = evaluated(rows, planned_seeds())
    show_all(rows, earlier, findings, results)
    figures: dict[str, Any] = {
        "title": "Learning under a constraint",
        "kind": "constraints",
        "task": TASK,
        **comparison_figures(
            rows, [flat_row(row) for row in rows], [vars(one) for one in findings], results
        ),
        "earlier": [flat_row(row) for row in earlier],
    }
    return write_comparison(
        args,
        figures,
        lambda folder: draw_all(rows, folder),
        lambda pictures: comparison_page(rows, earlier, results, pictures),
    )


def tables(results: Results) -> tuple[list[MethodRow], list[MethodRow]]:
    """Summarise the runs of the distance task.

    :param results: what was read.
    :return: the rows of the grid, and those of the learner before it; in each, the rows with the
        highest success come first and those without a finished run last.
    """

    def success(row: MethodRow) -> float:
        return -1.0 if row.final_success is None else row.final_success.value

    groups = {run.group for run in read_grid(GRID).runs}
    split = []
    for of_grid in (True, False):
        runs = [
            replace(run, row=CLASSES.get(run.row, run.row))
            for run in results.runs
            if (run.group in groups) == of_grid
        ]
        by_row = replace(results, runs=runs).of_task(TASK)
        split.append(sorted(summarize(TASK, by_row), key=success, reverse=True))
    return split[0], split[1]


def planned_seeds() -> Counter[str]:
    """Count the seeds of each row of the grid."""
    return Counter(run.row for run in read_grid(GRID).runs)


def missing_list(rows: Sequence[MethodRow]) -> str:
    """List the rows of the grid that lack finished seeds.

    :param rows: of the grid that were read.
    :return: a sentence; empty if nothing is missing.
    """
    planned = planned_seeds()
    finished = {row.name: row.n for row in rows}
    told = [
        f"{name} ({finished.get(name, 0)} of {seeds})"
        for name, seeds in planned.items()
        if finished.get(name, 0) < seeds
    ]
    return f"Rows with missing seeds (finished of planned): {', '.join(told)}.\n" if told else ""


def final_rate(row: MethodRow, name: str) -> Estimate | None:
    """Summarise an entry of the final evaluations on the report seeds.

    :param row: row of the table.
    :param name: key of the entry, such as one of ``RATES``.
    :return: the estimate over the seeds that have the entry; None if none has.
    """
    return _estimate([run.final.get(name) for run in row.runs if run.final])


def final_cost(row: MethodRow, statistic: str) -> Estimate | None:
    """Summarise a statistic of the distance's cost over the final episodes.

    :param row: row of the table.
    :param statistic: ``cost_means`` or ``cost_cvar``.
    :return: as :func:`final_rate`.
    """
    summaries = [run.final.get(statistic, {}) for run in row.runs if run.final]
    return _estimate([one.get("cost_distance") for one in summaries])


def flat_row(row: MethodRow) -> dict[str, Any]:
    """Return a row of the flat table in the JSON file.

    :param row: row of the table.
    :return: its name, number of seeds and rates.
    """
    rates = {name: final_rate(row, name) for name in RATES.values()}
    return {
        "row": row.name,
        "n": row.n,
        **{name: None if rate is None else rate.to_mapping() for name, rate in rates.items()},
    }


def comparison_page(
    rows: Sequence[MethodRow],
    earlier: Sequence[MethodRow],
    results: Results,
    pictures: Sequence[Mapping[str, str]],
) -> str:
    """Render the page.

    :param rows: rows of the grid.
    :param earlier: rows of the learner before it.
    :param results: what was read.
    :param pictures: ``link`` and ``caption`` of the figures to show.
    :return: Markdown.
    """
    return page(
        "constraints",
        best=PAPER_BEST,
        succeeds=SUCCEEDS,
        never=NEVER,
        min_seeds=MIN_SEEDS,
        now=section(rows, planned_seeds()),
        missing=missing_list(rows),
        earlier=section(earlier, {row.name for row in earlier}),
        earlier_curves=curves_table([row for row in earlier if row.n]),
        reference=BEST,
        beside=beside_table([row for row in rows if row.n]),
        references=results.references,
        of_references=REFERENCE_COLUMNS,
        of_findings=FINDING_COLUMNS,
        pictures=pictures,
        skipped=skipped_list(results.skipped),
        origin=origin(results.runs),
    )


def section(rows: Sequence[MethodRow], planned: Collection[str]) -> dict[str, Any]:
    """Collect the tables of one learner's rows.

    :param rows: of the learner.
    :param planned: see :func:`evaluated`.
    :return: the template's values: ``methods`` and ``equal_time`` in Markdown, ``findings`` and
        ``under_way``.
    """
    finished = [row for row in rows if row.n]
    lines = [cells for row in finished for cells in map(_method_cells, with_shield(row))]
    return {
        "methods": records_table(lines),
        "findings": evaluated(rows, planned) if finished else [],
        "equal_time": equal_time_table(finished) if len(finished) > 1 else "",
        "under_way": under_way_list(rows),
    }


def with_shield(row: MethodRow) -> list[MethodRow]:
    """Return a row and, where its last policies were evaluated with a shield, a row of those."""
    runs = [
        replace(run, final=run.shielded, points=[{}], chosen=None)
        for run in row.runs
        if run.shielded is not None
    ]
    return [row, replace(row, name=f"{row.name}, with a shield", runs=runs)] if runs else [row]


def _method_cells(row: MethodRow) -> dict[str, str]:
    """Return the rates and violations of a row with finished runs, by their headings."""
    training = [run.points[-1].get("training_cost") for run in row.runs]
    steps = sorted({run.curve.steps[-1] for run in row.runs})
    return {
        "row": row.name,
        "n": str(row.n),
        "steps": " or ".join(f"{one:,.0f}" for one in steps),
        **_rate_cells(row),
        "deviation, mean mm": figure_text(final_rate(row, "deviation_mean"), 1, MILLIMETRES),
        "deviation, worst mm": figure_text(final_rate(row, "deviation_worst"), 0, MILLIMETRES),
        "cost per episode": figure_text(final_cost(row, "cost_means"), 2),
        "CVaR of the cost": figure_text(final_cost(row, "cost_cvar"), 1),
        "cost in training": figure_text(_estimate(training), 0),
        "chosen checkpoint": "; ".join(outcome_cell(run.chosen) for run in row.runs),
        "minutes": figure_text(row.training_s, 0, 1 / MINUTE) + on_threads(row),
    }


def beside_table(rows: Sequence[MethodRow]) -> str:
    """Compare the success of each row with that of ``BEST``.

    :param rows: with finished runs.
    :return: Markdown; empty without that row, or without another.
    """
    best = next((row for row in rows if row.name == BEST), None)
    cells = []
    for row in rows:
        if best is None or row is best or (compared := advantage(row, best)) is None:
            continue
        gap, resolution = compared
        higher = None if abs(gap.value) <= resolution else gap.value > 0
        cells.append(
            {
                "row": row.name,
                "n": str(gap.n),
                "difference of SR": gap.text(3),
                "beyond seeds": beyond_seeds(higher, gap.n, gap.excludes(0.0)),
            }
        )
    return records_table(cells)


def curves_table(rows: Sequence[MethodRow]) -> str:
    """Tabulate the success rate along the runs.

    :param rows: with finished runs.
    :return: Markdown.
    """
    return records_table(
        {
            "row": row.name,
            "n": str(row.n),
            **{
                f"SR at {share:.0%}": figure_text(
                    _estimate([success_at(run, share) for run in row.runs]), 2
                )
                for share in QUARTERS
            },
        }
        for row in rows
    )


def success_at(run: TrainingRun, share: float) -> float:
    """Interpolate a curve's success rate after a share of the run's steps."""
    curve = run.curve
    return float(np.interp(share * curve.steps[-1], curve.steps, curve.success))


def on_threads(row: MethodRow) -> str:
    """Return the number of threads of a row's runs in words; empty for a single thread."""
    commands = (str(run.provenance.get("command") or "") for run in row.runs)
    told = sorted({int(found[1]) if (found := THREADS.search(one)) else 1 for one in commands})
    return "" if told == [1] else f" on {' or '.join(map(str, told))} threads"


def equal_time_table(rows: Sequence[MethodRow]) -> str:
    """Render the mean and the highest success of each row up to the same training time.

    :param rows: rows with finished runs.
    :return: Markdown; empty if no row has times.
    """
    timed = [row for row in rows if all(run.points[-1].get("wall_clock_s") for run in row.runs)]
    if not timed:
        return ""
    limit = min(run.points[-1]["wall_clock_s"] for row in timed for run in row.runs)
    cells = []
    for row in timed:
        until = [[p for p in run.points if p["wall_clock_s"] <= limit] for run in row.runs]
        success = [[p["success_rate"] for p in points] for points in until if points]
        steps = [points[-1]["steps"] for points in until if points]
        cells.append(
            [
                row.name,
                f"{limit / MINUTE:.0f}{on_threads(row)}",
                figure_text(_estimate(steps), 0),
                figure_text(_estimate([sum(one) / len(one) for one in success]), 3),
                figure_text(_estimate([max(one) for one in success]), 3),
            ]
        )
    return markdown(("row", "minutes", "steps until then", "mean SR", "highest SR"), cells)


def draw_all(rows: Sequence[MethodRow], folder: Path) -> list[Drawn]:
    """Draw the curves of the three rates (Figures 6.1 and 6.2).

    :param rows: rows of the distance task.
    :param folder: folder of the pictures.
    :return: the figures, in the order of the rates.
    """
    drawn: list[Drawn] = []
    for label, name in RATES.items():
        shown = {
            row.name: runs
            for row in rows
            if (runs := [r for r in row.runs if any(p.get(name) is not None for p in r.points)])
        }
        panels = [Panel(TASK, shown)] if shown else []
        path = folder / f"{name.replace('_', '-')}.png"
        drawn += save_panels(panels, name, path, CAPTIONS[label])
    return drawn


def _rate_cells(row: MethodRow) -> dict[str, str]:
    return {label: figure_text(final_rate(row, name), 3) for label, name in RATES.items()}


def show_all(
    rows: Sequence[MethodRow],
    earlier: Sequence[MethodRow],
    findings: Sequence[ChapterFinding],
    results: Results,
) -> None:
    """Print the rates, the findings, and the files that were left out.

    :param rows: rows of the grid.
    :param earlier: rows of the learner before it.
    :param findings: findings of chapter 6, on the rows of the grid.
    :param results: what was read.
    """
    for title, shown in ((TASK, rows), (f"{TASK}, earlier learner", earlier)):
        cells = [{"row": row.name, "n": str(row.n), **_rate_cells(row)} for row in shown if row.n]
        show_records(cells, title)
        if told := under_way_list(shown):
            print(told)
    print(missing_list(rows))
    show_rows(findings, FINDING_COLUMNS)
    print_skipped(results)


def _estimate(values: Sequence[float | None]) -> Estimate | None:
    known = [value for value in values if value is not None]
    return estimate(known) if known else None
