"""Scripted teachers: one arm of an environment's expert, for advice without weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.policies.teacher import FunctionTeacher, Teacher
from saver_envs.experts import make_expert
from saver_envs.robots.description import Fingers

PREFIX: Final = "scripted:"
"""Prefix of ``scripted:ID``, which names the teachers of all arms of an environment."""


def _teacher(env_id: str, arm: int) -> FunctionTeacher:
    """Return one arm of a scripted expert, which acts on that arm's current observation alone."""
    expert = make_expert(env_id, coordinated=False)
    arms, task = expert.n_arms, expert.task
    size = 3 + (task.fingers is Fingers.ACTUATED)

    def act(observation: NDArray[Any], goal: NDArray[Any]) -> NDArray[Any]:
        # The arms act independently, so all of them may observe the same.
        shown = {
            "observation": np.tile(observation, (1, arms)),
            "desired_goal": np.tile(goal, (1, arms)),
        }
        actions, _ = expert.predict(shown)
        return actions.reshape(len(observation), arms, size)[:, arm]

    sizes = task.observation_layout.block, task.goal_layout.block, size
    return FunctionTeacher(act, sizes, f"{PREFIX}{env_id}:{arm}")


def scripted_teachers(name: str) -> Sequence[Teacher]:
    """Return the teachers of all arms of an environment, in order.

    :param name: ``scripted:ID``.
    :raises ValueError: for an unknown id, or an expert that coordinates arms or keeps plans.
    """
    env_id = name.removeprefix(PREFIX)
    n_arms = make_expert(env_id, coordinated=False).n_arms
    return [_teacher(env_id, arm) for arm in range(n_arms)]
