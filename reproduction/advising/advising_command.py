"""Compare advising strategies with Table 5.2 of the dissertation, and evaluate its findings.

The command reads the JSON files of finished and unfinished training runs. Files that are cut short
are listed and left out. The figures are the counterparts of the dissertation's Figures 5.4 to 5.8,
and our own baselines.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from reproduction.advising.paper import NO_ADVICE, ONE_ARM, PaperFigures, table_5_2
from reproduction.command_parts import (
    Drawn,
    add_result_arguments,
    comparison_figures,
    print_skipped,
    save_panels,
    under_way_list,
    write_comparison,
)
from reproduction.findings import (
    MIN_SEEDS,
    Finding,
    claims,
    evaluate_claim,
    table_of,
)
from reproduction.page_templates import page
from saver_advisors.benchmark.run_tables import (
    DEFINITIONS,
    beside,
    beyond,
    flat,
    measured,
    metrics_table,
    origin,
    reference_table,
    run_table,
    skipped_list,
)
from saver_advisors.cli.measured import read_training
from saver_advisors.evaluation.metrics import EPOCH_STEPS, SOLVED
from saver_advisors.experiments.plots import Panel
from saver_advisors.experiments.summary import MethodRow, summarize
from saver_advisors.experiments.training_runs import Results, TrainingRun
from saver_advisors.reporting.tables import (
    Column,
    markdown,
    optional,
    row_cells,
    show_records,
    show_rows,
)

EXAMPLES: Final = """\
examples:
  python -m reproduction advising                               of docs/results/advising
  python -m reproduction advising --results docs/results/advising docs/results/teachers.json \\
      --table docs/advising-results.md --figures docs/results/advising \\
      --json docs/results/advising.json"""

RESULTS: Final = Path("docs/results/advising")
STRATEGIES: Final = ("none", "early", "early-mc", "mc-q 0.1", "mc-act 0.1", "mc-actabs 0.1")
THRESHOLDS: Final = ("mc-q", "mc-act", "mc-actabs")
NUMBERS: Final = {
    ("push", "success_rate"): "5.5",
    ("pick-and-place", "success_rate"): "5.6",
    ("push", "mean_q"): "5.7",
    ("pick-and-place", "mean_q"): "5.8",
}

COLUMNS: Final = ("row", "n", "IE", "RT", "MSR", "ELR")
PAPER_COLUMNS: Final = {
    f"paper: {name}": optional(name, "g" if name in ("IE", "RT") else ".4f") for name in COLUMNS[2:]
}

FEW_NAMES: Final = 3
"""Largest number of missing rows that are named; more are counted."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_result_arguments(parser, RESULTS)


def run(args: argparse.Namespace) -> int:
    """Read and summarise runs, print tables, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    :raises UsageError: if there is no training run.
    """
    results = read_training(args.results)
    tasks = tables(results)
    findings = evaluate_findings(tasks)
    show_all(tasks, findings, results)
    return write_comparison(
        args,
        figures(tasks, findings, results),
        lambda folder: draw_all(tasks, folder),
        lambda pictures: comparison_page(tasks, findings, results, pictures),
    )


def tables(results: Results) -> dict[str, list[MethodRow]]:
    """Summarise the runs of every task, the paper's tasks and the paper's rows first.

    :param results: what was read.
    :return: rows by environment id.
    """
    paper = table_5_2()
    found = {run.task for run in results.runs}
    order = [env for env in paper.tasks.values() if env in found]
    order += sorted(found - set(order))
    return {task: summarize(task, results.of_task(task), paper.rows) for task in order}


def evaluate_findings(tasks: Mapping[str, Sequence[MethodRow]]) -> list[Finding]:
    """Evaluate the paper's claims about the tasks that were run.

    :param tasks: see :func:`tables`.
    :return: the findings.
    """
    paper = table_5_2()
    return [
        evaluate_claim(claim, table_of(tasks[paper.tasks[claim.task]]))
        for claim in claims(paper.rows)
        if paper.tasks[claim.task] in tasks
    ]


