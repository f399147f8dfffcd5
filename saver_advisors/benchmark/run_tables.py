"""Tables of rows and runs in Markdown, for the pages that compare training runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, Final

from saver_advisors.evaluation.metrics import EPOCH_STEPS
from saver_advisors.evaluation.statistics import Estimate, probability_of_improvement, ratio
from saver_advisors.experiments.summary import MINUTE, Censored, MethodRow
from saver_advisors.experiments.training_runs import Skipped, TrainingRun
from saver_advisors.reporting.evaluation_table import COLLISIONS_COLUMN, EVALUATION_COLUMNS
from saver_advisors.reporting.tables import records_table, rows_table

NOTHING: Final = "-"

FINAL_RATES: Final = ("final success", "safe", "within 2 cm")
"""Headings of the success rates of last policies."""

DEFINITIONS: Final = f"""\
An epoch is {EPOCH_STEPS:,} environment steps, and n counts finished seeds. A figure over several
seeds is their interquartile mean (of three or fewer, their mean) with a 95% bootstrap interval over
seeds in brackets; over a single seed there is no interval, and with two it just reaches from one to
the other.

- **IE**: epochs at the first evaluation with 10% of the run's own maximum success rate
- **RT**: epochs from there to 90% of it
- **MSR**: that maximum
- **ELR**: 0.9 MSR over the epochs that it took to get there
- **to 0.9**: the first of two consecutive evaluations with a success rate of 0.9; where a run ended
  before, its length stands in, and the figure is a lower bound
- **all steps**: the teacher's training and demonstrations counted as well
- **minutes**: of training, evaluations not counted: processor time, or wall-clock time in older
  results; **load** is the system's, the median over the run: where it is above the machine's cores,
  wall-clock time says little
- **final success**: of the last policy, on report seeds, which had no part in anything before; the
  **chosen checkpoint** was best on the seeds of the curve, and is measured on the report seeds too
- **safe**: of those, without a step with a collision; **within 2 cm**: of those, with every object
  within 2 cm of its target at the end
- **mean success**: the area under the curve, over the steps that all rows of the task did
- **advice over by**: steps of the run at the first evaluation after its last advice
- **collisions per episode**: steps with contact between arms, or of an arm with the table or with
  another arm's cube
