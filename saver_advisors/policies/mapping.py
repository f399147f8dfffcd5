"""Mapping between one arm and n arms: per-arm blocks of observations, goals and actions.

The observation of n arms is the concatenation of the arms' blocks, d = d1 || d2, and so are goal
and action. The teacher's state s_i = f_i(s) (eq. 5.7) is therefore a slice, the student's action
a = f_a(a_1..a_n) (5.8) a concatenation, and h_i(a) (5.9) a slice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from saver_advisors.learner.arms import GOAL_KEYS
from saver_envs.validation import require, require_kind

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class ArmMapping:
    """Position of each arm's block in the n-arm vectors.

    Every method accepts any leading dimensions and returns views where NumPy can.

    :param n_arms: arms of the student.
    :param observation_size: numbers per arm in the observation.
    :param goal_size: numbers per arm in achieved and desired goal; trailing entries that belong to
        no arm (the distance task has 7 = 2 * 3 + 1) are ignored.
    :param action_size: numbers per arm in the action.
    :param shared_observation: trailing numbers of the observation that belong to no arm, which are
        ignored.
    :raises ValueError: for a size below 1.
    """

    n_arms: int
    observation_size: int
    goal_size: int
    action_size: int
    shared_observation: int = 0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 0 if name == "shared_observation" else 1
            require_kind(name, value, int)
            require(name, value, value >= least, f"at least {least}")

    def check_spaces(
        self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        """Check that this mapping fits a student's spaces.

        :param observation_space: the student's Dict observation space.
        :param action_space: the student's action space.
        :raises TypeError: for spaces of another kind.
        :raises ValueError: if a size differs; the message names both.
        """
        if not isinstance(observation_space, spaces.Dict):
            raise TypeError(
                f"advice needs a goal environment: a Dict observation with {GOAL_KEYS}, "
                f"not {observation_space}"
            )
        given = {**observation_space.spaces, "action": action_space}
        per_arm = {
            "observation": self.observation_size,
            "action": self.action_size,
            "achieved_goal": self.goal_size,
            "desired_goal": self.goal_size,
        }
        for name, size in per_arm.items():
            total, needed = flat_size(name, given.get(name)), self.n_arms * size
            if name == "observation":
                total -= self.shared_observation
            more = name.endswith("goal")
            if total < needed or (total > needed and not more):
                raise ValueError(
                    f"the {name} has size {total}, but {self.n_arms} arm(s) of {size} need "
                    f"{'at least ' * more}{needed}"
                )

    def split(
        self, observation: Mapping[str, NDArray[Any]]
    ) -> tuple[NDArray[Any], NDArray[Any], Any]:
        """Split the entries of a Dict observation by arm.

        :param observation: `observation`, `desired_goal` and, if it is there, `achieved_goal`.
        :return: observations, desired and achieved goals, each (..., n_arms, size), views; None
            for the latter if there are none.
        """
        achieved = observation.get("achieved_goal")
        return (
            self.split_observation(observation["observation"]),
            self.split_goal(observation["desired_goal"]),
            None if achieved is None else self.split_goal(achieved),
        )

    def split_observation(self, observation: NDArray[Scalar]) -> NDArray[Scalar]:
        """Split an observation by arm, s_i = f_i(s) (eq. 5.7).

        :param observation: (..., n_arms * observation_size + shared_observation).
        :return: (..., n_arms, observation_size), a view.
        """
        if self.shared_observation:
            observation = observation[..., : -self.shared_observation]
        return self._split("observation", observation, self.observation_size)

    def split_goal(self, goal: NDArray[Scalar]) -> NDArray[Scalar]:
        """Split a goal by arm.

        :param goal: (..., at least n_arms * goal_size).
        :return: (..., n_arms, goal_size), a view.
        """
        return self._split("goal", goal[..., : self.n_arms * self.goal_size], self.goal_size)

    def split_action(self, action: NDArray[Scalar]) -> NDArray[Scalar]:
        """Split an action by arm, a_i = h_i(a) (eq. 5.9).

        :param action: (..., n_arms * action_size).
        :return: (..., n_arms, action_size), a view.
        """
        return self._split("action", action, self.action_size)

    def join_actions(self, actions: NDArray[Scalar]) -> NDArray[Scalar]:
        """Join the arms' actions, a = f_a(a_1..a_n) (eq. 5.8).

        :param actions: (..., n_arms, action_size).
        :return: (..., n_arms * action_size).
        """
        if actions.shape[-2:] != (self.n_arms, self.action_size):
            raise ValueError(
                f"actions have shape {actions.shape}: the last two dimensions must be "
                f"({self.n_arms}, {self.action_size})"
            )
        return actions.reshape(*actions.shape[:-2], self.n_arms * self.action_size)

    def _split(self, name: str, flat: NDArray[Scalar], size: int) -> NDArray[Scalar]:
        if flat.ndim == 0 or flat.shape[-1] != self.n_arms * size:
            raise ValueError(
                f"{name} has shape {flat.shape}: its last dimension must be {self.n_arms} arm(s) x "
                f"{size} = {self.n_arms * size}"
            )
        # Splitting the last axis never needs a copy, whatever the strides.
        return flat.reshape(*flat.shape[:-1], self.n_arms, size)


def flat_size(name: str, space: spaces.Space[Any] | None) -> int:
    """Return the size of a flat Box.

    :param name: of the space, for the message.
    :param space: the space.
    :raises TypeError: for a space of another kind.
    """
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise TypeError(f"a flat Box {name!r} is needed, not {space}")
    return int(space.shape[0])
