"""Scripted teachers: an environment's expert, or one arm of it, for advice without weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from saver_advisors.policies.inference import FloatArray
from saver_advisors.policies.teacher import FunctionTeacher, Teacher, TeacherGroup
from saver_envs.experts import Expert, make_expert
from saver_envs.robots.description import Fingers

PREFIX: Final = "scripted:"
"""Prefix of ``scripted:ID``, which names the teachers of all arms of an environment."""

EXPERT: Final = "expert"
"""Name of the scripted expert of the environment that a run trains in."""


class ExpertGroup(TeacherGroup):
    """A scripted expert as the teacher of all arms, which gives way among them.

    It keeps plans from call to call, so it advises the same environments at every step.

    :param expert: the expert.
    """

    def __init__(self, expert: Expert) -> None:
        self.expert = expert
        super().__init__(FunctionTeacher(_alone, _sizes(expert), EXPERT), expert.n_arms)

    def act(
        self,
        observations: NDArray[Any],
        goals: NDArray[Any],
        achieved_goals: NDArray[Any] | None = None,
    ) -> FloatArray:
        """Return the action of every arm; see ``TeacherGroup.act``."""
        n = len(observations)
        seen = {"observation": observations.reshape(n, -1), "desired_goal": goals.reshape(n, -1)}
        actions, _ = self.expert.predict(seen)
        return actions.reshape(n, self.n_arms, self.action_size)


def _alone(observation: NDArray[Any], goal: NDArray[Any]) -> NDArray[Any]:
    raise TypeError(f"the teacher {EXPERT!r} advises all arms at once")


def _sizes(expert: Expert) -> tuple[int, int, int]:
    """Return the sizes of an arm's observation, goal and action."""
    task = expert.task
    size = 3 + (task.fingers is Fingers.ACTUATED)
    return task.observation_layout.block, task.goal_layout.block, size


def _teacher(env_id: str, arm: int) -> FunctionTeacher:
    """Return one arm of a scripted expert, which acts on that arm's current observation alone."""
    expert = make_expert(env_id, coordinated=False)
    arms, sizes = expert.n_arms, _sizes(expert)

    def act(observation: NDArray[Any], goal: NDArray[Any]) -> NDArray[Any]:
        # The arms act independently, so all of them may observe the same.
        shown = {
            "observation": np.tile(observation, (1, arms)),
            "desired_goal": np.tile(goal, (1, arms)),
        }
        actions, _ = expert.predict(shown)
        return actions.reshape(len(observation), arms, -1)[:, arm]

    return FunctionTeacher(act, sizes, f"{PREFIX}{env_id}:{arm}")


def scripted_teachers(name: str) -> Sequence[Teacher]:
    """Return the teachers of all arms of an environment, in order.

    :param name: ``scripted:ID``.
    :raises ValueError: for an unknown id, or an expert that coordinates arms or keeps plans.
    """
    env_id = name.removeprefix(PREFIX)
    n_arms = make_expert(env_id, coordinated=False).n_arms
    return [_teacher(env_id, arm) for arm in range(n_arms)]
