"""Distance-constrained pick and place: two cubes stay a shoulder's width apart (chapter 6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from saver_envs.scenes import Scene
from saver_envs.simulation import Simulation
from saver_envs.tasks.contract import Bools, FloatArray, Memory, Seen, TaskPage
from saver_envs.tasks.layout import Part
from saver_envs.tasks.pick_and_place import CarryTask
from saver_envs.tasks.sampling import StartRules, TableStart
from saver_envs.validation import require

RewardStage = Literal["goal", "constrained"]
RewardCombination = Literal["min", "linear", "shaped"]

#: Mean U.S. shoulder width (m), and how far the distance may deviate from it (m).
REQUIRED_DISTANCE, DISTANCE_TOLERANCE = 0.35, 0.015
#: Starts and targets are drawn this far inside the band (m).
_START_MARGIN = 0.005
#: A shaped constraint falls linearly up to a deviation of this many tolerances.
_SHAPED_TOLERANCES = 4.0


@dataclass(frozen=True)
class Distance(CarryTask):
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
    costs: ClassVar[tuple[str, ...]] = ("collision", "distance")
    summed: ClassVar[tuple[str, ...]] = ("distance",)
    hard: ClassVar[tuple[str, ...]] = ("distance",)
    constraint: ClassVar[tuple[str, float] | None] = ("distance", DISTANCE_TOLERANCE)
    expert: ClassVar[str | None] = "saver_envs.experts.distance:expert"

    def __post_init__(self) -> None:
        super().__post_init__()
        require("n_arms", self.n_arms, self.n_arms == 2, "exactly 2")
        # Two arms that face each other do not reach objects this far apart.
        require("layout", self.layout, self.layout == "row", "'row'")
        choices = {"reward_stage": RewardStage, "reward_combination": RewardCombination}
        for name, choice in choices.items():
            value, valid = getattr(self, name), get_args(choice)
            require(name, value, value in valid, f"one of {', '.join(valid)}")
        weight = self.constraint_weight
        require("constraint_weight", weight, 0 < weight < math.inf, "a finite number above 0")

    @property
    def goal(self) -> tuple[Part, ...]:
        """Each cube's position, and the distance between the cubes."""
        return (*super().goal, Part("distance", 1, "m", shared=True))

    def start_rules(self) -> StartRules:
        """Return the rules of a start: both cubes, and both targets, apart as required."""
        margin = DISTANCE_TOLERANCE - _START_MARGIN
        separation = (REQUIRED_DISTANCE - margin, REQUIRED_DISTANCE + margin)
        return replace(super().start_rules(), separation=separation)

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return (n, 7): both cubes' positions in base frames and their distance, metres."""
        world = seen["object world position"]
        gap = world[:, 0] - world[:, 1]
        distance = np.sqrt(np.sum(gap * gap, axis=-1, keepdims=True))
        return np.concatenate([super().achieved(simulation, memory, seen), distance], axis=-1)

    def desired(self, starts: Sequence[TableStart]) -> NDArray[np.float64]:
        """Return the goals (k, 7): both targets in base frames and the required distance."""
        required = np.full((len(starts), 1), REQUIRED_DISTANCE)
        return np.concatenate([super().desired(starts), required], axis=-1)

    def reward_and_reached(
        self, achieved: FloatArray, desired: FloatArray
    ) -> tuple[NDArray[np.float32], Bools]:
        """Return the reward of the current stage, and where both cubes are at their targets."""
        reward, reached = super().reward_and_reached(achieved, desired)
        if self.reward_stage == "goal":
            return reward, reached
        if self.reward_type == "dense":
            return reward - self.deviation(achieved, desired).astype(np.float32), reached
        kept = self.constraint_met(achieved, desired)
        constraint = kept.astype(np.float32) - np.float32(1)
        if self.reward_combination == "min":
            return np.minimum(reward, constraint), reached
        if self.reward_combination == "shaped":
            deviation = self.deviation(achieved, desired)
            share = np.minimum(deviation / (_SHAPED_TOLERANCES * DISTANCE_TOLERANCE), 1.0)
            constraint = (constraint - share.astype(np.float32)) / 2
        return reward + np.float32(self.constraint_weight) * constraint, reached

    @property
    def least_reward(self) -> float:
        """The smallest reward of a step, where rewards are sparse."""
        summed = self.reward_stage == "constrained" and self.reward_combination != "min"
        return -1.0 - self.constraint_weight if summed else -1.0

    def constraint_met(self, achieved: FloatArray, desired: FloatArray) -> Bools:
        """Return where the distance is within its tolerance (...), eq. 6.3."""
        return self.deviation(achieved, desired) <= DISTANCE_TOLERANCE

    def measure(
        self, simulation: Simulation, memory: Memory, achieved: FloatArray, desired: FloatArray
    ) -> dict[str, NDArray[np.float64]]:
        """Return the costs; that of the distance is 1 where the band is left."""
        broken = ~self.constraint_met(achieved, desired)
        measured = super().measure(simulation, memory, achieved, desired)
        return measured | {"cost_distance": broken.astype(np.float64)}

    def page(self, scene: Scene) -> TaskPage:
        """Return the text of the page."""
        page = super().page(scene)
        band = f"{REQUIRED_DISTANCE:g} m +- {100 * DISTANCE_TOLERANCE:g} cm"
        return replace(
            page,
            succeeds=f"{page.succeeds}; and the cubes stayed {band} apart at every step",
            reward=(
                "0 where every cube is within the threshold of its target and the cubes keep "
                'their distance, else -1; with `reward_stage="goal"` the distance does not count, '
                'and with `reward_combination="linear"` goal and distance are summed, -1 for each '
                "that is missed."
            ),
            dense=(
                "minus the sum of the cubes' distances to their targets, in metres, and minus how "
                "far the cubes are from the required distance."
            ),
            goal={
                **page.goal,
                "distance": "distance between the cubes, and the required one",
            },
            costs={
                **page.costs,
                "distance": f"1 on a step on which the cubes are not {band} apart",
            },
        )
