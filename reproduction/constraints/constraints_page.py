"""Chapter 6 as a page, with its figures, and as tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from reproduction.constraints.constraints_findings import PAPER_BEST, ConstraintFinding
from saver_advisors.benchmark.run_tables import (
    NOTHING,
    origin,
    outcome_cell,
    skipped_list,
    under_way_list,
)
from saver_advisors.evaluation.statistics import Estimate, estimate
from saver_advisors.experiments.plots import Panel, draw_panels
from saver_advisors.experiments.summary import MINUTE, MethodRow
from saver_advisors.experiments.training_runs import Results, TrainingRun
from saver_advisors.reporting.figures import Drawn, link
from saver_advisors.reporting.tables import markdown
from saver_advisors.reporting.tables import show as show_table

RATES: Final = ("success_rate", "goal_success_rate", "constraint_met_rate")
MILLIMETRES: Final = 1000.0

INTRODUCTION: Final = f"""\
Rendered by `python -m reproduction constraints` from the files of the runs, never typed. The
dissertation shows an SR of about {PAPER_BEST:.2f} at best for its three stages, and none for the
others (Figures 6.1 and 6.2).

- **SR**: episodes that end with both cubes at their targets and kept the distance at every step
- **GSR**: that end with both cubes at their targets
- **CMR**: that kept the distance at every step
- **astray**: how far the distance is from the required one, the mean over steps, and the largest in
  all episodes; up to 15 mm are allowed
- **cost**: steps outside the band in an episode, of 50, in the evaluation and, in all, in training
- **chosen checkpoint**: SR of the one that was best on the seeds of the curve; as the other
  figures, on report seeds, which had no part in anything before
- **minutes**: of training, evaluations not counted; on one thread where no more are named. Other
  work ran beside most of the runs: they tell an order of magnitude

n counts finished seeds; over two, a figure is their mean, and the brackets reach from one to the
other.
"""

EQUAL_TIME: Final = """\
Algorithms that step faster may take more steps in the same time. The mean success of a run's
evaluations up to the wall-clock time that the quickest run of the table took in all:
"""

FINDINGS: Final = """\
*Succeeds* is an SR of at least 0.35, *never* one of at most 0.05 at every evaluation.
"""


def final_rate(row: MethodRow, name: str) -> Estimate | None:
    """A rate of the last policies on the report seeds.

    :param row: of the table
    :param name: of the rate, one of ``RATES``, or another entry of an evaluation
    :return: over the seeds that have it, None where none has
    """
    values = [run.final[name] for run in row.runs if run.final and run.final.get(name) is not None]
    return estimate(values) if values else None


def page(
    rows: Sequence[MethodRow],
    findings: Sequence[ConstraintFinding],
    results: Results,
    drawn: Sequence[Drawn],
    folder: Path,
) -> str:
    """The page.

    :param rows: of the distance task
    :param findings: of chapter 6
    :param results: what was read
    :param drawn: figures to show
    :param folder: of the page, which the figures are linked from
    :return: Markdown
    """
    finished = [row for row in rows if row.n]
    parts = ["# Learning under a constraint, measured", INTRODUCTION, "## Methods"]
    if finished:
        parts += [method_table(finished)]
    parts += [under_way_list(rows)]
    if results.references:
        parts += ["Policies that did not learn this task:\n", references(results)]
    parts += ["## What chapter 6 finds", FINDINGS, finding_table(findings)]
    if len(finished) > 1:
        parts += ["## Equal time", EQUAL_TIME, equal_time_table(finished)]
    if drawn:
        parts.append("## Curves")
        parts += [f"![{one.caption}]({link(one.path, folder)})\n\n{one.caption}\n" for one in drawn]
    parts += [skipped_list(results.skipped), origin(results.runs)]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts if part)


def method_table(rows: Sequence[MethodRow]) -> str:
    """Every row with its rates and violations.

    :param rows: with finished runs
    :return: Markdown
    """
    columns = (
        "row",
        "n",
        "steps",
        "SR",
        "GSR",
        "CMR",
        "astray, mean mm",
        "astray, worst mm",
        "cost an episode",
        "cost in training",
        "chosen checkpoint",
        "minutes",
    )
    return markdown(columns, [_cells(row) for row in rows])


def _cells(row: MethodRow) -> list[str]:
    costs = [
        run.final["cost_means"]["cost_distance"]
        for run in row.runs
        if run.final and "cost_distance" in run.final.get("cost_means", {})
    ]
    told = [run.points[-1].get("training_cost") for run in row.runs]
    training = [cost for cost in told if cost is not None]
    steps = sorted({run.curve.steps[-1] for run in row.runs})
    return [
        row.name,
        str(row.n),
        " or ".join(f"{one:,.0f}" for one in steps),
        *(_told(final_rate(row, name), 3) for name in RATES),
        _told(final_rate(row, "deviation_mean"), 1, MILLIMETRES),
        _told(final_rate(row, "deviation_worst"), 0, MILLIMETRES),
        _told(estimate(costs) if costs else None, 2),
        _told(estimate(training) if training else None, 0),
        "; ".join(outcome_cell(run.chosen) for run in row.runs),
        _told(row.wall_clock_s, 0, 1 / MINUTE) + on_threads(row),
    ]


def on_threads(row: MethodRow) -> str:
    """How many threads a row's runs had, where that is more than one."""
    told = sorted({run.threads for run in row.runs})
    return "" if told == [1] else f" on {' or '.join(map(str, told))} threads"


