"""Plot the learning curves of training runs, and list the steps to a success rate of 0.9.

"Steps to 0.9" is the first of two consecutive evaluations with at least that success rate. Mean Q
is the student's estimate in the states of its evaluation episodes. Training time excludes
evaluations; it is processor time, or wall-clock time in runs that recorded no other.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from saver_advisors.cli.arguments import add_figure, add_json, add_path, write_json
from saver_advisors.evaluation.metrics import SOLVED, LearningCurve, time_to_level
from saver_advisors.experiments.training_runs import TrainingRun, training_run
from saver_advisors.reporting.curve_style import PENS, dress, line_style
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.reporting.tables import Column, optional, show_rows
from saver_advisors.training.curve_file import read_curve
from saver_advisors.training.run_folder import RECORD_FILE, read_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = """\
examples:
  saver curves runs/push --output push.png
  saver curves runs/dual runs/alone --output advice.png --json advice.json"""

PANELS: Final = (
    ("success_rate", "success rate"),
    ("mean_q", "mean Q of the student"),
    ("cost_collision", "collisions per episode"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_path(parser, "run_dirs", "of `saver train`", metavar="RUN_DIR", nargs="+")
    add_figure(parser, "--output", "draw the figure there")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the table, draw the figure, write the figures."""
    runs = read_runs(args.run_dirs)
    summaries = [summary(one) for one in runs]
    show_rows(summaries, CURVE_COLUMNS)
    if args.output is not None:
        draw(runs).savefig(args.output)
        print(f"wrote {args.output}")
    write_json(args.json, {"kind": "curves", "solved_at": SOLVED, "runs": summaries})
    return 0


def summary(run: TrainingRun) -> dict[str, Any]:
    """Return the figures of a run for tables, and all its points.

    :param run: from :func:`read_run`
    """
    solved, points = run.metrics.solved, run.points
    collisions = [p.get("cost_collision", 0.0) for p in points]
    advice = run.config.get("advice")
    return {
        "name": run.name,
        "env": run.config.get("env_id"),
        "env_kwargs": run.config.get("env_kwargs") or {},
        "world": run.world,
        "algorithm": run.config.get("algorithm"),
        "advice": None if advice is None else advice["strategy"],
        "seed": run.config.get("seed"),
        "steps": points[-1]["steps"],
        "wall_clock_s": points[-1]["wall_clock_s"],
        "steps_to_solved": None if solved.steps is None else int(solved.steps),
        "seconds_to_solved": solved.seconds,
        "best_success_rate": max(p["success_rate"] for p in points),
        "last_success_rate": points[-1]["success_rate"],
        "last_safe_success_rate": points[-1].get("safe_success_rate"),
        "last_success_rate_2cm": points[-1].get("success_rate_2cm"),
        "cost_collision_mean": sum(collisions) / len(collisions),
        "cost_collision_last": collisions[-1],
        "points": points,
    }


def _until_solved(name: str, form: str, unit: float = 1.0) -> Column:
    """Return a column of a figure of ``TimeToLevel``, by the points of a :func:`summary`.

    :param name: of the figure
    :param form: its format
    :param unit: by which it is divided
    """

    def cell(one: Mapping[str, Any]) -> str:
        value = getattr(time_to_level(LearningCurve.from_points(one["points"])), name)
        return "-" if value is None else format(value / unit, form)

    return cell


CURVE_COLUMNS: Final[dict[str, Column]] = {
    "run": "{name}",
    "environment": lambda one: one["env"] or "-",
    "advice": lambda one: one["advice"] or "none",
    "steps": "{steps:,}",
    f"steps to {SOLVED:g}": _until_solved("steps", ",.0f"),
    f"minutes to {SOLVED:g}": _until_solved("seconds", ".1f", 60),
    "best success": "{best_success_rate:.2f}",
    "last success": "{last_success_rate:.2f}",
    "safe": optional("last_safe_success_rate"),
    "within 2 cm": optional("last_success_rate_2cm"),
    "collisions per episode": "{cost_collision_mean:.2f}",
    "last of them": "{cost_collision_last:.2f}",
}
"""Headings, and how a :func:`summary` fills each column."""


def read_runs(folders: Sequence[Path]) -> list[TrainingRun]:
    """Read the curves of several runs.

    :param folders: folders of the runs
    :return: the runs in the same order, with unique names
    :raises UsageError: for a folder that is not a run or has no evaluation yet
    """
    paths = [folder.resolve() for folder in folders]
    short = [path.name for path in paths]
    unique = len(set(short)) == len(short)
    names = short if unique else [f"{path.parent.name}/{path.name}" for path in paths]
    return [read_run(folder, name) for folder, name in zip(folders, names, strict=True)]


def read_run(folder: Path, name: str) -> TrainingRun:
    """Read the curve of a run.

    :param folder: folder of the run
    :param name: label of the run
    :raises UsageError: for a folder that is not a run, is damaged, or has no evaluation yet
    """
    if not (folder / RECORD_FILE).is_file():
        message = f"argument RUN_DIR: {str(folder)!r} is not a run of `saver train`: no run.json"
        raise UsageError(message)
    with user_mistakes("argument RUN_DIR"):
        record = read_record(folder)
        points = read_curve(folder)
    if not points:
        raise UsageError(f"argument RUN_DIR: {str(folder)!r} has no evaluation yet")
    return training_run({**record, "curve": points}, name)


def draw(runs: Sequence[TrainingRun], panels: Sequence[tuple[str, str]] = PANELS) -> Figure:
    """Plot curves over environment steps, on the left, and over training time, on the right.

    :param runs: at least one run
    :param panels: column of the curve and its label, one pair per row; those without a value are
        omitted
    :return: the figure
    """
    from matplotlib.figure import Figure

    points = [point for run in runs for point in run.points]
    panels = [one for one in panels if any(point.get(one[0]) is not None for point in points)]
    figure = Figure(figsize=(10, 0.9 + 2.5 * len(panels)), layout="constrained", dpi=120)
    grid = figure.subplots(len(panels), 2, sharex="col", sharey="row", squeeze=False)
    for row, (name, label) in enumerate(panels):
        for column, (axis, scale) in enumerate((("steps", 1e3), ("seconds", 60.0))):
            axes = grid[row][column]
            for index, run in enumerate(runs):
                x = getattr(run.curve, axis)
                y = np.array([point.get(name) for point in run.points], float)
                pen = PENS[index % len(PENS)]
                drawn = {"color": pen.colour, "linestyle": pen.dashes, **line_style(len(x))}
                axes.plot(x / scale, y, label=run.name, **drawn)
            dress(axes, name)
        grid[row][0].set_ylabel(label)
    grid[-1][0].set_xlabel("environment steps (thousands)")
    grid[-1][1].set_xlabel("training time (minutes)")
    figure.align_ylabels(grid[:, 0])
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside upper center", ncols=min(len(runs), 4), frameon=False
    )
    return figure
