"""The row of an evaluation in a table, on the terminal and on pages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from saver_advisors.evaluation.protocol import environment_text
from saver_advisors.reporting.tables import Column, optional


def _collisions(evaluation: Mapping[str, Any]) -> str:
    collisions = (evaluation.get("cost_means") or {}).get("cost_collision")
    return "-" if collisions is None else f"{collisions:.2f}"


def _distances(evaluation: Mapping[str, Any]) -> str:
    distances = evaluation.get("final_distance_mean", ())
    if evaluation.get("distance_unit") == "rad":
        return ", ".join(f"{math.degrees(angle):.1f} deg" for angle in distances)
    return ", ".join(f"{100 * distance:.1f}" for distance in distances)


def collision_force(evaluation: Mapping[str, Any]) -> str:
    """Format the highest force of an episode's collisions: its mean and maximum over episodes."""
    mean, highest = (evaluation.get(f"collision_force_{name}") for name in ("mean", "max"))
    return "-" if mean is None or highest is None else f"{mean:.1f}, {highest:.0f}"


EVALUATION_COLUMNS: Final[dict[str, Column]] = {
    "environment": lambda one: environment_text(one["env"], one.get("env_kwargs") or {}),
    "policy": "{policy}",
    "episodes": "{episodes}",
    "success": "{success_rate:.3f}",
    "95% interval": "{ci95[0]:.3f} to {ci95[1]:.3f}",
    "safe": optional("safe_success_rate", ".3f"),
    "within 2 cm": optional("success_rate_2cm", ".3f"),
    "final distance (cm)": _distances,
}
"""Headings, and how an evaluation, as ``saver evaluate`` writes it, fills each column.

Where goals are angles, "within 2 cm" is within 4 degrees, and distances are in degrees.
"""

COLLISIONS_COLUMN: Final[dict[str, Column]] = {
    "collisions per episode": _collisions,
    "their force (N), mean and highest": collision_force,
}
"""Steps with a collision, and the highest force of an episode's collisions: its mean and maximum
over episodes.
"""