def references(results: Results) -> str:
    """Policies that were not trained on the task, such as its expert.

    :param results: of the files
    :return: Markdown
    """
    cells = [
        [str(one["policy"]), str(one["episodes"]), *(_rate(one.get(name)) for name in RATES)]
        for one in results.references
    ]
    return markdown(("policy", "episodes", "SR", "GSR", "CMR"), cells)


def finding_table(findings: Sequence[ConstraintFinding]) -> str:
    """Each finding with its verdict.

    :param findings: of chapter 6
    :return: Markdown
    """
    return markdown(
        ("finding", "in these runs", "evidence"),
        [[one.text, one.verdict, one.evidence] for one in findings],
    )


def equal_time_table(rows: Sequence[MethodRow]) -> str:
    """Mean and best success of each row, up to the same wall-clock time.

    :param rows: with finished runs
    :return: Markdown
    """
    timed = [row for row in rows if all(run.points[-1].get("wall_clock_s") for run in row.runs)]
    if not timed:
        return ""
    limit = min(run.points[-1]["wall_clock_s"] for row in timed for run in row.runs)
    cells = []
    for row in timed:
        until = [[p for p in run.points if p["wall_clock_s"] <= limit] for run in row.runs]
        until = [points for points in until if points]
        means = [sum(p["success_rate"] for p in points) / len(points) for points in until]
        bests = [max(p["success_rate"] for p in points) for points in until]
        steps = [points[-1]["steps"] for points in until]
        cells.append(
            [
                row.name,
                f"{limit / MINUTE:.0f}{on_threads(row)}",
                _told(estimate(steps) if steps else None, 0),
                _told(estimate(means) if means else None, 3),
                _told(estimate(bests) if bests else None, 3),
            ]
        )
    return markdown(("row", "minutes", "steps until then", "mean SR", "highest SR"), cells)


def draw_all(rows: Sequence[MethodRow], folder: Path) -> list[Drawn]:
    """Curves of the three rates (Figures 6.1 and 6.2).

    :param rows: of the distance task
    :param folder: where to, made if need be
    :return: the figures, in the order of the rates
    """
    folder.mkdir(parents=True, exist_ok=True)
    captions = {
        "success_rate": "SR: both at their targets, the distance kept at every step.",
        "goal_success_rate": "GSR: both at their targets.",
        "constraint_met_rate": "CMR: the distance kept at every step.",
    }
    drawn = []
    for name, caption in captions.items():
        shown = {row.name: _with(row.runs, name) for row in rows if row.n}
        shown = {label: runs for label, runs in shown.items() if runs}
        if not shown:
            continue
        path = folder / f"{name.replace('_', '-')}.png"
        draw_panels([Panel("DualJacoDistance-v0", shown)], name).savefig(path)
        print(f"wrote {path}")
        drawn.append(Drawn(path, caption))
    return drawn


def _with(runs: Sequence[TrainingRun], column: str) -> list[TrainingRun]:
    return [run for run in runs if any(point.get(column) is not None for point in run.points)]


def show(
    rows: Sequence[MethodRow], findings: Sequence[ConstraintFinding], results: Results
) -> None:
    """Print rates, findings, and what was left out.

    :param rows: of the distance task
    :param findings: of chapter 6
    :param results: what was read
    """
    cells = [
        [row.name, str(row.n), *(_told(final_rate(row, name), 3) for name in RATES)]
        for row in rows
        if row.n
    ]
    if cells:
        show_table(("row", "n", "SR", "GSR", "CMR"), cells, title="DualJacoDistance-v0")
    if told := under_way_list(rows):
        print(told)
    show_table(
        ("finding", "in these runs", "evidence"),
        [[one.text, one.verdict, one.evidence] for one in findings],
    )
    for one in results.skipped:
        print(f"left out {one.file}: {one.reason}")


def _told(figure: Estimate | None, digits: int, scale: float = 1.0) -> str:
    return NOTHING if figure is None else figure.text(digits, scale)


def _rate(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.3f}"
