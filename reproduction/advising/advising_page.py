"""The page of ``python -m reproduction advising``, and its short form on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from reproduction.advising.paper import NO_ADVICE, ONE_ARM, PaperFigures, table_5_2
from reproduction.findings import MIN_SEEDS, Finding
from saver_advisors.benchmark.run_tables import (
    DEFINITIONS,
    beside,
    beyond,
    measured,
    origin,
    reference_table,
    run_table,
    skipped_list,
    under_way_list,
)
from saver_advisors.evaluation.metrics import EPOCH_STEPS
from saver_advisors.experiments.summary import MethodRow
from saver_advisors.experiments.training_runs import Results
from saver_advisors.reporting.figures import Drawn, link
from saver_advisors.reporting.tables import markdown
from saver_advisors.reporting.tables import show as show_table

INTRODUCTION: Final = """\
Rendered by `python -m reproduction advising` from the files of the runs, never typed. The paper's
epochs are others than ours, so orderings and ratios can be compared, the epochs themselves cannot.
*Paper* is Table 5.2 of the dissertation.
"""

BESIDE: Final = """\
How many times as soon as without advice a success rate of 0.9 was seen, and how likely a run's mean
success lies above that of one without advice:
"""

FINDINGS: Final = f"""\
What the paper reads off its table, computed from these runs. *In these runs*: it holds where every
row that it is about comes out so by more than the evaluations can tell apart, so far where rows are
missing that could still refute it; it does not hold where one comes out the other way by as much,
and cannot be told where two rows are too close or none can be compared. *Beyond seeds* asks for
{MIN_SEEDS} seeds a row and a 95% interval that leaves out no difference: with fewer seeds, other
seeds could turn it round. The closest comparison is the one that comes nearest to refuting it, or
does.
"""

SCRATCH: Final = """\
Epochs to a success rate of 0.9 from scratch, as the paper tells them beside its Figure 5.4:
"""

FEW_NAMES: Final = 3
"""So many missing rows are named, more are counted."""


def page(
    tasks: Mapping[str, Sequence[MethodRow]],
    findings: Sequence[Finding],
    results: Results,
    drawn: Sequence[Drawn],
    folder: Path,
) -> str:
    """The page.

    :param tasks: rows by environment
    :param findings: of the paper
    :param results: what was read
    :param drawn: figures to show
    :param folder: of the page, which the figures are linked from
    :return: Markdown
    """
    parts = ["# Advising, measured", INTRODUCTION, DEFINITIONS]
    if findings:
        parts += ["## The paper's findings", FINDINGS, finding_table(findings)]
    for task, rows in tasks.items():
        parts += [f"## {task}", *_task(task, rows)]
    if scratch := scratch_table(tasks):
        parts += ["## Without advice", SCRATCH, scratch]
    if results.references:
        parts += ["## Without training", reference_table(results.references)]
    if drawn:
        parts.append("## Curves")
        parts.append("Thin: seeds; thick: their interquartile mean.\n")
        for one in drawn:
            parts.append(f"![{one.caption}]({link(one.path, folder)})\n\n{one.caption}\n")
    parts.append(skipped_list(results.skipped))
    parts.append(origin(results.runs))
    return "\n".join(part.rstrip("\n") + "\n" for part in parts if part)


def _task(task: str, rows: Sequence[MethodRow]) -> list[str]:
    """Everything about one environment."""
    finished = [row for row in rows if row.n]
    paper = table_5_2().of_environment(task)
    parts = []
    if finished:
        parts = [strategy_table(finished, paper), beyond(finished)]
        reference = next((row for row in finished if row.name == NO_ADVICE), None)
        others = [row for row in finished if row.name != NO_ADVICE]
        if reference is not None and others:
            parts += [BESIDE, beside([(row, reference) for row in others])]
        parts += ["Each run:\n", run_table([run for row in finished for run in row.runs])]
    parts.append(under_way_list(rows))
    missing = [name for name in paper if name not in {row.name for row in finished}]
    if missing:
        parts.append(f"Rows of the paper's without a finished run: {', '.join(missing)}.\n")
    return parts


def strategy_table(rows: Sequence[MethodRow], paper: Mapping[str, PaperFigures]) -> str:
    """The counterpart of Table 5.2.

    :param rows: of a task
    :param paper: the paper's rows of that task, none where it has no such task
    :return: Markdown
    """
    columns = ["row", "n", "IE", "RT", "MSR", "ELR"]
    if paper:
        columns += [f"paper: {name}" for name in ("IE", "RT", "MSR", "ELR")]
    cells = []
    for row in rows:
        cells.append([row.name, *measured(row)])
        if paper:
            cells[-1] += _paper_cells(paper.get(row.name))
    return markdown(columns, cells)


def scratch_table(tasks: Mapping[str, Sequence[MethodRow]]) -> str:
    """Epochs to 0.9 without advice, with one arm and with two; nothing where none was run.

    :param tasks: rows by environment
    :return: Markdown
    """
    paper = table_5_2()
    cells = []
    for task, two_arms in paper.tasks.items():
        for label, env in (("one arm", ONE_ARM[task]), ("two arms", two_arms)):
            row = next((row for row in tasks.get(env, ()) if row.name == NO_ADVICE), None)
            if row is None or row.steps_to_solved is None:
                continue
            theirs = paper.from_scratch[task][label]
            cells.append(
                [
                    task,
                    label,
                    str(row.n),
                    row.steps_to_solved.text(scale=1 / EPOCH_STEPS),
                    "never" if theirs is None else f"{theirs:g}",
                ]
            )
    return markdown(("task", "arms", "n", "epochs to 0.9", "paper"), cells) if cells else ""


def _paper_cells(one: PaperFigures | None) -> list[str]:
    if one is None:
        return ["-"] * 4
    epochs = ["-" if v is None else f"{v:g}" for v in (one.inspired_epoch, one.rise_time)]
    rate = one.effective_learning_rate
    return [*epochs, f"{one.maximum_success_rate:.4f}", "-" if rate is None else f"{rate:.4f}"]


FINDING_COLUMNS: Final = (
    "finding",
    "task",
    "in these runs",
    "beyond seeds",
    "n",
    "closest comparison",
)


def finding_cells(finding: Finding) -> list[str]:
    """A row of the table of findings, in the order of ``FINDING_COLUMNS``.

    :param finding: of the paper
    :return: the cells
    """
    told = finding.text()
    if missing := finding.missing:
        many = len(missing) > FEW_NAMES
        told += f"; missing: {f'{len(missing)} rows' if many else ', '.join(missing)}"
    counted = str(finding.n) if finding.n else "-"
    return [
        finding.claim,
        finding.task,
        finding.verdict,
        finding.beyond_seeds,
        counted,
        told,
    ]


def finding_table(findings: Sequence[Finding]) -> str:
    """The findings with the figures that decide them.

    :param findings: of the paper
    :return: Markdown
    """
    return markdown(FINDING_COLUMNS, [finding_cells(finding) for finding in findings])


def show(
    tasks: Mapping[str, Sequence[MethodRow]], findings: Sequence[Finding], results: Results
) -> None:
    """Print the tables of Table 5.2's figures, the findings, and what was left out.

    :param tasks: rows by environment
    :param findings: of the paper
    :param results: what was read
    """
    for task, rows in tasks.items():
        columns = ("row", "n", "IE", "RT", "MSR", "ELR")
        cells = [[row.name, *measured(row)] for row in rows if row.n]
        if cells:
            show_table(columns, cells, title=task)
        if told := under_way_list(rows):
            print(told)
    if findings:
        show_table(FINDING_COLUMNS[:5], [finding_cells(one)[:5] for one in findings])
    for one in results.skipped:
        print(f"left out {one.file}: {one.reason}")