def figures(
    tasks: Mapping[str, Sequence[MethodRow]], findings: Sequence[Finding], results: Results
) -> dict[str, Any]:
    """Collect everything that was computed, for JSON.

    :param tasks: see :func:`tables`.
    :param findings: the paper's findings, evaluated.
    :param results: what was read.
    :return: ``rows`` is a flat table, ``detail`` has intervals.
    """
    rows = [row for rows in tasks.values() for row in rows]
    told = [finding.to_mapping() for finding in findings]
    return {
        "title": "Advising",
        "kind": "advising",
        "epoch_steps": EPOCH_STEPS,
        "solved_at": SOLVED,
        **comparison_figures(rows, [flat(row) for row in rows], told, results),
    }


def comparison_page(
    tasks: Mapping[str, Sequence[MethodRow]],
    findings: Sequence[Finding],
    results: Results,
    pictures: Sequence[Mapping[str, str]],
) -> str:
    """Render the page.

    :param tasks: rows by environment id.
    :param findings: the paper's findings, evaluated.
    :param results: what was read.
    :param pictures: ``link`` and ``caption`` of the figures to show.
    :return: Markdown.
    """
    return page(
        "advising",
        definitions=DEFINITIONS,
        min_seeds=MIN_SEEDS,
        findings=findings,
        of_findings=FINDING_COLUMNS,
        tasks=[_task(task, rows) for task, rows in tasks.items()],
        beyond=beyond,
        beside=beside,
        run_table=run_table,
        scratch=scratch_table(tasks),
        references=results.references,
        reference_table=reference_table,
        pictures=pictures,
        skipped=skipped_list(results.skipped),
        origin=origin(results.runs),
    )


def _task(task: str, rows: Sequence[MethodRow]) -> dict[str, Any]:
    """Everything about one environment."""
    finished = [row for row in rows if row.n]
    ours = {env: name for name, env in table_5_2().tasks.items()}
    paper = table_5_2().figures[ours[task]] if task in ours else {}
    references = [row for row in finished if row.name == NO_ADVICE]
    return {
        "name": task,
        "finished": finished,
        "metrics": strategy_table(finished, paper) if paper else metrics_table(finished),
        "pairs": [(row, one) for one in references for row in finished if row is not one],
        "runs": [run for row in finished for run in row.runs],
        "under_way": under_way_list(rows),
        "missing": [name for name in paper if name not in {row.name for row in finished}],
    }


def strategy_table(rows: Sequence[MethodRow], paper: Mapping[str, PaperFigures]) -> str:
    """Render the counterpart of Table 5.2.

    :param rows: rows of a task.
    :param paper: the paper's rows of that task.
    :return: Markdown.
    """
    theirs = row_cells((paper.get(row.name, {}) for row in rows), PAPER_COLUMNS.values())
    cells = [[*measured(row).values(), *told] for row, told in zip(rows, theirs, strict=True)]
    return markdown((*COLUMNS, *PAPER_COLUMNS), cells)


def scratch_table(tasks: Mapping[str, Sequence[MethodRow]]) -> str:
    """Render the epochs to 0.9 without advice, with one arm and with two.

    :param tasks: rows by environment id.
    :return: Markdown; empty without such runs.
    """
    paper = table_5_2()
    cells = []
    for task, two_arms in paper.tasks.items():
        for label, env in (("one arm", ONE_ARM[task]), ("two arms", two_arms)):
            row = next((row for row in tasks.get(env, ()) if row.name == NO_ADVICE), None)
            if row is None or row.steps_to_solved is None:
                continue
            theirs = paper.from_scratch[task][label]
            epochs = row.steps_to_solved.text(scale=1 / EPOCH_STEPS)
            paper_epochs = "never" if theirs is None else f"{theirs:g}"
            cells.append([task, label, str(row.n), epochs, paper_epochs])
    return markdown(("task", "arms", "n", "epochs to 0.9", "paper"), cells) if cells else ""


def _closest(finding: Finding) -> str:
    told = finding.text()
    if missing := finding.missing:
        many = len(missing) > FEW_NAMES
        told += f"; missing: {f'{len(missing)} rows' if many else ', '.join(missing)}"
    return told


