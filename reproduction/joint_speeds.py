"""Measure in how many steps joints are faster than their makers allow, with and without ``rated``.

The best shipped policy of an environment plays, or else its scripted expert. A joint's speed is its
mean over 0.01 s, four times an action. One that follows a target at the limit overshoots a little:
a step counts where a joint is more than 5% faster than its limit.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from reproduction.command_parts import add_choices
from saver_advisors.cli.arguments import add_count, add_page
from saver_advisors.cli.catalogue import sparse_ids
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.reporting.provenance import measured_at
from saver_advisors.reporting.tables import rows_table

EXAMPLES: Final = """\
examples:
  python -m reproduction joint-speeds --json docs/results/joint-speeds.json
  python -m reproduction joint-speeds --only JacoPush-v0 --episodes 10"""

KIND: Final = "joint-speeds"
OVERSHOOT: Final = 1.05
"""Ratio of a speed to its limit above which a step counts."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_choices(parser, "--only", sparse_ids(), "environments")
    add_count(parser, "--episodes", 100, "episodes of each environment and setting")
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the table, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """

    def figures() -> dict[str, Any]:
        from tqdm import tqdm

        rows = [row_of(env_id, args.episodes) for env_id in tqdm(args.only, unit="environment")]
        return {"title": "Joint speeds above the makers' limits", "kind": KIND, "rows": rows}

    return measure_and_render(args, KIND, figures, render)


def row_of(env_id: str, episodes: int) -> dict[str, Any]:
    """Measure an environment with and without ``rated``.

    :param env_id: its id.
    :param episodes: of each setting, from seed 0.
    :return: policy, episodes, and shares of the steps and highest ratios to a limit of both.
    """
    policy = policy_for(env_id)
    row: dict[str, Any] = {"env": env_id, "policy": policy, "episodes": episodes}
    for name, rated in (("default", False), ("rated", True)):
        ratios = speed_ratios(env_id, policy, episodes, rated)
        row[f"{name}_share"] = float((ratios > OVERSHOOT).mean())
        row[f"{name}_highest"] = float(ratios.max())
    return row


def policy_for(env_id: str) -> str:
    """Return the first policy that is shipped for an id with its defaults, or ``expert``."""
    from saver_advisors.pretrained import load_policy, shipped_policies

    for name in shipped_policies():
        card = load_policy(name).card
        if card.env_id == env_id and not card.env_kwargs:
            return name
    return "expert"


def speed_ratios(env_id: str, policy: str, episodes: int, rated: bool) -> np.ndarray[Any, Any]:
    """Play episodes and return the highest ratio of a joint's speed to its limit in each step.

    :param env_id: the environment.
    :param policy: its name, as ``saver evaluate`` takes it.
    :param episodes: from seed 0.
    :param rated: see :class:`saver_envs.registration.ControlOptions`.
    :return: (steps, episodes).
    """
    from saver_advisors.cli.policies import resolve
    from saver_envs.registration import make_episodes
    from saver_envs.simulation import ACTION_DURATION, CONTACT_SAMPLES

    played = make_episodes(env_id, episodes, rated=rated)
    predict = resolve(policy, env_id, {"rated": rated})
    for index in range(episodes):
        played.set_generator(index, np.random.default_rng(index))
    played.reset()
    simulation, joints = played.simulation, played.scene.joint_qpos
    simulation.keep_samples = True
    limits = np.asarray(played.settings.robot.joint_speed_limits) * ACTION_DURATION
    ratios = []
    for _ in range(played.settings.horizon):
        played.step(predict(played.observation().as_dict()))
        moved = np.abs(np.diff(simulation.samples[..., joints], axis=0))
        ratios.append((moved * CONTACT_SAMPLES / limits).max(axis=(0, 2, 3)))
    return np.stack(ratios)


def render(figures: Mapping[str, Any]) -> str:
    """Render the table and its origin."""
    columns = {
        "environment": "{env}",
        "policy": "{policy}",
        "episodes": "{episodes}",
        "default: steps above a limit": "{default_share:.1%}",
        "default: highest": "{default_highest:.1f} times the limit",
        "rated: steps above a limit": "{rated_share:.1%}",
        "rated: highest": "{rated_highest:.1f} times the limit",
    }
    return f"{rows_table(figures['rows'], columns)}\n{measured_at(figures)}\n"


def measured_row(env_id: str, results: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Find what was measured on an environment.

    :param env_id: id of the environment.
    :param results: result files, of which one may be of this command.
    :return: its row, see :func:`row_of`; None if the environment has not been measured.
    """
    rows = (row for one in results if one.get("kind") == KIND for row in one["rows"])
    return next((row for row in rows if row["env"] == env_id), None)
