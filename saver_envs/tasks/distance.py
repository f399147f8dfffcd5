"""Distance-constrained pick and place: two cubes stay a shoulder's width apart (chapter 6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from saver_envs.simulation import ObjectState
from saver_envs.tasks.base import FloatArray, Readings
from saver_envs.tasks.goals import constraint_met
from saver_envs.tasks.pick_and_place import AIR_HEIGHT, AIR_SHARE, HAND_HEIGHT, PickAndPlace
from saver_envs.tasks.sampling import StartRules

RewardStage = Literal["goal", "constrained"]
RewardCombination = Literal["min", "linear", "shaped"]

#: Mean U.S. shoulder width (m), and how far the distance may stray from it (m).
REQUIRED_DISTANCE, DISTANCE_TOLERANCE = 0.35, 0.015
#: Starts and targets are drawn this far inside the band (m).
_START_MARGIN = 0.005
#: A shaped constraint costs the more the farther the distance is off, up to this many tolerances.
_SHAPED_TOLERANCES = 4.0


@dataclass(frozen=True)
class Distance(PickAndPlace):
    """Pick and place with two arms whose cubes keep 0.35 m apart at every step.

    :param reward_stage: ``goal``: the reward of reaching the targets alone, f_g (eq. 6.4);
        ``constrained``: with f_c, which is -1 wherever the band is left (eq. 6.3).
    :param reward_combination: how the constrained stage puts them together: ``min(f_c, f_g)`` as
        in the dissertation, or ``linear``, f_g + constraint_weight * f_c. Before the goal is
        reached f_g is -1 already: the minimum does not tell whether the band was left on the way,
        the sum does. ``shaped`` is the sum with a constraint that tells by how much: half of it
        f_c, half falling from 0 to -1 on a straight line, which ends 4 tolerances away.
    :param constraint_weight: of f_c in the sum, above 0.
    """

    reward_stage: RewardStage = "constrained"
    reward_combination: RewardCombination = "min"
    constraint_weight: float = 1.0

    name: ClassVar[str] = "distance"
    cost_names: ClassVar[tuple[str, ...]] = ("distance",)
    never: ClassVar[tuple[str, ...]] = ("distance",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_arms != 2:
            raise ValueError(f"n_arms={self.n_arms!r}: the distance task needs exactly 2 arms")
        if self.reward_stage not in ("goal", "constrained"):
            raise ValueError(
                f"reward_stage={self.reward_stage!r}: valid stages are 'goal' and 'constrained'"
            )
        if self.reward_combination not in get_args(RewardCombination):
            raise ValueError(
                f"reward_combination={self.reward_combination!r}: must be one of "
                f"{', '.join(get_args(RewardCombination))}"
            )
        if not (math.isfinite(self.constraint_weight) and self.constraint_weight > 0):
            raise ValueError(
                f"constraint_weight={self.constraint_weight!r} must be a finite number above 0"
            )

    @property
    def goal_size(self) -> int:
        """Number of entries of a goal: two positions and the distance."""
        return 3 * self.n_arms + 1

    def start_rules(self, object_rest_height: float) -> StartRules:
        """Return the rules of a start; see :meth:`Task.start_rules`."""
        margin = DISTANCE_TOLERANCE - _START_MARGIN
        return StartRules(
            hand_height=HAND_HEIGHT,
            air_share=AIR_SHARE,
            air_height=AIR_HEIGHT,
            success_threshold=self.success_threshold,
            pushes=False,
            separation=(REQUIRED_DISTANCE - margin, REQUIRED_DISTANCE + margin),
        )

    def achieved_goal(self, objects: ObjectState) -> NDArray[np.float64]:
        """Return (n, 7): both objects' positions in base frames and their distance, metres."""
        gap = objects.world_position[:, 0] - objects.world_position[:, 1]
        distance = np.sqrt(np.sum(gap * gap, axis=-1, keepdims=True))
        return np.concatenate([super().achieved_goal(objects), distance], axis=-1)

    def desired_goal(self, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the goal (7,): targets (2, 3) in base frames and the required distance."""
        return np.append(super().desired_goal(target), REQUIRED_DISTANCE)

    def judge(
        self, achieved: FloatArray, desired: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the reward of the stage in force and where both cubes are at their targets."""
        reward, reached = super().judge(achieved, desired)
        if self.reward_stage == "goal":
            return reward, reached
        if self.reward_type == "dense":
            astray = np.abs(achieved[..., -1] - desired[..., -1])
            return reward - astray.astype(np.float32), reached
        kept = constraint_met(achieved, desired, DISTANCE_TOLERANCE)
        constraint = kept.astype(np.float32) - np.float32(1)
        if self.reward_combination == "min":
            return np.minimum(reward, constraint), reached
        if self.reward_combination == "shaped":
            astray = np.abs(achieved[..., -1] - desired[..., -1])
            share = np.minimum(astray / (_SHAPED_TOLERANCES * DISTANCE_TOLERANCE), 1.0)
            constraint = (constraint - share.astype(np.float32)) / 2
        return reward + np.float32(self.constraint_weight) * constraint, reached

    @property
    def least_reward(self) -> float:
        """The smallest reward of a step, where rewards are sparse."""
        summed = self.reward_stage == "constrained" and self.reward_combination != "min"
        return -1.0 - self.constraint_weight if summed else -1.0

    def costs(
        self,
        achieved: FloatArray,
        desired: FloatArray,
        collided: NDArray[np.bool_],
        readings: Readings | None = None,
    ) -> dict[str, NDArray[np.float64]]:
        """Return collision and distance costs; the latter is 1 where the band is left."""
        costs = super().costs(achieved, desired, collided, readings)
        kept = constraint_met(achieved, desired, DISTANCE_TOLERANCE)
        costs["distance"] = (~kept).astype(np.float64)
        return costs
