"""What every task has in common: objects that are to reach targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import Fingers
from saver_envs.simulation import ObjectState
from saver_envs.tasks.goals import goal_reached, object_distances
from saver_envs.tasks.sampling import StartRules

RewardType = Literal["sparse", "dense"]
FloatArray = NDArray[np.floating]
#: What is measured in a step besides goals: name -> (n,); ``info`` reports it under that name.
Readings = Mapping[str, NDArray[np.float64]]

#: Distance within which an object counts as at its target (m).
SUCCESS_THRESHOLD = 0.05


@dataclass(frozen=True)
class Task:
    """Objects to targets; subclasses say how they are moved and what else is asked.

    :param n_arms: number of arms, objects and targets.
    :param reward_type: ``sparse`` (eq. 6.4: 0 where the goal is reached, else -1) or ``dense``
        (the negative sum of the objects' distances to their targets, metres).
    :param success_threshold: distance that counts as reached, metres.
    :param contested_share: share of the episodes of several arms in which the ways of two hands
        meet, so that the arms must give way.
    """

    n_arms: int
    reward_type: RewardType = "sparse"
    success_threshold: float = SUCCESS_THRESHOLD
    contested_share: float = 0.0

    #: Lower-case name of the task.
    name: ClassVar[str]
    #: Whether the fingers move.
    fingers: ClassVar[Fingers]
    #: Height at which the tool is held (m), or ``None`` where the action sets it.
    held_height: ClassVar[float | None] = None
    #: Costs that ``info["cost"]`` adds up; every cost is reported on its own as well.
    cost_names: ClassVar[tuple[str, ...]] = ("collision",)
    #: Costs that must stay 0 throughout an episode for it to succeed.
    never: ClassVar[tuple[str, ...]] = ()
    #: Whether the objects are a person's wrists, and not cubes.
    moves_person: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.reward_type not in ("sparse", "dense"):
            raise ValueError(
                f"reward_type={self.reward_type!r}: valid types are 'sparse' and 'dense'"
            )
        if not 0 < self.success_threshold < 0.10:
            raise ValueError(
                f"success_threshold={self.success_threshold!r}: must lie between 0 and 0.10 m, "
                "the least distance of a start from its target"
            )

    @property
    def goal_size(self) -> int:
        """Number of entries of a goal."""
        return 3 * self.n_arms

    def start_rules(self, object_rest_height: float) -> StartRules:
        """Return the rules of a start, given the height of a resting cube's centre (m)."""
        raise NotImplementedError

    def achieved_goal(self, objects: ObjectState) -> NDArray[np.float64]:
        """Return (n, goal_size): each object's position in its arm's base frame, metres."""
        return objects.position.reshape(len(objects.position), -1)

    def desired_goal(self, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the goal (goal_size,) of targets (arms, 3) in base frames, metres."""
        return target.reshape(-1)

    def reached(self, achieved: FloatArray, desired: FloatArray) -> NDArray[np.bool_]:
        """Say where every object is at its target; shape of the leading dimensions."""
        return goal_reached(achieved, desired, self.n_arms, self.success_threshold)

    def reward(self, achieved: FloatArray, desired: FloatArray) -> NDArray[np.float32]:
        """Return the reward, shape of the leading dimensions; pure."""
        return self.judge(achieved, desired)[0]

    def judge(
        self, achieved: FloatArray, desired: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the reward and where every object is at its target; pure.

        Every step asks for both, which come from the same distances.
        """
        reached = self.reached(achieved, desired)
        if self.reward_type == "sparse":
            return reached.astype(np.float32) - np.float32(1), reached
        distances = object_distances(achieved, desired, self.n_arms)
        return -distances.sum(axis=-1).astype(np.float32), reached

    def costs(
        self,
        achieved: FloatArray,
        desired: FloatArray,
        collided: NDArray[np.bool_],
        readings: Readings | None = None,
    ) -> dict[str, NDArray[np.float64]]:
        """Return each cost (n,), 1 on a step that breaks its rule, else 0.

        :param achieved: (n, goal_size).
        :param desired: (n, goal_size).
        :param collided: (n,) contact that ``cost_collision`` counts.
        :param readings: what was measured on the torso, where there is one; none is nothing.
        """
        return {"collision": collided.astype(np.float64)}
