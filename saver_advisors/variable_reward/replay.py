"""Replay for tasks whose goal ends in a required value: goal and constraint relabelled.

Algorithm 1 of the dissertation relabels, besides the goal, the constraint: c becomes the value that
was achieved in the *next* state. Then the constraint always counts as kept, and min(f_c, f_g) tells
nothing about it; the other ways are there to be compared with that one.
"""

from __future__ import annotations

from typing import Any, Final, Literal, get_args

import numpy as np

from saver_advisors.learner.episodes import FloatArray, IntArray
from saver_advisors.learner.replay import GoalReplayBuffer

ConstraintRelabelling = Literal["next", "future", "keep"]
RELABELLINGS: Final[tuple[str, ...]] = get_args(ConstraintRelabelling)


class ConstraintReplayBuffer(GoalReplayBuffer):
    """Replay whose last entry of the goal is a constraint's value.

    Every sampled reward is computed when it is drawn, by the reward function then in force:
    exchanging that function is all that a change of stage takes, no reward of an earlier stage is
    left.

    :param arguments: as for ``GoalReplayBuffer``
    :param constraint_relabelling: what becomes of the required value where a transition is
        relabelled: ``next``, the value achieved in its next state (Algorithm 1); ``future``, that
        of the state whose goal was taken; ``keep``, the required value stays
    :raises ValueError: for another way, or a goal without an entry beyond whole points
    """

    def __init__(
        self,
        *arguments: Any,
        constraint_relabelling: ConstraintRelabelling = "next",
        **named: Any,
    ) -> None:
        if constraint_relabelling not in RELABELLINGS:
            raise ValueError(
                f"constraint_relabelling={constraint_relabelling!r} must be one of "
                f"{', '.join(RELABELLINGS)}"
            )
        super().__init__(*arguments, **named)
        self.constraint_relabelling = constraint_relabelling
        size = self.achieved_goal.shape[-1]
        if size % 3 != 1:
            raise ValueError(
                f"the goal has {size} entries: a constraint's value must follow the objects' "
                "points of 3"
            )

    def _relabel(
        self,
        desired: FloatArray,
        achieved: FloatArray,
        slot: IntArray,
        step: IntArray,
        share: float,
    ) -> IntArray:
        """Replace goals in place as the parent does, and the required value in its own way."""
        required = desired[:, -1].copy()
        goal_step = super()._relabel(desired, achieved, slot, step, share)
        if self.constraint_relabelling == "future":
            return goal_step
        desired[:, -1] = required
        # The part that the required value belongs to: the whole goal, or one of its own.
        if self.constraint_relabelling == "next":
            relabelled = goal_step[:, -1] >= 0
            following = slot * (self.horizon + 1) + step + 1
            desired[relabelled, -1] = np.take(achieved[:, -1], following)[relabelled]
        elif goal_step.shape[1] > 1:
            goal_step[:, -1] = -1
        return goal_step
