"""IBRL's choice of action: whichever of teacher's and student's the student's critics prefer (Hu et
al., Imitation Bootstrapped Reinforcement Learning, arXiv 2311.02198).

Its other half, the same choice in the learner's target, is `TeacherProposals`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch as th
from numpy.typing import NDArray

from saver_advisors.advising.context import AdviceContext, Mask
from saver_advisors.learner.choice import better_by_arm

if TYPE_CHECKING:
    from saver_advisors.advising.advisor import Advisor


@dataclass(frozen=True)
class BetterOfBoth:
    """An arm gets the teacher's action where the student's own critics find that better.

    One value of all arms is asked about every combination of teacher's and student's actions, 2^n
    for n arms. Where the critics have a value for each arm (`per_arm_critics`) an arm asks its own,
    with the other arms' actions left to the student. A tie goes to the student.
    """

    name: ClassVar[str] = "ibrl"
    needs_critics: ClassVar[bool] = False

    @property
    def settings(self) -> Mapping[str, Any]:
        return {}

    def decide(self, context: AdviceContext) -> Mask:
        if context.student_values is None:
            raise ValueError(
                "strategy 'ibrl' asks the student's critics: advise through AdvisedMixin or "
                "AdvisingCallback, or pass student_values to Advisor.advise"
            )
        return better_by_arm(
            context.student_actions,
            context.teacher_actions,
            context.student_values,
            context.advisable,
        )


class TeacherProposals:
    """The teachers' actions in stored states, for the learner's target (IBRL's bootstrapping).

    They are asked while the budget lasts: with it the teacher is gone, in the target as in the
    environment. Asking costs no budget, since nothing is executed.

    :param advisor: whose teachers and budget
    :param scale: from the environment's units to [-1, 1], an SB3 policy's `scale_action`
    """

    def __init__(self, advisor: Advisor, scale: Any) -> None:
        self._advisor = advisor
        self._scale = scale

    @property
    def arms(self) -> Mask:
        """(n_arms,) which arms may follow a teacher."""
        return self._advisor.advisable

    def __call__(self, observations: Mapping[str, th.Tensor]) -> NDArray[np.float32] | None:
        """
        :param observations: entries (batch, dim), not normalised
        :return: (batch, n_arms, action_size) scaled to [-1, 1], or None once the budget is spent
        """
        advisor = self._advisor
        if not advisor.enabled or advisor.budget.remaining == 0:
            return None
        arrays = {key: value.cpu().numpy() for key, value in observations.items()}
        actions = advisor.teacher_actions(arrays)
        scaled = self._scale(advisor.mapping.join_actions(actions))
        clipped = np.clip(scaled, -1.0, 1.0).astype(np.float32)
        return advisor.mapping.split_action(clipped)
