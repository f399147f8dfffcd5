"""Compare variants, ablations and safe algorithms for learning under a constraint (chapter 6).

The command reads the JSON files of training runs on the distance task, those of the grid and those
of `saver benchmark run`, and evaluates the dissertation's findings on them. Chapter 6 shows curves
(Figures 6.1 and 6.2) and no table. Here its findings are thresholds: "succeeds" is a success rate
of at least half of the 0.70 that it shows at best, and "never succeeds" one of at most 0.05.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
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
from reproduction.findings import success_resolution, verdict_of
from reproduction.page_templates import page
from saver_advisors.benchmark.run_tables import (
    figure_text,
    origin,
    outcome_cell,
    skipped_list,
)
from saver_advisors.cli.measured import read_training
from saver_advisors.evaluation.statistics import Estimate, estimate
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

PAPER_BEST: Final = 0.70
"""Highest SR of the three stages in Figure 6.2."""
SUCCEEDS: Final = PAPER_BEST / 2
NEVER: Final = 0.05

METHOD: Final = "min"
NO_EXPLORING: Final = "advising without the third stage"
#: Rows of the table, by the class names of `saver benchmark run` and one name of the grid -> names
#: on the page.
BASELINES: Final[Mapping[str, str]] = {
    "CPO": "CPO",
    "TRPOLagrangian": "TRPO-Lagrangian",
    "PPOLagrangian": "PPO-Lagrangian",
    "hindsight alone": "HER that is conditioned on the constraint",
}
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
FINDING_COLUMNS: Final = {
    "finding": "{text}",
    "in these runs": "{verdict}",
    "evidence": "{evidence}",
}


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

    def success(row: MethodRow) -> float:
        return -1.0 if row.final_success is None else row.final_success.value

    return sorted(summarize(TASK, results.of_task(TASK)), key=success, reverse=True)


Rule = Callable[[MethodRow], tuple[bool | None, str]]
"""Whether a finding holds for a row (None: cannot be told), and the figures that decide it."""


def evaluated(rows: Sequence[MethodRow]) -> list[dict[str, str]]:
    """Evaluate every finding.

    :param rows: rows of the distance task.
    :return: the ``text``, the ``verdict`` in these runs and the ``evidence`` of each finding; those
        about missing rows cannot be told.
    """
    named = {row.name: row for row in rows if row.n}
    succeed = f"The three stages as written (`{METHOD}`) succeed: SR {PAPER_BEST:.2f} at best"
    decays = "Advising without the third stage rises a little and decays"
    claims: list[tuple[str, str, Rule]] = [
        (succeed, METHOD, _succeeds),
        *((f"{label} never succeeds", name, _never) for name, label in BASELINES.items()),
        (decays, NO_EXPLORING, _decays),
    ]
    found = []
    for text, name, rule in claims:
        holds, evidence = rule(named[name]) if name in named else (None, "no finished run")
        found.append({"text": text, "verdict": verdict_of(holds), "evidence": evidence})
    return found


def _bests(row: MethodRow) -> list[float]:
    """Return the highest success rate of each run."""
    return [float(run.curve.success.max()) for run in row.runs]


def _succeeds(row: MethodRow) -> tuple[bool | None, str]:
    best = max(_bests(row))
    near = abs(best - SUCCEEDS) <= success_resolution(best, row.runs[0].episodes)
    return None if near else best >= SUCCEEDS, f"SR {best:.2f} at best (n = {row.n})"


def _never(row: MethodRow) -> tuple[bool | None, str]:
    best = max(_bests(row))
    return best <= NEVER, f"SR {best:.2f} at best (n = {row.n})"


def _decays(row: MethodRow) -> tuple[bool | None, str]:
    """Compare the highest success with the success at the end."""
    best = float(np.mean(_bests(row)))
    last = float(np.mean([_last(run) for run in row.runs]))
    resolved = best - last > success_resolution(best, row.runs[0].episodes)
    holds = False if max(_bests(row)) <= NEVER else resolved or None
    return holds, f"SR {best:.2f} at best, {last:.2f} in the last quarter (n = {row.n})"


def _last(run: TrainingRun) -> float:
    """Compute the mean success of the last quarter of a curve."""
    success = np.asarray(run.curve.success)
    return float(success[-max(1, len(success) // 4) :].mean())


def final_rate(row: MethodRow, name: str) -> Estimate | None:
    """Summarise an entry of the final evaluations on the report seeds.

    :param row: row of the table.
    :param name: key of the entry, such as one of ``RATES``.
    :return: the estimate over the seeds that have the entry; None if none has.
    """
    return _estimate([run.final.get(name) for run in row.runs if run.final])


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
    findings: Sequence[Mapping[str, str]],
    results: Results,
    pictures: Sequence[Mapping[str, str]],
) -> str:
    """Render the page.

    :param rows: rows of the distance task.
    :param findings: findings of chapter 6.
    :param results: what was read.
    :param pictures: ``link`` and ``caption`` of the figures to show.
    :return: Markdown.
    """
    finished = [row for row in rows if row.n]
    return page(
        "constraints",
        best=PAPER_BEST,
        methods=records_table(map(_method_cells, finished)),
        under_way=under_way_list(rows),
        references=results.references,
        of_references=REFERENCE_COLUMNS,
        findings=findings,
        of_findings=FINDING_COLUMNS,
        equal_time=equal_time_table(finished) if len(finished) > 1 else None,
        pictures=pictures,
        skipped=skipped_list(results.skipped),
        origin=origin(results.runs),
    )


def _method_cells(row: MethodRow) -> dict[str, str]:
    """Return the rates and violations of a row with finished runs, by their headings."""
    costs = [run.final.get("cost_means", {}).get("cost_distance") for run in row.runs if run.final]
    training = [run.points[-1].get("training_cost") for run in row.runs]
    steps = sorted({run.curve.steps[-1] for run in row.runs})
    return {
        "row": row.name,
        "n": str(row.n),
        "steps": " or ".join(f"{one:,.0f}" for one in steps),
        **_rate_cells(row),
        "deviation, mean mm": figure_text(final_rate(row, "deviation_mean"), 1, MILLIMETRES),
        "deviation, worst mm": figure_text(final_rate(row, "deviation_worst"), 0, MILLIMETRES),
        "cost per episode": figure_text(_estimate(costs), 2),
        "cost in training": figure_text(_estimate(training), 0),
        "chosen checkpoint": "; ".join(outcome_cell(run.chosen) for run in row.runs),
        "minutes": figure_text(row.training_s, 0, 1 / MINUTE) + on_threads(row),
    }


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
    rows: Sequence[MethodRow], findings: Sequence[Mapping[str, str]], results: Results
) -> None:
    """Print the rates, the findings, and the files that were left out.

    :param rows: rows of the distance task.
    :param findings: findings of chapter 6.
    :param results: what was read.
    """
    cells = [{"row": row.name, "n": str(row.n), **_rate_cells(row)} for row in rows if row.n]
    show_records(cells, TASK)
    if told := under_way_list(rows):
        print(told)
    show_rows(findings, FINDING_COLUMNS)
    print_skipped(results)


def _estimate(values: Sequence[float | None]) -> Estimate | None:
    known = [value for value in values if value is not None]
    return estimate(known) if known else None
