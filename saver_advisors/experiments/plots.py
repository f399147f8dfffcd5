"""Plot learning curves over seeds: thin lines for the seeds, a thick line for their mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from saver_advisors.evaluation.metrics import EPOCH_STEPS
from saver_advisors.evaluation.statistics import QUARTER
from saver_advisors.experiments.training_runs import TrainingRun
from saver_advisors.reporting.curve_style import GREY, PENS, Pen, dress, line_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHORT_LABEL: Final = 20
"""Longest label (characters) of which two fit side by side, with their counts."""

USUAL_LEGEND: Final = 5
"""Lines of a legend that fit below a panel of the usual height."""

LABELS: Final = {
    "success_rate_2cm": "success rate within 2 cm",
    "mean_q": "mean Q of the student",
}
"""Labels of columns whose names do not say it."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Panel:
    """A panel of a figure that compares rows.

    :param title: above the panel
    :param rows: label -> the runs of one method
    :param grey: label of the reference row, which is drawn in grey
    """

    title: str
    rows: Mapping[str, Sequence[TrainingRun]]
    grey: str | None = None


def mean_curve(runs: Sequence[TrainingRun], column: str) -> tuple[Floats, Floats] | None:
    """Compute the interquartile mean of seeds over the steps that all of them did.

    Curves are interpolated linearly, since seeds may have been evaluated at different steps.

    :param runs: seeds of one method
    :param column: of their curves, such as ``success_rate``
    :return: steps and means; None if no run has the column, or their steps do not overlap
    """
    lines = [line for run in runs if (line := _line(run, column)) is not None]
    if not lines:
        return None
    first, last = max(x[0] for x, _ in lines), min(x[-1] for x, _ in lines)
    steps = np.unique(np.concatenate([x for x, _ in lines]))
    steps = steps[(steps >= first) & (steps <= last)]
    if not steps.size:
        return None
    values = np.stack([np.interp(steps, x, y) for x, y in lines])
    return steps, np.asarray(trim_mean(values, QUARTER, axis=0), np.float64)


def draw_panels(panels: Sequence[Panel], column: str = "success_rate") -> Figure:
    """Plot curves against epochs, in two columns of panels.

    :param panels: at least one
    :param column: of the curves: ``success_rate`` or ``mean_q``
    :return: the figure
    """
    from matplotlib.figure import Figure

    lines = -(-len(panels) // 2)
    width = min(len(panels), 2)
    # A long legend enlarges the figure instead of shrinking the curves.
    named = max(-(-len(panel.rows) // _legend_columns(panel)) for panel in panels)
    height = 3.9 + 0.19 * max(0, named - USUAL_LEGEND)
    figure = Figure(figsize=(5.6 * width, 0.3 + height * lines), layout="constrained", dpi=120)
    grid = figure.subplots(lines, width, sharey=True, squeeze=False)
    pens: dict[str, Pen] = {}
    for index, (axes, panel) in enumerate(zip(grid.flat, panels, strict=False)):
        pens |= _pens(panel, pens)
        _draw_panel(axes, panel, column, pens)
        axes.set_xlabel(f"epochs of {EPOCH_STEPS:,} environment steps")
        if index % width == 0:
            axes.set_ylabel(LABELS.get(column, column.replace("_", " ")))
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    return figure


def _legend_columns(panel: Panel) -> int:
    """Return 2 if all labels are short enough for two columns, else 1."""
    return 2 if all(len(label) <= SHORT_LABEL for label in panel.rows) else 1


def _pens(panel: Panel, known: Mapping[str, Pen]) -> dict[str, Pen]:
    """Assign a pen to each label: the one of earlier panels, else one that is free here."""
    labels = [label for label in panel.rows if label != panel.grey]
    found = {label: known[label] for label in labels if label in known}
    free = [pen for pen in PENS if pen not in found.values()]
    others = cycle(free + [pen for pen in PENS if pen not in free])
    return {label: found.get(label) or next(others) for label in labels}


def _draw_panel(axes: Axes, panel: Panel, column: str, pens: Mapping[str, Pen]) -> None:
    for label, runs in panel.rows.items():
        pen = Pen(GREY) if label == panel.grey else pens[label]
        _draw_row(axes, label, runs, column, pen)
    dress(axes, column)
    axes.set_title(panel.title, loc="left", fontsize=11, pad=8)
    if panel.rows:
        # Below the curves, since inside it would cover some of them.
        axes.legend(
            loc="upper left",
            bbox_to_anchor=(0.0, -0.17),
            ncols=_legend_columns(panel),
            frameon=False,
            fontsize=9,
            handlelength=2.2,
            columnspacing=1.2,
        )


def _draw_row(axes: Axes, label: str, runs: Sequence[TrainingRun], column: str, pen: Pen) -> None:
    """Plot a method: thin lines for its seeds, and their mean."""
    mean = mean_curve(runs, column)
    if mean is None:
        return
    drawn: dict[str, Any] = {"color": pen.colour, "linestyle": pen.dashes}
    if len(runs) > 1:
        for run in runs:
            if (line := _line(run, column)) is not None:
                axes.plot(line[0] / EPOCH_STEPS, line[1], **drawn, linewidth=0.7, alpha=0.45)
    style = {**line_style(len(mean[0])), "markersize": 2.5}
    count = f"{label} (n = {len(runs)})"
    axes.plot(mean[0] / EPOCH_STEPS, mean[1], label=count, **drawn, **style)


def _line(run: TrainingRun, column: str) -> tuple[Floats, Floats] | None:
    """Return steps and values of the evaluations that have the column."""
    pairs = [
        (point["steps"], point[column]) for point in run.points if point.get(column) is not None
    ]
    if not pairs:
        return None
    steps, values = np.asarray(pairs, np.float64).T
    return steps, values
