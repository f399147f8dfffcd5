"""When an arm gets the teacher's action: one small class a strategy.

A strategy looks at an `AdviceContext` and returns a mask; the budget is applied afterwards, by the
advisor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from saver_advisors.advising.budget import AdviceBudget
from saver_advisors.advising.inference import FloatArray
from saver_advisors.advising.teacher import TeacherGroup

Mask = NDArray[np.bool_]

DEFAULT_THRESHOLD: Final = 0.1
"""t_I and alpha where none is given: the largest, that is the most sparing, of the paper's 0.01,
0.05, 0.1.
"""


@dataclass(frozen=True)
class AdviceContext:
    """What a strategy may look at, for one step of a vector of environments.

    :param teachers: one teacher for every arm
    :param observations: (n_envs, n_arms, observation_size)
    :param goals: (n_envs, n_arms, goal_size) desired goals
    :param achieved_goals: (n_envs, n_arms, goal_size)
    :param teacher_actions: (n_envs, n_arms, action_size) a_i_tr, in the environment's units
    :param student_actions: (n_envs, n_arms, action_size) a_i_st = h_i(pi_st(s))
    :param budget: what is left; strategies read it and never spend
    :param twin_minimum: whether Q_tr is the smallest of the teacher's critics, else the first
    """

    teachers: TeacherGroup
    observations: NDArray[Any]
    goals: NDArray[Any]
    achieved_goals: NDArray[Any]
    teacher_actions: FloatArray
    student_actions: NDArray[Any]
    budget: AdviceBudget
    twin_minimum: bool = True

    @property
    def shape(self) -> tuple[int, int]:
        """(n_envs, n_arms)."""
        return self.teacher_actions.shape[0], self.teacher_actions.shape[1]

    @cached_property
    def q_gap(self) -> FloatArray:
        """Q_tr(s_i, a_i_tr) - Q_tr(s_i, a_i_st) (left side of eq. 5.10), (n_envs, n_arms); computed
        when first read.
        """
        candidates = np.stack(
            [self.teacher_actions, self.student_actions.astype(np.float32, copy=False)]
        )
        of_teacher, of_student = self.teachers.q_value(
            self.observations,
            self.goals,
            candidates,
            self.achieved_goals,
            twin_minimum=self.twin_minimum,
        )
        gap: FloatArray = of_teacher - of_student
        return gap

    @cached_property
    def disagreement(self) -> FloatArray:
        """norm2(a_i_tr - a_i_st) (left side of eq. 5.11), (n_envs, n_arms)."""
        distance: FloatArray = np.linalg.norm(self.teacher_actions - self.student_actions, axis=-1)
        return distance


class AdvisingStrategy(Protocol):
    """Decides which arms should get the teacher's action."""

    name: ClassVar[str]
    """What configuration files and `make_strategy` call it."""

    @property
    def needs_critics(self) -> bool:
        """Whether it reads Q values, so that a teacher without critics has to be refused."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """JSON-able parameters."""

    def decide(self, context: AdviceContext) -> Mask:
        """:return: (n_envs, n_arms) which arms should be advised, budget apart"""


@dataclass(frozen=True)
class NoAdvice:
    """NA: never."""

    name: ClassVar[str] = "none"
    needs_critics: ClassVar[bool] = False

    @property
    def settings(self) -> Mapping[str, Any]:
        return {}

    def decide(self, context: AdviceContext) -> Mask:
        return np.zeros(context.shape, dtype=bool)


@dataclass(frozen=True)
class EarlyAdvising:
    """EA: always, until the budget is spent."""

    name: ClassVar[str] = "early"
    needs_critics: ClassVar[bool] = False

    @property
    def settings(self) -> Mapping[str, Any]:
        return {}

    def decide(self, context: AdviceContext) -> Mask:
        return np.ones(context.shape, dtype=bool)


@dataclass(frozen=True)
class _Correcting:
    """What the mistake-correcting strategies share: one threshold.

    :param threshold: t_I or alpha; finite and not negative
    :raises ValueError: where it is negative, infinite or no number
    """

    threshold: float = DEFAULT_THRESHOLD

    def __post_init__(self) -> None:
        value = self.threshold
        number = isinstance(value, (int, float, np.floating)) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or value < 0.0:
            raise ValueError(
                f"threshold={value!r} must be a finite number of at least 0 (the paper uses 0.01, "
                f"0.05 and 0.1)"
            )

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"threshold": float(self.threshold)}


@dataclass(frozen=True)
class MistakeCorrectingQ(_Correcting):
    """MC-Q: where the teacher's critic finds its own action better by more than t_I (eq. 5.10)."""

    name: ClassVar[str] = "mc-q"
    needs_critics: ClassVar[bool] = True

    def decide(self, context: AdviceContext) -> Mask:
        mask: Mask = context.q_gap > self.threshold
        return mask


