"""Read, summarize and plot the learning curves of training runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.evaluation.metrics import SOLVED, LearningCurve, time_to_level
from saver_advisors.reporting.curve_style import PENS, dress, line_style
from saver_advisors.reporting.errors import UsageError, user_mistakes
from saver_advisors.reporting.tables import Column
from saver_advisors.training.curve_file import read_curve
from saver_advisors.training.run_folder import RECORD_FILE, read_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANELS: Final = (
    ("success_rate", "success rate"),
    ("mean_q", "mean Q of the student"),
    ("cost_collision", "collisions per episode"),
)


@dataclass(frozen=True)
class RunCurve:
    """A run's curve.

    :param name: label in legends and tables
    :param config: settings of the run
    :param points: one mapping per evaluation, the lines of ``curve.jsonl``
    :param world: digest of the run's world, None for older runs
    """

    name: str
    config: dict[str, Any]
    points: list[dict[str, Any]]
    world: str | None = None

    def values(self, name: str) -> list[float]:
        """Return a column of the curve, with NaN for missing values."""
        return [float("nan") if p.get(name) is None else float(p[name]) for p in self.points]

    def summary(self) -> dict[str, Any]:
        """Return the run's figures for tables, and all its points."""
        solved = time_to_level(LearningCurve.from_points(self.points))
        rates = [p["success_rate"] for p in self.points]
        collisions = [p.get("cost_collision", 0.0) for p in self.points]
        advice = self.config.get("advice")
        return {
            "name": self.name,
            "env": self.config.get("env_id"),
            "env_kwargs": self.config.get("env_kwargs") or {},
            "world": self.world,
            "algorithm": self.config.get("algorithm"),
            "advice": None if advice is None else advice["strategy"],
            "seed": self.config.get("seed"),
            "steps": self.points[-1]["steps"],
            "wall_clock_s": self.points[-1]["wall_clock_s"],
            "steps_to_solved": None if solved.steps is None else int(solved.steps),
            "wall_clock_to_solved_s": solved.wall_clock_s,
            "best_success_rate": max(rates),
            "last_success_rate": rates[-1],
            "last_safe_success_rate": self.points[-1].get("safe_success_rate"),
            "last_success_rate_2cm": self.points[-1].get("success_rate_2cm"),
            "cost_collision_mean": sum(collisions) / len(collisions),
            "cost_collision_last": collisions[-1],
            "points": self.points,
        }


def _steps_to_solved(summary: dict[str, Any]) -> str:
    steps = summary["steps_to_solved"]
    return "-" if steps is None else f"{steps:,}"


def _rate(name: str) -> Callable[[dict[str, Any]], str]:
    """Return what formats a rate, which older results lack."""
    return lambda one: "-" if one.get(name) is None else f"{one[name]:.2f}"


def _minutes_to_solved(summary: dict[str, Any]) -> str:
    seconds = summary["wall_clock_to_solved_s"]
    return "-" if seconds is None else f"{seconds / 60:.1f}"


CURVE_COLUMNS: Final[dict[str, Column]] = {
    "run": "{name}",
    "environment": lambda one: one["env"] or "-",
    "advice": lambda one: one["advice"] or "none",
    "steps": "{steps:,}",
    f"steps to {SOLVED:g}": _steps_to_solved,
    f"minutes to {SOLVED:g}": _minutes_to_solved,
    "best success": "{best_success_rate:.2f}",
    "last success": "{last_success_rate:.2f}",
    "safe": _rate("last_safe_success_rate"),
    "within 2 cm": _rate("last_success_rate_2cm"),
    "collisions per episode": "{cost_collision_mean:.2f}",
    "last of them": "{cost_collision_last:.2f}",
}
"""Headings, and how a :meth:`RunCurve.summary` fills each column."""


def read_runs(folders: Sequence[Path]) -> list[RunCurve]:
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


def read_run(folder: Path, name: str) -> RunCurve:
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
    return RunCurve(name, record["config"], points, record.get("world"))


def draw(runs: Sequence[RunCurve], panels: Sequence[tuple[str, str]] = PANELS) -> Figure:
    """Plot curves over environment steps, on the left, and over wall-clock time, on the right.

    :param runs: at least one run
    :param panels: column of the curve and its label, one pair per row
    :return: the figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 0.9 + 2.5 * len(panels)), layout="constrained", dpi=120)
    grid = figure.subplots(len(panels), 2, sharex="col", sharey="row", squeeze=False)
    for row, (name, label) in enumerate(panels):
        for column, (axis, scale) in enumerate((("steps", 1e3), ("wall_clock_s", 60.0))):
            axes = grid[row][column]
            for index, run in enumerate(runs):
                x = [value / scale for value in run.values(axis)]
                pen = PENS[index % len(PENS)]
                drawn = {"color": pen.colour, "linestyle": pen.dashes, **line_style(len(x))}
                axes.plot(x, run.values(name), label=run.name, **drawn)
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
