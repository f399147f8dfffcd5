"""The interface of strategies: what they read, what they provide, and the advice budget.

A strategy reads an `AdviceContext` and returns a mask; the advisor applies the budget afterwards.
Every strategy has the four members of `AdvisingStrategy`. One whose attribute `labels` is true has
the teachers' actions stored at every step, executed or not. A strategy that needs the run's length,
a state of its own or the student's progress also has the methods of `PlansAhead`, `Remembers` or
`WatchesStudent`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from saver_advisors.policies.inference import FloatArray
from saver_advisors.policies.teacher import TeacherGroup
from saver_envs.validation import require

Mask = NDArray[np.bool_]

StudentValues = Callable[[NDArray[Any]], NDArray[np.float32]]
"""The student's own critics in the current states: actions of all arms, (k, n_envs, n_arms *
action_size) in the environment's units -> (k, n_envs, values), one joint value or one per part of
the goal."""


class AdviceBudget:
    """Count the environment steps that may still be advised.

    A step counts once, however many of its arms are advised. The count is exact inside a vector
    environment: if 5 steps remain and 8 environments request advice, the first 5 receive it.

    :param total: the budget n_b in environment steps.
    :raises TypeError: if it is not a whole number.
    :raises ValueError: if it is negative.
    """

    def __init__(self, total: int) -> None:
        self.total = _count("total", total)
        self.spent = 0

    @property
    def remaining(self) -> int:
        """Environment steps that may still be advised."""
        return self.total - self.spent

    def spend(self, wanted: Mask) -> Mask:
        """Pay for one step of a vector environment.

        :param wanted: (n_envs,) whether any arm of an environment should be advised.
        :return: (n_envs,) which environments receive advice: the first `remaining` of them.
        """
        wanted = np.asarray(wanted, dtype=bool)
        granted = wanted & (np.cumsum(wanted) <= self.remaining)
        self.spent += int(granted.sum())
        return granted

    def state_dict(self) -> dict[str, int]:
        """Return the JSON-able total and spent steps."""
        return {"total": self.total, "spent": self.spent}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the steps spent; the total stays this budget's, so a resumed run may raise it.

        :param state: the result of `state_dict`.
        :raises ValueError: if more was spent than this budget holds.
        """
        spent = _count("spent", state["spent"])
        if spent > self.total:
            raise ValueError(
                f"spent={spent} exceeds this budget's total of {self.total}: give a larger total"
            )
        self.spent = spent

    def __repr__(self) -> str:
        return f"AdviceBudget(total={self.total}, spent={self.spent})"


def _count(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name}={value!r} must be a whole number of environment steps")
    number = int(value)
    require(name, number, number >= 0, "0 or more, the number of environment steps to advise")
    return number


@dataclass(frozen=True)
class RunPlan:
    """Settings of a run, known before it begins; None if unknown.

    :param total_steps: environment steps, summed over all environments.
    :param horizon: steps of an episode.
    :param seed: of the run.
    """

    total_steps: int | None = None
    horizon: int | None = None
    seed: int = 0


@dataclass(frozen=True)
class AdviceContext:
    """What a strategy may read, for one step of a vector environment.

    :param teachers: one teacher for every arm.
    :param observations: (n_envs, n_arms, observation_size).
    :param goals: (n_envs, n_arms, goal_size) desired goals.
    :param achieved_goals: (n_envs, n_arms, goal_size).
    :param teacher_actions: (n_envs, n_arms, action_size) a_i_tr, in the environment's units.
    :param student_actions: (n_envs, n_arms, action_size) a_i_st = h_i(pi_st(s)).
    :param budget: the remaining budget; the advisor spends it, strategies only read it.
    :param advisable: (n_arms,) which arms may be advised; the advisor enforces it whatever the
        strategy returns.
    :param twin_minimum: whether Q_tr is the minimum of the teacher's critics, else the first.
    :param episode_steps: (n_envs,) steps since the start of each environment's episode, from 0;
        None if the caller does not count them.
    :param student_values: the student's own critics, None if the caller has none.
    :param steps: environment steps of the run before this one.
    """

    teachers: TeacherGroup
    observations: NDArray[Any]
    goals: NDArray[Any]
    achieved_goals: NDArray[Any]
    teacher_actions: FloatArray
    student_actions: NDArray[Any]
    budget: AdviceBudget
    advisable: Mask
    twin_minimum: bool = True
    episode_steps: NDArray[np.int64] | None = None
    student_values: StudentValues | None = None
    steps: int = 0

    @property
    def shape(self) -> tuple[int, int]:
        """(n_envs, n_arms)."""
        return self.teacher_actions.shape[0], self.teacher_actions.shape[1]

    @cached_property
    def q_gap(self) -> FloatArray:
        """Q_tr(s_i, a_i_tr) - Q_tr(s_i, a_i_st) (left side of eq. 5.10), (n_envs, n_arms); computed
        on first access.
        """
        own = self.student_actions.astype(np.float32, copy=False)
        of_teacher, of_student = self.teachers.q_value(
            self.observations,
            self.goals,
            np.stack([self.teacher_actions, own]),
            self.achieved_goals,
            twin_minimum=self.twin_minimum,
        )
        return of_teacher - of_student

    @cached_property
    def disagreement(self) -> FloatArray:
        """norm2(a_i_tr - a_i_st) (left side of eq. 5.11), (n_envs, n_arms)."""
        return np.linalg.norm(self.teacher_actions - self.student_actions, axis=-1)


class AdvisingStrategy(Protocol):
    """Decides which arms should receive the teacher's action."""

    name: ClassVar[str]
    """The name in configuration files and in `make_strategy`."""

    @property
    def needs_critics(self) -> bool:
        """Whether it reads the teacher's Q values, and so rejects teachers without critics."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """JSON-able parameters."""

    def decide(self, context: AdviceContext) -> Mask:
        """Return which arms should be advised, regardless of the budget, (n_envs, n_arms)."""


@runtime_checkable
class PlansAhead(Protocol):
    """A strategy that needs the run's plan and the budget before the first step."""

    def begin(self, run: RunPlan, budget: AdviceBudget) -> None:
        """Prepare for a run; the advisor's constructor calls this once.

        :param run: settings of the run.
        :param budget: of the run.
        :raises ValueError: if the strategy needs a value that is unknown; the message names it.
        """


@runtime_checkable
class Remembers(Protocol):
    """A strategy with a state, such as a random generator, that a resumed run restores."""

    def state_dict(self) -> Mapping[str, Any]:
        """Return the JSON-able state."""

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`, which may come from JSON."""


@runtime_checkable
class WatchesStudent(Protocol):
    """A strategy that follows the student's progress."""

    def student_evaluated(self, success_rate: float) -> None:
        """Receive the result of an evaluation, between two steps of the run.

        :param success_rate: of the student alone.
        """
