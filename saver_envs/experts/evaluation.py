"""How often the experts succeed: the proof that tasks can be solved, as a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from saver_envs.experts.expert import make_expert
from saver_envs.registration import ENVIRONMENTS, make_episodes, row_of

#: Episodes that are stepped together.
_BATCH = 100
#: Half-width of a 95% interval in standard deviations.
_NORMAL_95 = 1.96


@dataclass(frozen=True)
class ExpertRow:
    """An expert's figures.

    :param env: the id.
    :param expert: ``scripted``; ``blind`` where arms ignore one another; ``one arm`` where one
        serves all cubes.
    :param episodes: how many.
    :param success: share of them that ended in success.
    :param ci95: Wilson interval of that share.
    :param collisions: share of the episodes with contact that ``cost_collision`` counts.
    """

    env: str
    expert: str
    episodes: int
    success: float
    ci95: tuple[float, float]
    collisions: float


def evaluate_expert(
    env_id: str,
    episodes: int = 200,
    seed: int = 0,
    free_arm: int | None = None,
    coordinated: bool = True,
    threads: int = 1,
    **options: Any,
) -> ExpertRow:
    """Run an expert.

    :param env_id: a registered id.
    :param episodes: how many, at least 1; episode i starts from ``seed + i``.
    :param seed: of the first episode.
    :param free_arm: see :func:`make_expert`.
    :param coordinated: see :func:`make_expert`.
    :param threads: native threads of the simulation.
    :param options: the environment's keyword arguments.
    :return: the figures.
    """
    if episodes < 1:
        raise ValueError(f"episodes={episodes!r}: at least 1 is needed")
    success, collided = [], []
    for first in range(0, episodes, _BATCH):
        count = min(_BATCH, episodes - first)
        world = make_episodes(env_id, count, threads, **options)
        expert = make_expert(env_id, coordinated=coordinated, free_arm=free_arm, **options)
        for index in range(count):
            world.set_generator(index, np.random.default_rng(seed + first + index))
        outcome = world.reset()
        contact = np.zeros(count, dtype=bool)
        for _ in range(world.settings.horizon):
            outcome = world.step(expert.predict(world.observation().as_dict())[0])
            contact |= outcome.costs["collision"] > 0
        success.append(outcome.success)
        collided.append(contact)
    rate = float(np.concatenate(success).mean())
    share = float(np.concatenate(collided).mean())
    name = "scripted" if coordinated else "blind"
    name = name if free_arm is None else "one arm"
    return ExpertRow(env_id, name, episodes, rate, wilson_interval(rate, episodes), share)


def expert_table(
    env_ids: Sequence[str] | None = None, episodes: int = 200, seed: int = 0
) -> list[ExpertRow]:
    """Run the experts of several ids, and the ablation of those with several arms.

    :param env_ids: registered ids; all with a sparse reward by default.
    :param episodes: how many of each.
    :param seed: of the first episode.
    :return: a row for each id, and one more for each id of several arms.
    """
    if env_ids is None:
        env_ids = [name for name, row in ENVIRONMENTS.items() if row.reward_type == "sparse"]
    rows = []
    for env_id in env_ids:
        rows.append(evaluate_expert(env_id, episodes, seed))
        if row_of(env_id).n_arms > 1:
            rows.append(evaluate_expert(env_id, episodes, seed, free_arm=0))
    return rows


def wilson_interval(rate: float, count: int) -> tuple[float, float]:
    """Return the 95% Wilson interval of a share ``rate`` observed in ``count`` trials."""
    z2 = _NORMAL_95**2 / count
    middle = (rate + z2 / 2) / (1 + z2)
    half = math.sqrt(z2) * math.sqrt(rate * (1 - rate) + z2 / 4) / (1 + z2)
    return max(0.0, middle - half), min(1.0, middle + half)
