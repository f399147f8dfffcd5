"""Tables of rows and runs in Markdown, for every page that compares training runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, Final

from saver_advisors.evaluation.metrics import EPOCH_STEPS, area_under_curve
from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.evaluation.statistics import Estimate, probability_of_improvement, ratio
from saver_advisors.experiments.summary import MINUTE, Censored, MethodRow
from saver_advisors.experiments.training_runs import Skipped, TrainingRun
from saver_advisors.reporting.evaluation_table import EVALUATION_COLUMNS
from saver_advisors.reporting.tables import markdown

NOTHING: Final = "-"

DEFINITIONS: Final = f"""\
An epoch is {EPOCH_STEPS:,} environment steps, and n counts finished seeds. A figure over several
seeds is their interquartile mean (of three or fewer, their mean) with a 95% bootstrap interval over
seeds in brackets; over a single seed there is no interval, and with two it just reaches from one to
the other.

- **IE**: epochs at the first evaluation with 10% of the run's own maximum success rate
- **RT**: epochs from there to 90% of it
- **MSR**: that maximum
- **ELR**: 0.9 MSR over the epochs that it took to get there
- **to 0.9**: the first evaluation with a success rate of 0.9; where a run ended before, its length
  stands in, and the figure is a lower bound
- **all steps**: the teacher's training and demonstrations counted as well
- **minutes**: of training, evaluations not counted; **load** is the system's, the median over the
  run: where it is above the machine's cores, minutes say little
- **final success**: of the last policy, on report seeds, which had no part in anything before; the
  **chosen checkpoint** was best on the seeds of the curve, and is measured on the report seeds too
- **mean success**: the area under the curve, over the steps that all rows of the task did
- **advice over by**: steps of the run at the first evaluation after its last advice
- **collisions per episode**: steps with contact between arms, or of an arm with the table or with
  another arm's cube
