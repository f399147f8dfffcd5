"""Render the leaderboard from the results of the baselines and of submissions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from reproduction.page_templates import page
from saver_advisors.benchmark.run_tables import figure_text, final_rates, origin
from saver_advisors.benchmark.submission import read_checked
from saver_advisors.cli.catalogue import dense_twin, sparse_ids
from saver_advisors.evaluation.protocol import SEEDS
from saver_advisors.experiments.summary import MINUTE, MethodRow, summarize
from saver_advisors.experiments.training_runs import TrainingRun, training_run
from saver_advisors.reporting.tables import Column
from saver_envs.registration import default_options

FOLDERS: Final = {"baselines": "baseline", "leaderboard": "-"}
"""Folders of results, and what stands for who submitted a file that does not tell."""


@dataclass(frozen=True)
class Entry:
    """A method on the leaderboard.

    :param row: its runs.
    :param by: who submitted it.
    :param link: to its page, or None.
    """

    row: MethodRow
    by: str
    link: str | None

    @property
    def rank(self) -> tuple[bool, float, str]:
        """What the table is sorted by: methods with all seeds first, then success."""
        success = self.row.final_success
        return self.row.n < SEEDS, 0.0 if success is None else -success.value, self.row.name


COLUMNS: Final[dict[str, Column]] = {
    "method": lambda one: f"[{one.row.name}]({one.link})" if one.link else one.row.name,
    "by": lambda one: one.by,
    "n": lambda one: f"{one.row.n}" if one.row.n >= SEEDS else f"**{one.row.n} of {SEEDS}**",
    "success": lambda one: final_rates(one.row)["final success"],
    "safe success": lambda one: final_rates(one.row)["safe"],
    "within 2 cm": lambda one: final_rates(one.row)["within 2 cm"],
    "steps to 0.9": lambda one: figure_text(one.row.steps_to_solved),
    "processor minutes": lambda one: figure_text(one.row.training_s, 1, 1 / MINUTE),
    "budget": lambda one: _budget(one.row),
    "training": lambda one: _training(one.row.runs[0]),
}


def leaderboard_page(results: Path) -> str:
    """Render the leaderboard.

    :param results: folder with the folders of the baselines and of the submissions.
    :return: Markdown.
    """
    twins = {dense_twin(env_id): env_id for env_id in sparse_ids()}
    tables: dict[str, list[Entry]] = {env_id: [] for env_id in sparse_ids()}
    skipped = []
    for folder, nobody in FOLDERS.items():
        contents, refused = read_checked(sorted((results / folder).glob("*.json")))
        skipped += refused
        for entry in _entries(contents, nobody):
            tables[twins.get(entry.row.task, entry.row.task)].append(entry)
    return page(
        "leaderboard",
        tables={env_id: sorted(rows, key=lambda one: one.rank) for env_id, rows in tables.items()},
        columns=COLUMNS,
        seeds=SEEDS,
        skipped=skipped,
        origin=origin([run for rows in tables.values() for one in rows for run in one.row.runs]),
    )


def _entries(contents: Sequence[Mapping[str, Any]], nobody: str) -> list[Entry]:
    """Return the methods of a folder's results."""
    told = {one["file"]: one.get("submission") or {} for one in contents}
    tasks: dict[str, dict[str, list[TrainingRun]]] = {}
    for one in contents:
        run = replace(training_run(one, one["file"]), file=one["file"])
        tasks.setdefault(one["task"], {}).setdefault(run.row, []).append(run)
    rows = [row for task, by_row in tasks.items() for row in summarize(task, by_row)]
    told_of = [(row, told[row.runs[0].file]) for row in rows]
    return [Entry(row, given.get("by", nobody), given.get("link")) for row, given in told_of]


def _budget(row: MethodRow) -> str:
    """Return the environment steps of the runs, and those before them."""
    budgets = sorted({int(run.config["total_steps"]) for run in row.runs})
    before = [steps for steps in row.steps_before if steps]
    told = " or ".join(f"{steps:,}" for steps in budgets)
    return f"{told}, after {' or '.join(f'{steps:,}' for steps in before)}" if before else told


def _training(run: TrainingRun) -> str:
    """Say in what the episodes of training differ from those of the evaluations."""
    told = ["dense reward"] if run.task not in sparse_ids() else []
    usual, options = default_options(run.task), run.config.get("train_env_kwargs") or {}
    told += [f"`{name}={value}`" for name, value in options.items() if usual.get(name) != value]
    return ", ".join(told) or "-"
