"""Replay for tasks whose goal ends in a required value: goal and constraint are relabelled.

Algorithm 1 of the dissertation relabels both the goal and the constraint: c becomes the value that
was achieved in the *next* state. Then the constraint always counts as satisfied, and min(f_c, f_g)
carries no information about it; the other relabellings exist for comparison.
"""

from __future__ import annotations

from typing import Any, Final, Literal, get_args

from saver_advisors.learner.episodes import FloatArray, IntArray
from saver_advisors.learner.replay import GoalReplayBuffer
from saver_envs.validation import require

ConstraintRelabelling = Literal["next", "future", "keep"]
RELABELLINGS: Final[tuple[str, ...]] = get_args(ConstraintRelabelling)


class ConstraintReplayBuffer(GoalReplayBuffer):
    """Replay whose last entry of the goal is a constraint's value.

    Rewards are computed when sampled, by the current reward function: replacing that function is
    sufficient for a change of stage.

    :param arguments: as for ``GoalReplayBuffer``.
    :param constraint_relabelling: the required value of a relabelled transition: ``next``, the
        value achieved in its next state (Algorithm 1); ``future``, that of the state whose goal was
        taken; ``keep``, the original value.
    :param goal_size: entries of one object's goal; the constraint's value follows the objects'.
    :param named: as for ``GoalReplayBuffer``.
    :raises ValueError: for an unknown relabelling, or a goal that does not end in a single value.
    """

    def __init__(
        self,
        *arguments: Any,
        constraint_relabelling: ConstraintRelabelling = "next",
        goal_size: int = 3,
        **named: Any,
    ) -> None:
        known = constraint_relabelling in RELABELLINGS
        wanted = f"one of {', '.join(RELABELLINGS)}"
        require("constraint_relabelling", constraint_relabelling, known, wanted)
        super().__init__(*arguments, **named)
        self.constraint_relabelling = constraint_relabelling
        size = self.achieved_goal.shape[-1]
        if size % goal_size != 1:
            raise ValueError(
                f"the goal has {size} entries: a constraint's value must follow the objects' goals "
                f"of {goal_size}"
            )

    def _relabel(self, desired: FloatArray, slot: IntArray, step: IntArray) -> IntArray:
        """Relabel goals in place as the parent does, and the required value as configured."""
        required = desired[:, -1].copy()
        goal_step = super()._relabel(desired, slot, step)
        if self.constraint_relabelling == "future":
            return goal_step
        desired[:, -1] = required
        # The last part contains the required value: it is the whole goal, or a part of its own.
        if self.constraint_relabelling == "next":
            relabelled = goal_step[:, -1] >= 0
            desired[relabelled, -1] = self.achieved_goal[slot, step + 1, -1][relabelled]
        elif goal_step.shape[1] > 1:
            goal_step[:, -1] = -1
        return goal_step