@dataclass(frozen=True)
class MistakeCorrectingAction(_Correcting):
    """MC-ACT: where the two actions are further apart than t_a = alpha (eq. 5.11)."""

    name: ClassVar[str] = "mc-act"
    needs_critics: ClassVar[bool] = False

    def decide(self, context: AdviceContext) -> Mask:
        mask: Mask = context.disagreement > self.threshold
        return mask


@dataclass(frozen=True)
class MistakeCorrectingRelativeAction(_Correcting):
    """MC-ACTABS: the same with t_a = alpha * norm2(a_i_tr).

    The equation (5.11) stands here; the sentence above it in the dissertation names the two the
    other way round.
    """

    name: ClassVar[str] = "mc-actabs"
    needs_critics: ClassVar[bool] = False

    def decide(self, context: AdviceContext) -> Mask:
        size = np.linalg.norm(context.teacher_actions, axis=-1)
        mask: Mask = context.disagreement > self.threshold * size
        return mask


@dataclass(frozen=True)
class EarlyThenCorrecting:
    """EAMC: early advising for the first half of the budget, then a correcting strategy.

    The hand-over is exact inside a vector: where 3 steps of the first half remain, the first 3
    environments are advised early and the others are corrected.

    :param correcting: the strategy of the second half
    """

    correcting: AdvisingStrategy = MistakeCorrectingQ()
    name: ClassVar[str] = "early-mc"

    @property
    def needs_critics(self) -> bool:
        return self.correcting.needs_critics

    @property
    def settings(self) -> Mapping[str, Any]:
        return {"correcting": self.correcting.name, **self.correcting.settings}

    def decide(self, context: AdviceContext) -> Mask:
        n_envs, _ = context.shape
        early = context.budget.spent + np.arange(n_envs) < context.budget.total / 2
        mask = np.ones(context.shape, dtype=bool)
        if not early.all():
            mask[~early] = self.correcting.decide(context)[~early]
        return mask


MistakeCorrecting = MistakeCorrectingQ | MistakeCorrectingAction | MistakeCorrectingRelativeAction

CORRECTING: Final[Mapping[str, type[MistakeCorrecting]]] = {
    "mc-q": MistakeCorrectingQ,
    "mc-act": MistakeCorrectingAction,
    "mc-actabs": MistakeCorrectingRelativeAction,
}
"""The strategies with a threshold, which may also be the second half of `early-mc`."""

STRATEGIES: Final[Mapping[str, type[AdvisingStrategy]]] = {
    "none": NoAdvice,
    "early": EarlyAdvising,
    "mc-q": MistakeCorrectingQ,
    "mc-act": MistakeCorrectingAction,
    "mc-actabs": MistakeCorrectingRelativeAction,
    "early-mc": EarlyThenCorrecting,
}
"""Every strategy by the name that configurations use."""


def make_strategy(
    name: str, threshold: float | None = None, *, correcting: str | None = None
) -> AdvisingStrategy:
    """A strategy by name.

    :param name: a key of `STRATEGIES`
    :param threshold: t_I (mc-q) or alpha (mc-act, mc-actabs), or that of early-mc's second half;
        0.1 by default
    :param correcting: early-mc's second half: mc-q (default), mc-act or mc-actabs
    :raises ValueError: for an unknown name, a threshold out of range, or an argument that the
        strategy has not
    """
    if name not in STRATEGIES:
        raise ValueError(f"strategy={name!r} is unknown: use one of {', '.join(STRATEGIES)}")
    if correcting is not None and name != "early-mc":
        raise ValueError(f"correcting={correcting!r} belongs to 'early-mc' only, not to {name!r}")
    limit = DEFAULT_THRESHOLD if threshold is None else threshold
    if name == "early-mc":
        second = "mc-q" if correcting is None else correcting
        if second not in CORRECTING:
            raise ValueError(
                f"correcting={second!r} is unknown: use one of {', '.join(CORRECTING)}"
            )
        return EarlyThenCorrecting(CORRECTING[second](limit))
    if name in CORRECTING:
        return CORRECTING[name](limit)
    if threshold is not None:
        raise ValueError(
            f"strategy {name!r} takes no threshold, but threshold={threshold!r} was given"
        )
    return STRATEGIES[name]()
