"""Render the results of ``python -m reproduction kinematics`` as a Markdown page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from reproduction.modelling.weight_files import origin
from saver_advisors.reporting.tables import Column, rows_table

ACCURACY: Final = {
    "arm": "{robot}",
    "model": "{model}",
    **{
        label.replace("_", " "): f"{{millimetres[{label}][median]:.3g}} / "
        f"{{millimetres[{label}][p99]:.3g}}"
        for label in ("raw", "one_step", "two_steps", "as_used")
    },
}
PREDICTION: Final = {
    "arm": "{robot}",
    "model": "{model}",
    "one prediction (ms)": "{latency_ms:.3f}",
    "one of 4096 (us)": "{batch_us:.1f}",
}
COST: Final = {
    "arm": "{robot}",
    "n_envs": "{n_envs}",
    "learned (us)": "{learned_us:.0f}",
    "least squares (us)": "{damped_least_squares_us:.0f}",
    "ratio": "{ratio:.2f}x",
    "share of a step": "{share_of_step:.1%}",
}
SUCCESS: Final[Mapping[str, Column]] = {
    "environment": "{env}",
    "policy": "{policy}",
    "inverse kinematics": "{inverse_kinematics}",
    "used in": "{used_in}",
    "Newton steps": lambda one: "-" if one["refinement"] is None else str(one["refinement"]),
    "success": "{success:.3f} [{interval[0]:.3f}, {interval[1]:.3f}]",
}


def render(figures: Mapping[str, Any]) -> str:
    """Render the results as a page.

    :param figures: the measurements, or the content of their JSON file.
    :return: Markdown.
    """
    parts = [
        f"# {figures['title']}\n",
        "## Accuracy\n",
        "Distance of the hand from unseen targets in the workspace, median / 99th percentile, mm. "
        "*As used* adds a search for the nearest point if two Newton steps miss the target."
        f"{origin(figures)}\n",
        rows_table(figures["accuracy"], ACCURACY),
        "## Prediction time\n",
        "A model without refinement: for a single target, and per target in a batch of 4,096.\n",
        rows_table(figures["prediction"], PREDICTION),
    ]
    if figures["cost"]:
        parts += [
            "One call for all environments: the shipped models with refinement, on states and "
            "set-points of random actions, each call after a step, as in use. *Ratio* is the "
            "median over the rounds.\n",
            rows_table(figures["cost"], COST),
        ]
    if success := figures["success"]:
        parts += [
            "## In use\n",
            f"Success over {success[0]['episodes']} episodes, 95% intervals.\n",
            rows_table(sorted(success, key=lambda one: (one["env"], one["policy"])), SUCCESS),
        ]
    return "\n".join(parts)