"""


def measured(row: MethodRow) -> list[str]:
    """Seeds and the four figures of the paper's table.

    :param row: of a task
    :return: the cells n, IE, RT, MSR, ELR
    """
    return [
        str(row.n),
        _text(row.inspired_epoch, 0),
        _text(row.rise_time, 0),
        _text(row.maximum_success_rate, 3),
        _text(row.effective_learning_rate, 4),
    ]


def metrics_table(rows: Sequence[MethodRow]) -> str:
    """Seeds and the four figures of the paper's table, a row each.

    :param rows: of a task
    :return: Markdown
    """
    return markdown(
        ("row", "n", "IE", "RT", "MSR", "ELR"), [[row.name, *measured(row)] for row in rows]
    )


def beyond(rows: Sequence[MethodRow]) -> str:
    """What the paper's table does not have: costs, censored times, final success.

    :param rows: of a task
    :return: Markdown
    """
    columns = (
        "row",
        "n",
        "steps to 0.9",
        "minutes to 0.9",
        "all steps to 0.9",
        "final success",
        "mean success",
        "advice used",
        "advice over by",
        "steps before the run",
        "minutes in all",
        "collisions per episode",
    )
    cells = [
        [
            row.name,
            str(row.n),
            _text(row.steps_to_solved),
            _text(row.seconds_to_solved, 1, 1 / MINUTE),
            _text(row.all_steps_to_solved),
            _text(row.final_success, 3),
            _text(row.area, 3),
            _value(row.advice_spent, 0),
            _text(row.advice_over, 0),
            " or ".join(f"{steps:,}" for steps in row.steps_before) or "unknown",
            _value(row.wall_clock_s, 1, 1 / MINUTE),
            _text(row.collisions, 2),
        ]
        for row in rows
    ]
    return markdown(columns, cells)


def beside(pairs: Sequence[tuple[MethodRow, MethodRow]]) -> str:
    """Rows against others: how many times as soon, and how likely better.

    :param pairs: a row, and the one that it is compared with, of the same task
    :return: Markdown
    """
    columns = (
        "row",
        "beside",
        "n",
        "times as few steps to 0.9",
        "times as few minutes to 0.9",
        "probability of a higher mean success",
    )
    cells = [
        [
            row.name,
            other.name,
            f"{row.n} and {other.n}",
            speed_up(row.steps_to_solved, other.steps_to_solved),
            speed_up(row.seconds_to_solved, other.seconds_to_solved),
            likely_better(row, other),
        ]
        for row, other in pairs
    ]
    return markdown(columns, cells)


def likely_better(row: MethodRow, reference: MethodRow) -> str:
    """How likely a run's mean success is higher than that of a run of another row.

    :param row: of a task
    :param reference: of the same task
    :return: with its interval; nothing where either is a single run, which says 0 or 1
    """
    found = probability_of_improvement(areas(row), areas(reference))
    return NOTHING if found.interval is None else found.text()


def areas(row: MethodRow) -> list[float]:
    """Each seed's mean success over the task's common steps."""
    return [area_under_curve(run.curve, row.budget) for run in row.runs]


def speed_up(row: Censored | None, reference: Censored | None) -> str:
    """How many times as soon one reached what the other did.

    :param row: when the one did
    :param reference: when the other did
    :return: the ratio; a bound where either never did in some seed, nothing where both did not
    """
    if row is None or reference is None or (row.never and reference.never):
        return NOTHING
    found = ratio(reference.values, row.values)
    if not row.never and not reference.never:
        return found.text()
    return f"{'<' if row.never else '>'} {found.value:.2f}"


RUN_COLUMNS: Final = (
    "row",
    "seed",
    "steps",
    "MSR",
    "last success",
    "steps to 0.9",
    "final success, interval over episodes",
    "chosen checkpoint",
    "advice used",
    "minutes",
    "load",
)


def run_table(runs: Sequence[TrainingRun]) -> str:
    """Every run with its own figures, failed ones too.

    :param runs: in the order of the table
    :return: Markdown
    """
    cells = []
    for run in runs:
        solved = run.metrics.solved
        cells.append(
            [
                run.row,
                str(run.seed),
                f"{run.curve.steps[-1]:,.0f}",
                f"{run.metrics.maximum_success_rate:.3f}",
                f"{run.curve.success[-1]:.3f}",
                "never" if solved.steps is None else f"{solved.steps:,.0f}",
                outcome_cell(run.final),
                outcome_cell(run.chosen),
                f"{run.advice_spent:,}",
                NOTHING if solved.observed_s is None else f"{solved.observed_s / MINUTE:.1f}",
                _load(run),
            ]
        )
    return markdown(RUN_COLUMNS, cells)


def _load(run: TrainingRun) -> str:
    """The median of the load averages at its evaluations, where it tells them."""
    told = [value for point in run.points if (value := point.get("load_average")) is not None]
    return f"{median(told):.1f}" if told else NOTHING


def outcome_cell(outcome: Mapping[str, Any] | None) -> str:
    """Success on report seeds with its interval over episodes, and how many they were.

    :param outcome: of an evaluation, None where there was none
    :return: the cell
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
    """Policies that were not trained in these runs, such as two teachers side by side.

    :param references: evaluations
    :return: Markdown
    """
    cells = []
    for one in references:
        collisions = (one.get("cost_means") or {}).get("cost_collision")
        low, high = one["ci95"]
        cells.append(
            [
                environment_text(str(one["env"]), one.get("env_kwargs") or {}),
                str(one["policy"]),
                str(one["episodes"]),
                f"{one['success_rate']:.3f}",
                f"{low:.3f} to {high:.3f}",
                NOTHING if collisions is None else f"{collisions:.2f}",
            ]
        )
    return markdown((*EVALUATION_COLUMNS[:5], "collisions per episode"), cells)


def under_way_list(rows: Sequence[MethodRow]) -> str:
    """The runs that are not finished, which no figure counts; nothing where there is none."""
    told = [
        f"{row.name} seed {run.seed} ({run.curve.steps[-1]:,.0f} steps, success "
        f"{run.curve.success[-1]:.2f})"
        for row in rows
        for run in row.under_way
    ]
    return f"Not finished, and not counted: {'; '.join(told)}.\n" if told else ""


def skipped_list(skipped: Sequence[Skipped]) -> str:
    """The files that were left out, and why; nothing where there is none."""
    if not skipped:
        return ""
    lines = [f"- `{one.file}` {one.reason}" for one in skipped]
    return "\n".join(["## Left out", "", *lines]) + "\n"


def origin(runs: Sequence[TrainingRun]) -> str:
    """Commits and machines of the runs, each once."""
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


def _text(figure: Estimate | Censored | None, digits: int = 0, scale: float = 1.0) -> str:
    return NOTHING if figure is None else figure.text(digits, scale)


def _value(figure: Estimate | None, digits: int, scale: float = 1.0) -> str:
    """Without its interval, which of a cost that is set beforehand says nothing."""
    return NOTHING if figure is None else f"{scale * figure.value:,.{digits}f}"


def flat(row: MethodRow) -> dict[str, Any]:
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
