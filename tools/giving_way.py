"""Measure which share of contested starts can be solved without a collision within the horizon.

    python tools/giving_way.py --json docs/results/giving-way.json

Every start is played by the scripted expert. Starts that it does not solve safely are played again
from the same state under every schedule: each plan of the expert (who goes first,
whether the other waits aside, on which side a hand passes a cube), held to the end, with an arm
that starts late. The share of starts that some schedule solves is a lower bound of what is
possible. Expert and schedules run in the simulation of the environment.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_advisors.reporting.provenance import provenance, write_json_atomic
from saver_envs.episodes import Episodes, EpisodesState
from saver_envs.experts.blocks import ArmView, Viewer
from saver_envs.experts.expert import Planner, make_expert
from saver_envs.registration import make_episodes

IDS = ("DualJacoPush-v0", "DualJacoPickAndPlace-v0")
#: Actions for which an arm may stand still at the beginning.
DELAYS = (0, 8, 16)

Act = Callable[[ArmView], NDArray[np.floating]]


@dataclass(frozen=True)
class Schedule:
    """One way to share the table.

    :param plan: of the expert.
    :param late: the arm that starts late.
    :param delay: actions after which it starts.
    """

    plan: int
    late: int
    delay: int


def schedules(plans: int, arms: int) -> Iterator[Schedule]:
    """Yield every plan, at once and with each arm late."""
    for delay in DELAYS:
        for plan in range(plans):
            for late in range(arms if delay else 1):
                yield Schedule(plan, late, delay)


def play(
    episodes: Episodes, state: EpisodesState, rows: NDArray[np.intp], act: Act
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Play episodes ``rows`` from ``state``; return the success and the safe success of all."""
    episodes.set_state(state)
    viewer = Viewer(episodes.task)
    outcome = None
    for _ in range(episodes.settings.horizon):
        actions = act(viewer(episodes.observation().as_dict()))
        outcome = episodes.step(np.clip(actions.reshape(episodes.n, -1), -1.0, 1.0), rows)
    assert outcome is not None
    return outcome.success, outcome.safe_success


def held(planner: Planner, schedule: Schedule) -> Act:
    """Return what acts under a schedule."""
    step = 0

    def act(view: ArmView) -> NDArray[np.floating]:
        nonlocal step
        chosen = np.full(len(view.begins), schedule.plan, dtype=np.intp)
        actions = planner.follow(view, chosen)
        if step < schedule.delay:
            actions[:, schedule.late, :3] = 0.0
        step += 1
        return actions

    return act


def measure(env_id: str, starts: int, seed: int, options: dict[str, Any]) -> dict[str, Any]:
    """Return the shares of an id's starts that the expert and any schedule solve.

    :param env_id: the id.
    :param starts: number of starts, from seeds ``seed`` on.
    :param seed: of the first one.
    :param options: keyword arguments of the environment.
    """
    episodes = make_episodes(env_id, starts, **options)
    for index in range(starts):
        episodes.set_generator(index, np.random.default_rng(seed + index))
    episodes.reset()
    state = episodes.get_state()
    planner = make_expert(env_id, **options).planner
    if planner is None:
        raise ValueError(f"env_id={env_id!r}: its expert makes no plans")
    success, solved = play(episodes, state, np.arange(starts), planner.actions)
    row = {
        "env_id": env_id,
        "options": options,
        "starts": starts,
        "seed": seed,
        "expert_success_rate": float(success.mean()),
        "expert_safe_success_rate": float(solved.mean()),
    }
    for schedule in schedules(planner.plans, episodes.task.n_arms):
        rows = np.flatnonzero(~solved)
        if not rows.size:
            break
        solved[rows] |= play(episodes, state, rows, held(planner, schedule))[1][rows]
    return row | {"solvable_share": float(solved.mean())}


def main(arguments: list[str] | None = None) -> int:
    """Measure, print a line per id, and write the JSON."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("ids", nargs="*", default=list(IDS), help="ids (default: push and pick)")
    parser.add_argument("--starts", type=int, default=100, help="starts per id (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the first start (default: 0)")
    parser.add_argument("--arms", type=int, default=2, help="number of arms (default: 2)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    chosen = parser.parse_args(arguments)
    options = {"contested_share": 1.0} | ({"n_arms": chosen.arms} if chosen.arms != 2 else {})
    rows = []
    for env_id in chosen.ids:
        rows.append(measure(env_id, chosen.starts, chosen.seed, options))
        print(
            f"{env_id}: {rows[-1]['solvable_share']:.2f} solvable; the expert solves "
            f"{rows[-1]['expert_success_rate']:.2f}, safely "
            f"{rows[-1]['expert_safe_success_rate']:.2f}"
        )
    if chosen.json:
        write_json_atomic(chosen.json, {"kind": "giving-way", "rows": rows} | provenance())
    return 0


if __name__ == "__main__":
    sys.exit(main())