"""


def measured(row: MethodRow) -> dict[str, str]:
    """Format the number of seeds and the four metrics of the paper's table, by heading.

    :param row: of a task
    """
    return {
        "row": row.name,
        "n": str(row.n),
        "IE": figure_text(row.inspired_epoch, 0),
        "RT": figure_text(row.rise_time, 0),
        "MSR": figure_text(row.maximum_success_rate, 3),
        "ELR": figure_text(row.effective_learning_rate, 4),
    }


def final_rates(row: MethodRow) -> dict[str, str]:
    """Format the success rates of the last policies, by heading.

    :param row: of a task
    :return: an entry for each of :data:`FINAL_RATES`
    """
    rates = (row.final_success, row.final_safe_success, row.final_success_2cm)
    return {name: figure_text(rate, 3) for name, rate in zip(FINAL_RATES, rates, strict=True)}


def metrics_table(rows: Sequence[MethodRow]) -> str:
    """Tabulate the number of seeds and the four metrics of the paper's table.

    :param rows: of a task
    :return: Markdown
    """
    return records_table(map(measured, rows))


def beyond(rows: Sequence[MethodRow]) -> str:
    """Tabulate what the paper's table lacks: costs, censored times, final success.

    :param rows: of a task, at least one
    :return: Markdown
    """
    # Older results have no rates but the first.
    shown = {name for row in rows for name, text in final_rates(row).items() if text != NOTHING}
    shown.add(FINAL_RATES[0])
    return records_table(
        {
            "row": row.name,
            "n": str(row.n),
            "steps to 0.9": figure_text(row.steps_to_solved),
            "minutes to 0.9": figure_text(row.seconds_to_solved, 1, 1 / MINUTE),
            "all steps to 0.9": figure_text(row.all_steps_to_solved),
            **{name: text for name, text in final_rates(row).items() if name in shown},
            "mean success": figure_text(row.area, 3),
            "advice used": _value(row.advice_spent, 0),
            "advice over by": figure_text(row.advice_over, 0),
            "steps before the run": " or ".join(f"{one:,}" for one in row.steps_before)
            or "unknown",
            "minutes in all": _value(row.training_s, 1, 1 / MINUTE),
            "collisions per episode": figure_text(row.collisions, 2),
        }
        for row in rows
    )


def beside(pairs: Sequence[tuple[MethodRow, MethodRow]]) -> str:
    """Tabulate how much sooner rows reach 0.9 than others, and how likely they are better.

    :param pairs: a row, and the one that it is compared with, of the same task; at least one
    :return: Markdown
    """
    return records_table(
        {
            "row": row.name,
            "beside": other.name,
            "n": f"{row.n} and {other.n}",
            "times as few steps to 0.9": speed_up(row.steps_to_solved, other.steps_to_solved),
            "times as few minutes to 0.9": speed_up(row.seconds_to_solved, other.seconds_to_solved),
            "probability of a higher mean success": likely_better(row, other),
        }
        for row, other in pairs
    )


def likely_better(row: MethodRow, reference: MethodRow) -> str:
    """Format the probability that a run's mean success is higher than that of another row's run.

    :param row: of a task
    :param reference: of the same task
    :return: with its interval; a dash if either has a single run
    """
    found = probability_of_improvement(row.areas, reference.areas)
    return NOTHING if found.interval is None else found.text()


def speed_up(row: Censored | None, reference: Censored | None) -> str:
    """Format how many times sooner one row reached a level than another.

    :param row: time of the row
    :param reference: time of the other row
    :return: the ratio; a bound if one of them never reached it in some seed, a dash if both
    """
    if row is None or reference is None or (row.never and reference.never):
        return NOTHING
    found = ratio(reference.values, row.values)
    if not row.never and not reference.never:
        return found.text()
    return f"{'<' if row.never else '>'} {found.value:.2f}"


def run_table(runs: Sequence[TrainingRun]) -> str:
    """Tabulate every run with its own figures, including failed ones.

    :param runs: in the order of the table, at least one
    :return: Markdown
    """
    return records_table(map(_run_cells, runs))


def _run_cells(run: TrainingRun) -> dict[str, str]:
    solved = run.metrics.solved
    return {
        "row": run.row,
        "seed": str(run.seed),
        "steps": f"{run.curve.steps[-1]:,.0f}",
        "MSR": f"{run.metrics.maximum_success_rate:.3f}",
        "last success": f"{run.curve.success[-1]:.3f}",
        "steps to 0.9": "never" if solved.steps is None else f"{solved.steps:,.0f}",
        "final success, interval over episodes": outcome_cell(run.final),
        "chosen checkpoint": outcome_cell(run.chosen),
        "advice used": f"{run.advice_spent:,}",
        "minutes": NOTHING if solved.observed_s is None else f"{solved.observed_s / MINUTE:.1f}",
        "load": _load(run),
    }


def _load(run: TrainingRun) -> str:
    """Format the median of the load averages at its evaluations."""
    told = [value for point in run.points if (value := point.get("load_average")) is not None]
    return f"{median(told):.1f}" if told else NOTHING


def outcome_cell(outcome: Mapping[str, Any] | None) -> str:
    """Format a success rate with its interval over episodes and their number.

    :param outcome: of an evaluation, or None
    """
    if outcome is None or outcome.get("success_rate") is None:
        return NOTHING
    told = f"{outcome['success_rate']:.3f}"
    if ends := outcome.get("ci95"):
        told += f", {ends[0]:.3f} to {ends[1]:.3f}"
    if episodes := outcome.get("episodes"):
        told += f" of {episodes}"
    return told


def reference_table(references: Sequence[Mapping[str, Any]]) -> str:
    """Tabulate policies that were not trained in these runs, such as two teachers side by side.

    :param references: evaluations
    :return: Markdown
    """
    columns = {**EVALUATION_COLUMNS, **COLLISIONS_COLUMN}
    del columns["final distance (cm)"]
    return rows_table(references, columns)


def skipped_list(skipped: Sequence[Skipped]) -> str:
    """List the omitted files and the reasons; empty without any."""
    if not skipped:
        return ""
    lines = [f"- `{one.file}` {one.reason}\n" for one in skipped]
    return "".join(["## Left out\n\n", *lines])


def origin(runs: Sequence[TrainingRun]) -> str:
    """List the distinct commits and machines of the runs."""
    commits = {str(run.provenance.get("commit") or "")[:12] for run in runs} - {""}
    machines = {
        f"{machine['cpu']}, {machine['cores']} cores"
        for run in runs
        if (machine := run.provenance.get("machine"))
    }
    parts = []
    if commits:
        parts.append("Commits: " + ", ".join(f"`{commit}`" for commit in sorted(commits)) + ".")
    if machines:
        parts.append("Machines: " + "; ".join(sorted(machines)) + ".")
    return " ".join(parts)


def figure_text(figure: Estimate | Censored | None, digits: int = 0, scale: float = 1.0) -> str:
    """Format a figure with its interval.

    :param figure: of a row, or None
    :param digits: after the decimal point
    :param scale: factor of all numbers
    :return: the text; a dash without a figure
    """
    return NOTHING if figure is None else figure.text(digits, scale)


def _value(figure: Estimate | None, digits: int, scale: float = 1.0) -> str:
    """Format without the interval, which is meaningless for a cost that is set beforehand."""
    return NOTHING if figure is None else f"{scale * figure.value:,.{digits}f}"


def flat(row: MethodRow) -> dict[str, Any]:
    """Return a row's figures without their intervals.

    :param row: of a task
    :return: one number per figure, None if it is missing
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
