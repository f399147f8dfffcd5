"""What a strategy of advising is shown, and what it has to be.

A strategy looks at an `AdviceContext` and returns a mask; the budget is applied afterwards, by the
advisor. Four members make a strategy (`AdvisingStrategy`). One that needs more, such as the run's
length, a memory, or the student's progress, says so by having the methods of `PlansAhead`,
`Remembers` or `WatchesStudent` too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from saver_advisors.advising.budget import AdviceBudget
from saver_advisors.policies.inference import FloatArray
from saver_advisors.policies.teacher import TeacherGroup

Mask = NDArray[np.bool_]

StudentValues = Callable[[NDArray[Any]], NDArray[np.float32]]
"""The student's own critics in the states at hand: actions of all arms, (k, n_envs, n_arms *
action_size) in the environment's units -> (k, n_envs, values), one value in all or one for each
part of the goal."""


@dataclass(frozen=True)
class RunPlan:
    """What is known of a run before it begins; None where nobody said.

    :param total_steps: environment steps, all environments together
    :param horizon: steps of an episode
    :param seed: of the run
    """

    total_steps: int | None = None
    horizon: int | None = None
    seed: int = 0


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
    :param arms: (n_arms,) which arms may be advised at all, None for every arm; the advisor holds
        a strategy to it, whatever the strategy returns
    :param episode_steps: (n_envs,) steps since each environment's episode began, from 0; None where
        the caller keeps no count
    :param student_values: the student's own critics, None where the caller has none
    :param steps: environment steps of the run before this one
    """

    teachers: TeacherGroup
    observations: NDArray[Any]
    goals: NDArray[Any]
    achieved_goals: NDArray[Any]
    teacher_actions: FloatArray
    student_actions: NDArray[Any]
    budget: AdviceBudget
    twin_minimum: bool = True
    arms: Mask | None = None
    episode_steps: NDArray[np.int64] | None = None
    student_values: StudentValues | None = None
    steps: int = 0

    @property
    def shape(self) -> tuple[int, int]:
        """(n_envs, n_arms)."""
        return self.teacher_actions.shape[0], self.teacher_actions.shape[1]

    @property
    def advisable(self) -> Mask:
        """(n_arms,) which arms may be advised."""
        return np.ones(self.shape[1], dtype=bool) if self.arms is None else self.arms

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
        """Whether it reads the teacher's Q values, so that a teacher without critics has to be
        refused.
        """

    @property
    def settings(self) -> Mapping[str, Any]:
        """JSON-able parameters."""

    def decide(self, context: AdviceContext) -> Mask:
        """:return: (n_envs, n_arms) which arms should be advised, budget apart"""


@runtime_checkable
class PlansAhead(Protocol):
    """A strategy that wants to know the run and the budget before the first step."""

    def begin(self, run: RunPlan, budget: AdviceBudget) -> None:
        """Called once, by the advisor's constructor.

        :param run: what is known of the run
        :param budget: what may be spent in it
        :raises ValueError: where the strategy needs what nobody said; the message tells how to say
            it
        """


@runtime_checkable
class Remembers(Protocol):
    """A strategy with a memory, such as a random generator, that a resumed run has to get back."""

    def state_dict(self) -> Mapping[str, Any]:
        """:return: JSON-able state"""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """:param state: what `state_dict` returned, perhaps by way of JSON"""


@runtime_checkable
class WatchesStudent(Protocol):
    """A strategy that follows the student's progress."""

    def student_evaluated(self, success_rate: float) -> None:
        """Called after each evaluation, between two steps of the run.

        :param success_rate: of the student alone
        """
