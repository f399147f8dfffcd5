"""The figures of ``python -m reproduction kinematics`` as a page of Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from reproduction.modelling.weights import origin
from saver_advisors.reporting.tables import markdown


def render(figures: dict[str, Any]) -> str:
    """The figures as a page of Markdown.

    :param figures: what was measured, or its JSON file's content
    """
    parts = [
        f"# {figures['title']}\n",
        "## How exact\n",
        "Distance of the hand from unseen targets over the workspace, median / 99th percentile, "
        "mm. *As used* adds the search for the nearest point where two steps miss."
        f"{origin(figures)}\n",
        _accuracy_table(figures["accuracy"]),
        "## How fast\n",
        "A model alone, without refinement: one target, and each of 4,096.\n",
        _prediction_table(figures["prediction"]),
    ]
    if figures["cost"]:
        parts += [
            "One call for all environments, the shipped models with their refinement, on states "
            "and set-points of random actions, each after a step, as in use. *Ratio* is the median "
            "of the turns'.\n",
            _cost_table(figures["cost"]),
        ]
    if figures["success"]:
        episodes = figures["success"][0]["episodes"]
        parts += [
            "## In use\n",
            f"Success over {episodes} episodes, 95% intervals.\n",
            _success_table(figures["success"]),
        ]
    return "\n".join(parts)


def _accuracy_table(rows: Sequence[Mapping[str, Any]]) -> str:
    def cells(one: Mapping[str, Any]) -> Iterator[str]:
        for label in ("raw", "one_step", "two_steps", "as_used"):
            found = one["millimetres"][label]
            yield f"{found['median']:.3g} / {found['p99']:.3g}"

    columns = ["arm", "model", "raw", "one step", "two steps", "as used"]
    return markdown(columns, [[one["robot"], one["model"], *cells(one)] for one in rows])


def _prediction_table(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = [
        [one["robot"], one["model"], f"{one['latency_ms']:.3f}", f"{one['batch_us']:.1f}"]
        for one in rows
    ]
    return markdown(["arm", "model", "one prediction (ms)", "one of 4096 (us)"], cells)


def _cost_table(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = [
        [
            one["robot"],
            str(one["n_envs"]),
            f"{one['learned_us']:.0f}",
            f"{one['damped_least_squares_us']:.0f}",
            f"{one['ratio']:.2f}x",
            f"{one['share_of_step']:.1%}",
        ]
        for one in rows
    ]
    columns = ["arm", "n_envs", "learned (us)", "least squares (us)", "ratio", "share of a step"]
    return markdown(columns, cells)


def _success_table(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = [
        [
            one["env"],
            one["policy"],
            one["inverse_kinematics"],
            "-" if one["refinement"] is None else str(one["refinement"]),
            f"{one['success']:.3f} [{one['interval'][0]:.3f}, {one['interval'][1]:.3f}]",
        ]
        for one in sorted(rows, key=lambda one: (one["env"], one["policy"]))
    ]
    columns = ["environment", "policy", "inverse kinematics", "Newton steps", "success"]
    return markdown(columns, cells)
