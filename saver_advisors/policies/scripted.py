"""Scripted teachers: one arm of an environment's expert, for advice without weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.policies.inference import FloatArray, check_rows
from saver_advisors.policies.teacher import Teacher
from saver_envs.experts import make_expert
from saver_envs.robots.description import Fingers

PREFIX: Final = "scripted:"
"""Prefix of ``scripted:ID``, which names the teachers of all arms of an environment."""


class ScriptedTeacher(Teacher):
    """Act as one arm of a scripted expert, from that arm's current observation alone.

    A scripted teacher has no networks, so no critics and no weights to initialise a student with.

    :param env_id: a registered id with an expert.
    :param arm: index of the arm, from 0.
    :raises ValueError: for an unknown id, an arm that does not exist, or an expert that coordinates
        arms or keeps plans.
    """

    def __init__(self, env_id: str, arm: int) -> None:
        self._expert = make_expert(env_id, coordinated=False)
        self._arm = arm
        if not 0 <= arm < self._expert.n_arms:
            raise ValueError(f"arm={arm}: {env_id} has {self._expert.n_arms} arms, from 0")
        self.name = f"{PREFIX}{env_id}:{arm}"
        task = self._expert.task
        self.observation_size = task.observation_layout.block
        self.goal_size = task.goal_layout.block
        self.action_size = 3 + (task.fingers is Fingers.ACTUATED)
        self.has_critics = False

    def act(
        self,
        observation: NDArray[Any],
        goal: NDArray[Any],
        achieved_goal: NDArray[Any] | None = None,
    ) -> FloatArray:
        """Return the expert's action for this arm; see ``Teacher.act``."""
        check_rows("observation", observation, self.observation_size, self.name)
        check_rows("desired_goal", goal, self.goal_size, self.name)
        # The arms act independently, so all of them may observe the same.
        arms = self._expert.n_arms
        shown = {
            "observation": np.tile(observation, (1, arms)),
            "desired_goal": np.tile(goal, (1, arms)),
        }
        actions, _ = self._expert.predict(shown)
        return actions.reshape(len(observation), arms, self.action_size)[:, self._arm]

    def __repr__(self) -> str:
        return f"ScriptedTeacher({self.name!r})"


def scripted_teachers(name: str) -> Sequence[Teacher]:
    """Return the teachers of all arms of an environment, in order.

    :param name: ``scripted:ID``.
    :raises ValueError: as for ``ScriptedTeacher``.
    """
    env_id = name.removeprefix(PREFIX)
    n_arms = make_expert(env_id, coordinated=False).n_arms
    return [ScriptedTeacher(env_id, arm) for arm in range(n_arms)]
