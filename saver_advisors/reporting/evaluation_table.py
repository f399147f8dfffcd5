"""The row of an evaluation in a table, on the terminal and on pages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from saver_advisors.evaluation.protocol import environment_text

EVALUATION_COLUMNS = (
    "environment",
    "policy",
    "episodes",
    "success",
    "95% interval",
    "final distance (cm)",
)


def evaluation_cells(figures: Mapping[str, Any]) -> list[str]:
    """Format an evaluation as cells in the order of ``EVALUATION_COLUMNS``.

    :param figures: as ``saver evaluate`` writes them
    :return: the cells
    """
    low, high = figures["ci95"]
    return [
        environment_text(figures["env"], figures.get("env_kwargs") or {}),
        figures["policy"],
        str(figures["episodes"]),
        f"{figures['success_rate']:.3f}",
        f"{low:.3f} to {high:.3f}",
        ", ".join(f"{100 * distance:.1f}" for distance in figures.get("final_distance_mean", ())),
    ]
