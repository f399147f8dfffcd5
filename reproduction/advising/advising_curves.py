"""Draw the counterparts of the dissertation's Figures 5.4 to 5.8, and our own baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from reproduction.advising.paper import NO_ADVICE, ONE_ARM, table_5_2
from reproduction.command_parts import save_panels
from saver_advisors.experiments.plots import Panel
from saver_advisors.experiments.training_runs import Results, TrainingRun
from saver_advisors.reporting.figures import Drawn

STRATEGIES: Final = ("none", "early", "early-mc", "mc-q 0.1", "mc-act 0.1", "mc-actabs 0.1")
THRESHOLDS: Final = ("mc-q", "mc-act", "mc-actabs")
NUMBERS: Final = {
    ("push", "success_rate"): "5.5",
    ("pick-and-place", "success_rate"): "5.6",
    ("push", "mean_q"): "5.7",
    ("pick-and-place", "mean_q"): "5.8",
}


def draw_all(results: Results, folder: Path) -> list[Drawn]:
    """Draw all figures for which there are runs.

    :param results: the training runs.
    :param folder: folder of the pictures, created if missing.
    :return: the figures, in the paper's order.
    """
    folder.mkdir(parents=True, exist_ok=True)
    caption = "Learning from scratch, with one arm and with two (as Figure 5.4)."
    drawn = save_panels(from_scratch(results), "success_rate", folder / "figure-5-4.png", caption)
    tasks = table_5_2().tasks
    for (task, column), number in NUMBERS.items():
        what = "Success" if column == "success_rate" else "The student's mean Q"
        caption = f"{what} in {task}, by strategy and threshold (as Figure {number})."
        path = folder / f"figure-{number.replace('.', '-')}.png"
        drawn += save_panels(strategies(results.of_task(tasks[task])), column, path, caption)
    panels = [panel for task in tasks if (panel := baselines(task, results.of_task(tasks[task])))]
    caption = "Baselines that the dissertation does not have."
    return drawn + save_panels(panels, "success_rate", folder / "figure-baselines.png", caption)


def from_scratch(results: Results) -> list[Panel]:
    """Return one panel per task: learning without advice, with one arm and with two."""
    panels = []
    for task, two_arms in table_5_2().tasks.items():
        rows = {}
        for label, env in (("one arm", ONE_ARM[task]), ("two arms", two_arms)):
            if runs := _finished(results.of_task(env).get(NO_ADVICE, ())):
                rows[label] = runs
        if rows:
            panels.append(Panel(task, rows))
    return panels


def strategies(by_row: Mapping[str, Sequence[TrainingRun]]) -> list[Panel]:
    """Return a panel of strategies, and one per correcting strategy with its thresholds."""
    panels = [Panel("strategies", _chosen(by_row, STRATEGIES), grey=NO_ADVICE)]
    for name in THRESHOLDS:
        members = [row for row in table_5_2().rows if row.startswith(f"{name} ")]
        if rows := _chosen(by_row, members):
            with_reference = {**_chosen(by_row, [NO_ADVICE]), **rows}
            panels.append(Panel(f"{name}, by threshold", with_reference, grey=NO_ADVICE))
    return [panel for panel in panels if panel.rows]


def baselines(task: str, by_row: Mapping[str, Sequence[TrainingRun]]) -> Panel | None:
    """Return a panel of the rows beyond Table 5.2, with early and no advising for comparison."""
    beyond = sorted(row for row in by_row if row not in table_5_2().rows)
    rows = _chosen(by_row, beyond)
    if not rows:
        return None
    return Panel(task, {**_chosen(by_row, (NO_ADVICE, "early")), **rows}, grey=NO_ADVICE)


def _chosen(
    by_row: Mapping[str, Sequence[TrainingRun]], names: Sequence[str]
) -> dict[str, Sequence[TrainingRun]]:
    found = {name: _finished(by_row.get(name, ())) for name in names}
    return {name: runs for name, runs in found.items() if runs}


def _finished(runs: Sequence[TrainingRun]) -> list[TrainingRun]:
    return [run for run in runs if run.finished]