SHORT_COLUMNS: Final[Mapping[str, Column]] = {
    "finding": lambda one: one.claim.text,
    "task": lambda one: one.claim.task,
    "in these runs": lambda one: one.verdict,
    "beyond seeds": lambda one: one.beyond_seeds,
    "n": lambda one: str(one.n or "-"),
}
FINDING_COLUMNS: Final = {**SHORT_COLUMNS, "closest comparison": _closest}


def show_all(
    tasks: Mapping[str, Sequence[MethodRow]], findings: Sequence[Finding], results: Results
) -> None:
    """Print the counterparts of Table 5.2, the findings, and the files that were left out.

    :param tasks: rows by environment id.
    :param findings: the paper's findings, evaluated.
    :param results: what was read.
    """
    for task, rows in tasks.items():
        show_records([measured(row) for row in rows if row.n], task)
        if told := under_way_list(rows):
            print(told)
    if findings:
        show_rows(findings, SHORT_COLUMNS)
    print_skipped(results)


Runs = Mapping[str, Sequence[TrainingRun]]
"""Finished runs by row."""


def draw_all(tasks: Mapping[str, Sequence[MethodRow]], folder: Path) -> list[Drawn]:
    """Draw all figures for which there are runs.

    :param tasks: rows by environment id.
    :param folder: folder of the pictures.
    :return: the figures, in the paper's order.
    """
    caption = "Learning from scratch, with one arm and with two (as Figure 5.4)."
    found = {task: {row.name: row.runs for row in rows if row.n} for task, rows in tasks.items()}
    drawn = save_panels(from_scratch(found), "success_rate", folder / "figure-5-4.png", caption)
    by_task = {task: found.get(env, {}) for task, env in table_5_2().tasks.items()}
    for (task, column), number in NUMBERS.items():
        what = "Success" if column == "success_rate" else "The student's mean Q"
        caption = f"{what} in {task}, by strategy and threshold (as Figure {number})."
        path = folder / f"figure-{number.replace('.', '-')}.png"
        drawn += save_panels(strategies(by_task[task]), column, path, caption)
    panels = [panel for task, runs in by_task.items() if (panel := baselines(task, runs))]
    caption = "Baselines that the dissertation does not have."
    return drawn + save_panels(panels, "success_rate", folder / "figure-baselines.png", caption)


def from_scratch(found: Mapping[str, Runs]) -> list[Panel]:
    """Return one panel per task: learning without advice, with one arm and with two."""
    panels = []
    for task, two_arms in table_5_2().tasks.items():
        envs = {"one arm": ONE_ARM[task], "two arms": two_arms}
        of_env = {label: found.get(env, {}) for label, env in envs.items()}
        panels.append(
            Panel(task, {one: by[NO_ADVICE] for one, by in of_env.items() if NO_ADVICE in by})
        )
    return [panel for panel in panels if panel.rows]


def strategies(by_row: Runs) -> list[Panel]:
    """Return a panel of strategies, and one per correcting strategy with its thresholds."""
    panels = [Panel("strategies", _chosen(by_row, STRATEGIES), grey=NO_ADVICE)]
    for name in THRESHOLDS:
        members = [row for row in table_5_2().rows if row.startswith(f"{name} ")]
        if rows := _chosen(by_row, members):
            with_reference = {**_chosen(by_row, [NO_ADVICE]), **rows}
            panels.append(Panel(f"{name}, by threshold", with_reference, grey=NO_ADVICE))
    return [panel for panel in panels if panel.rows]


def baselines(task: str, by_row: Runs) -> Panel | None:
    """Return a panel of the rows beyond Table 5.2, with early and no advising for comparison."""
    beyond = sorted(row for row in by_row if row not in table_5_2().rows)
    if not beyond:
        return None
    return Panel(task, _chosen(by_row, (NO_ADVICE, "early", *beyond)), grey=NO_ADVICE)


def _chosen(by_row: Runs, names: Sequence[str]) -> Runs:
    return {name: by_row[name] for name in names if name in by_row}
