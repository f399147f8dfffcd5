"""Jump-start RL: the teacher begins each episode, the student ends it (Uchendu et al., arXiv
2204.02372).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from saver_advisors.advising.budget import AdviceBudget
from saver_advisors.advising.context import AdviceContext, Mask, RunPlan


class JumpStart:
    """All arms are advised in the first h steps of each episode; h falls in stages.

    Stage k of n has h = horizon * (1 - k / n), rounded up, so that the first is early advising. By
    default each stage gets its n-th of the budget. With `success` the student's own progress
    decides: the stage is k once an evaluation of the student alone has reached k / n of `success`,
    and it never goes back. The budget ends the matter in either case.

    The original compares the success of teacher and student together with its best so far. Here
    training acts with exploration noise, which hides that success, so it is the evaluated student
    that counts.

    :param stages: n, at least 1
    :param success: of the student alone, in (0, 1], at which the teacher is done; None for the
        schedule over the budget
    :param horizon: steps of an episode; the run's where None
    :raises ValueError: where a value is out of range
    """

    name: ClassVar[str] = "jump-start"
    needs_critics: ClassVar[bool] = False

    def __init__(
        self, stages: int = 10, success: float | None = None, horizon: int | None = None
    ) -> None:
        for name, value in (("stages", stages), ("horizon", horizon)):
            if value is not None and (type(value) is not int or value < 1):
                raise ValueError(f"{name}={value!r} must be a whole number of at least 1")
        if success is not None:
            number = isinstance(success, (int, float)) and not isinstance(success, bool)
            if not number or not math.isfinite(success) or not 0.0 < success <= 1.0:
                raise ValueError(f"success={success!r} must be a number in (0, 1]")
        self.stages = stages
        self.success = success
        self.horizon = horizon
        self._horizon = horizon
        self._reached = 0

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"stages": self.stages, "success": self.success, "horizon": self.horizon}

    def begin(self, run: RunPlan, budget: AdviceBudget) -> None:
        """Take over the episodes' length.

        :param run: its `horizon` is needed where none was given
        :param budget: not used: what is left is asked for at each step
        :raises ValueError: where neither says how long an episode is
        """
        self._horizon = run.horizon if self.horizon is None else self.horizon
        if self._horizon is None:
            raise ValueError(
                "strategy 'jump-start' shortens the teacher's part of an episode: give horizon, "
                "the steps of one"
            )

    def teacher_steps(self, budget: AdviceBudget) -> int:
        """
        :param budget: of the run
        :return: h, the steps of an episode that are the teacher's now
        """
        assert self._horizon is not None, "`begin` comes first"
        stage = self._reached
        if self.success is None:
            stage = self.stages * budget.spent // max(1, budget.total)
        return math.ceil(self._horizon * max(0, self.stages - stage) / self.stages)

    def decide(self, context: AdviceContext) -> Mask:
        if context.episode_steps is None:
            raise ValueError(
                "strategy 'jump-start' needs the step within the episode: advise through "
                "AdvisedMixin or AdvisingCallback, or pass episode_steps to Advisor.advise"
            )
        chosen = context.episode_steps < self.teacher_steps(context.budget)
        return np.repeat(chosen[:, np.newaxis], context.shape[1], axis=1)

    def student_evaluated(self, success_rate: float) -> None:
        """:param success_rate: of the student alone"""
        if self.success is not None:
            # Rounded: 0.3 / 0.9 * 3 is a hair below 1 in floating point.
            stage = math.floor(round(self.stages * success_rate / self.success, 9))
            self._reached = max(self._reached, min(self.stages, stage))

    def state_dict(self) -> Mapping[str, Any]:
        """:return: JSON-able stage"""
        return {"reached": self._reached}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """:param state: what `state_dict` returned"""
        self._reached = int(state["reached"])

    def __repr__(self) -> str:
        return f"JumpStart(stages={self.stages}, success={self.success}, horizon={self.horizon})"
