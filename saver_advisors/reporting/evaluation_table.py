"""The row of an evaluation in a table, on the terminal and on pages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.reporting.tables import Column


def _collisions(evaluation: Mapping[str, Any]) -> str:
    collisions = (evaluation.get("cost_means") or {}).get("cost_collision")
    return "-" if collisions is None else f"{collisions:.2f}"


EVALUATION_COLUMNS: Final[dict[str, Column]] = {
    "environment": lambda one: environment_text(one["env"], one.get("env_kwargs") or {}),
    "policy": "{policy}",
    "episodes": "{episodes}",
    "success": "{success_rate:.3f}",
    "95% interval": "{ci95[0]:.3f} to {ci95[1]:.3f}",
    "final distance (cm)": lambda one: ", ".join(
        f"{100 * distance:.1f}" for distance in one.get("final_distance_mean", ())
    ),
}
"""Headings, and how an evaluation, as ``saver evaluate`` writes it, fills each column."""

COLLISIONS_COLUMN: Final[dict[str, Column]] = {"collisions per episode": _collisions}
