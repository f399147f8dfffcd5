"""Between one arm and n arms: slices observations, goals and actions into per-arm blocks, and joins
actions.

The dual observation is the arms' blocks in order, d = d1 || d2, and so are goal and action; hence
the teacher's state s_i = f_i(s) (eq. 5.7) is a slice, the student's action a = f_a(a_1..a_n) (5.8)
a concatenation, and h_i(a) (5.9) a slice again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)

OBSERVATION_SIZE = 28
"""Numbers that describe one arm and its object (docs: observation table)."""
GOAL_SIZE = 3
"""A position in metres, in the arm's own base frame."""


@dataclass(frozen=True)
class ArmMapping:
    """Where each arm's block lies in the n-arm vectors.

    Every method takes any leading dimensions and returns views where NumPy can.

    :param n_arms: arms of the student
    :param observation_size: numbers of one arm in the observation
    :param goal_size: numbers of one arm in achieved and desired goal; trailing entries of the goal
        that belong to no arm (the distance task's 7 = 2 * 3 + 1) are ignored
    :param action_size: numbers of one arm in the action: 3 (push) or 4 (pick-and-place, with the
        gripper)
    :raises ValueError: for a size below 1
    """

    n_arms: int
    observation_size: int = OBSERVATION_SIZE
    goal_size: int = GOAL_SIZE
    action_size: int = 4

    def __post_init__(self) -> None:
        for name in ("n_arms", "observation_size", "goal_size", "action_size"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
                raise ValueError(f"{name}={value!r} must be a whole number of at least 1")

    @classmethod
    def from_spaces(
        cls,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        *,
        n_arms: int | None = None,
        observation_size: int = OBSERVATION_SIZE,
        goal_size: int = GOAL_SIZE,
    ) -> ArmMapping:
        """Read the sizes off an environment.

        :param observation_space: a Dict with flat `observation`, `achieved_goal` and `desired_goal`
        :param action_space: a flat Box
        :param n_arms: arms, where the caller knows; else the observation's size /
            `observation_size`
        :param observation_size: numbers of one arm in the observation
        :param goal_size: numbers of one arm in the goal
        :raises TypeError: where the spaces are not of those kinds
        :raises ValueError: where the sizes do not divide into arms; the message names them
        """
        sizes = _goal_env_sizes(observation_space)
        if not isinstance(action_space, spaces.Box) or len(action_space.shape) != 1:
            raise TypeError(f"advice needs a flat Box action space, not {action_space}")
        if n_arms is None:
            n_arms, rest = divmod(sizes["observation"], observation_size)
            if rest or n_arms == 0:
                raise ValueError(
                    f"an observation of size {sizes['observation']} does not divide into arms of "
                    f"{observation_size}"
                )
        actions = int(action_space.shape[0])
        if n_arms < 1 or actions % n_arms:
            raise ValueError(f"an action of size {actions} does not divide among {n_arms} arms")
        mapping = cls(n_arms, observation_size, goal_size, actions // n_arms)
        mapping.check_spaces(observation_space, action_space)
        return mapping

    def check_spaces(
        self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        """Refuse spaces that this mapping does not cut into arms.

        :param observation_space: the student's Dict observation space
        :param action_space: the student's action space
        :raises TypeError: where the spaces are of another kind
        :raises ValueError: where a size differs; the message names both
        """
        sizes = _goal_env_sizes(observation_space)
        if not isinstance(action_space, spaces.Box) or len(action_space.shape) != 1:
            raise TypeError(f"advice needs a flat Box action space, not {action_space}")
        sizes["action"] = int(action_space.shape[0])
        for name, per_arm in (("observation", self.observation_size), ("action", self.action_size)):
            if sizes[name] != self.n_arms * per_arm:
                raise ValueError(
                    f"the {name} has size {sizes[name]}, but {self.n_arms} arm(s) of {per_arm} "
                    f"need "
                    f"{self.n_arms * per_arm}"
                )
        for name in ("achieved_goal", "desired_goal"):
            if sizes[name] < self.n_arms * self.goal_size:
                raise ValueError(
                    f"the {name} has size {sizes[name]}, but {self.n_arms} arm(s) of "
                    f"{self.goal_size} need at "
                    f"least {self.n_arms * self.goal_size}"
                )

    def split_observation(self, observation: NDArray[Scalar]) -> NDArray[Scalar]:
        """s_i = f_i(s) (eq. 5.7): (..., n_arms * observation_size) -> (..., n_arms,
        observation_size), a view.
        """
        return self._split("observation", observation, self.observation_size)

    def split_goal(self, goal: NDArray[Scalar]) -> NDArray[Scalar]:
        """Goals by arm: (..., at least n_arms * goal_size) -> (..., n_arms, goal_size), a view."""
        size = self.n_arms * self.goal_size
        if goal.ndim == 0 or goal.shape[-1] < size:
            raise ValueError(
                f"goal has shape {goal.shape}: its last dimension must be at least {size}"
            )
        return self._split("goal", goal[..., :size], self.goal_size)

    def split_action(self, action: NDArray[Scalar]) -> NDArray[Scalar]:
        """a_i = h_i(a) (eq. 5.9): (..., n_arms * action_size) -> (..., n_arms, action_size), a
        view.
        """
        return self._split("action", action, self.action_size)

    def join_actions(self, actions: NDArray[Scalar]) -> NDArray[Scalar]:
        """a = f_a(a_1..a_n) (5.8): (..., n_arms, action_size) -> (..., n_arms * action_size)."""
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
                f"{size} = "
                f"{self.n_arms * size}"
            )
        # Splitting the last axis never needs a copy, whatever the strides.
        return flat.reshape(*flat.shape[:-1], self.n_arms, size)


def _goal_env_sizes(observation_space: spaces.Space[Any]) -> dict[str, int]:
    """:return: the sizes of a goal environment's three entries
    :raises TypeError: where the space is not a Dict of flat Boxes with these entries
    """
    if not isinstance(observation_space, spaces.Dict):
        raise TypeError(
            "advice needs a goal environment: a Dict observation with 'observation', "
            "'achieved_goal' and "
            f"'desired_goal', not {observation_space}"
        )
    sizes = {}
    for key in ("observation", "achieved_goal", "desired_goal"):
        box = observation_space.spaces.get(key)
        if not isinstance(box, spaces.Box) or len(box.shape) != 1:
            raise TypeError(f"advice needs a flat Box {key!r} in the observation, not {box}")
        sizes[key] = int(box.shape[0])
    return sizes
