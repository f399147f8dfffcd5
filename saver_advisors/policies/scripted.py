"""Teachers that are scripted: one arm of an environment's expert, for advice without weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.policies.inference import FloatArray
from saver_advisors.policies.teacher import Teacher
from saver_envs.experts import Expert, make_expert
from saver_envs.registration import row_of
from saver_envs.tasks.distance import Distance
from saver_envs.tasks.observation import SIZE_PER_ARM
from saver_envs.tasks.pick_and_place import PickAndPlace

PREFIX: Final = "scripted:"
"""``scripted:ID`` names the teachers of all arms of an environment."""

_GOAL_SIZE: Final = 3


class ScriptedTeacher(Teacher):
    """One arm of a scripted expert that acts on what that arm sees, now, and nothing else.

    It has no networks: no critics to compare actions with, and no weights to start a student from.

    :param env_id: a registered id with an expert
    :param arm: which arm, from 0
    :raises ValueError: for an unknown id, one without such an arm, or an expert that coordinates
        arms or keeps plans, of which a single arm is not a policy
    """

    def __init__(self, env_id: str, arm: int) -> None:
        self._expert = _one_arm_at_a_time(env_id)
        self._arm = arm
        if not 0 <= arm < self._expert.n_arms:
            raise ValueError(f"arm={arm}: {env_id} has {self._expert.n_arms} arms, from 0")
        self.name = f"{PREFIX}{env_id}:{arm}"
        gripper = issubclass(row_of(env_id).task, PickAndPlace)
        self._action_size = 3 + gripper

    @property
    def observation_size(self) -> int:
        """One arm's block of the observation."""
        return SIZE_PER_ARM

    @property
    def goal_size(self) -> int:
        """A position."""
        return _GOAL_SIZE

    @property
    def action_size(self) -> int:
        """A displacement, and a gripper's command where the task has one."""
        return self._action_size

    @property
    def has_critics(self) -> bool:
        """It has none."""
        return False

    @property
    def reads_achieved_goal(self) -> bool:
        """The observation tells it where its object is."""
        return False

    def act(
        self,
        observation: NDArray[Any],
        goal: NDArray[Any],
        achieved_goal: NDArray[Any] | None = None,
    ) -> FloatArray:
        """What the expert does with this arm; see ``Teacher.act``."""
        for key, values, size in (
            ("observation", observation, SIZE_PER_ARM),
            ("desired_goal", goal, _GOAL_SIZE),
        ):
            if values.ndim != 2 or values.shape[1] != size:
                raise ValueError(
                    f"{key} has shape {values.shape}: teacher {self.name!r} needs (n, {size})"
                )
        # Each arm is shown the same: one that acts for itself alone does not mind.
        arms = self._expert.n_arms
        shown = {
            "observation": np.tile(observation, (1, arms)),
            "desired_goal": np.tile(goal, (1, arms)),
        }
        actions, _ = self._expert.predict(shown)
        return actions.reshape(len(observation), arms, self._action_size)[:, self._arm]

    def __repr__(self) -> str:
        return f"ScriptedTeacher({self.name!r})"


def scripted_teachers(name: str) -> Sequence[Teacher]:
    """The teachers of all arms of an environment, arm by arm.

    :param name: ``scripted:ID``
    :raises ValueError: as for ``ScriptedTeacher``
    """
    env_id = name.removeprefix(PREFIX)
    return [ScriptedTeacher(env_id, arm) for arm in range(_one_arm_at_a_time(env_id).n_arms)]


def _one_arm_at_a_time(env_id: str) -> Expert:
    """The expert of an id whose arms act for themselves."""
    if row_of(env_id).task is Distance:
        raise ValueError(f"{env_id}: its expert carries with both arms as one; no arm is a teacher")
    return make_expert(env_id, coordinated=False)
