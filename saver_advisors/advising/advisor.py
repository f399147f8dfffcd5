"""The advisor: asks teacher and strategy, pays from the budget, replaces actions, and counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from saver_advisors.advising.budget import AdviceBudget
from saver_advisors.advising.context import (
    AdviceContext,
    AdvisingStrategy,
    Mask,
    PlansAhead,
    Remembers,
    RunPlan,
    StudentValues,
    WatchesStudent,
)
from saver_advisors.policies.inference import FloatArray
from saver_advisors.policies.mapping import ArmMapping
from saver_advisors.policies.teacher import Teacher, TeacherGroup

Compare = Literal["noisy", "noise-free"]
"""Which student action a correcting strategy judges: the one about to be executed, with exploration
noise and in warm-up at random, or the policy's deterministic one.
"""

Observation = Mapping[str, NDArray[Any]]


class Advice(NamedTuple):
    """One step's outcome.

    actions: (n_envs, n_arms * action_size), the student's with the advised arms' blocks replaced
    mask: (n_envs, n_arms), which arms were advised
    """

    actions: NDArray[Any]
    mask: Mask


@dataclass
class _Figures:
    """Sums since the last log line. Means over nothing are left out of the log."""

    arms: int
    transitions: int = 0
    advised_transitions: int = 0
    compared_arms: int = 0
    disagreement_sum: float = 0.0
    q_gap_arms: int = 0
    q_gap_sum: float = 0.0
    advised_arms: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        self.advised_arms = np.zeros(self.arms, dtype=np.int64)

    def add_mask(self, mask: Mask) -> None:
        self.transitions += len(mask)
        self.advised_transitions += int(mask.any(axis=1).sum())
        self.advised_arms += mask.sum(axis=0)

    def add_context(self, context: AdviceContext) -> None:
        self.compared_arms += context.disagreement.size
        self.disagreement_sum += float(context.disagreement.sum())
        # The gap is a cached property: read it only where the strategy paid for it already.
        if "q_gap" in vars(context):
            self.q_gap_arms += context.q_gap.size
            self.q_gap_sum += float(context.q_gap.sum())


class Advisor:
    """Advises a student of n arms with single-arm teachers.

    :param strategy: when an arm is advised
    :param teachers: one teacher for every arm, or one per arm
    :param mapping: where each arm's block lies
    :param budget: how many environment steps may be advised
    :param compare: which student action correcting strategies judge
    :param twin_minimum: Q_tr is the smallest of the teacher's critics, else the first
    :param arms: which arms may be advised, by their numbers from 0; every arm where None
    :param run: what is known of the run that begins
    :raises ValueError: where teacher, strategy and mapping do not fit one another; the message
        names the sizes
    """

    def __init__(
        self,
        strategy: AdvisingStrategy,
        teachers: Teacher | Sequence[Teacher],
        mapping: ArmMapping,
        budget: AdviceBudget,
        *,
        compare: Compare = "noisy",
        twin_minimum: bool = True,
        arms: Sequence[int] | None = None,
        run: RunPlan | None = None,
    ) -> None:
        if compare not in get_args(Compare):
            raise ValueError(f"compare={compare!r} must be one of {', '.join(get_args(Compare))}")
        self.strategy = strategy
        self.teachers = TeacherGroup(teachers, mapping.n_arms)
        self.mapping = mapping
        self.budget = budget
        self.compare: Compare = compare
        self.twin_minimum = twin_minimum
        self._advisable = _arm_mask(arms, mapping.n_arms)
        self.enabled = True
        self._check_teachers()
        if isinstance(strategy, PlansAhead):
            strategy.begin(run or RunPlan(), budget)
        self._window = _Figures(mapping.n_arms)
        self._advised_per_arm = np.zeros(mapping.n_arms, dtype=np.int64)
        self._transitions = 0

    def _check_teachers(self) -> None:
        mapping = self.mapping
        for teacher in self.teachers.teachers:
            for key, size, wanted in (
                ("observation", teacher.observation_size, mapping.observation_size),
                ("goal", teacher.goal_size, mapping.goal_size),
                ("action", teacher.action_size, mapping.action_size),
            ):
                if size != wanted:
                    raise ValueError(
                        f"teacher {teacher.name!r} has {key} size {size}, but one arm of the "
                        f"student has {wanted} ({mapping})"
                    )
        if self.strategy.needs_critics and not self.teachers.has_critics:
            raise ValueError(
                f"strategy {self.strategy.name!r} compares Q values, but teacher "
                f"{sorted({t.name for t in self.teachers.teachers if not t.has_critics})} has no "
                "critics: use 'early', 'mc-act' or 'mc-actabs', or a teacher saved with its critics"
            )

    @property
    def spent(self) -> int:
        """Environment steps advised so far."""
        return self.budget.spent

    @property
    def active(self) -> bool:
        """Whether any advice can still be given; never while ``enabled`` is false, as it is in
        stages of a run that have no teacher.
        """
        return self.enabled and self.budget.remaining > 0 and self.strategy.name != "none"

    @property
    def advisable(self) -> Mask:
        """(n_arms,) which arms may be advised."""
        return self._advisable.copy()

    @property
    def needs_noise_free(self) -> bool:
        """Whether `advise` wants the student's deterministic actions in its next call."""
        return self.active and self.compare == "noise-free"

    @property
    def advised_per_arm(self) -> NDArray[np.int64]:
        """(n_arms,) how often each arm was advised so far."""
        return self._advised_per_arm.copy()

    def check_spaces(
        self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        """Refuse a student that this advisor was not made for; called before training starts.

        :param observation_space: the student's
        :param action_space: the student's
        :raises ValueError: where sizes differ; the message names them
        """
        try:
            self.mapping.check_spaces(observation_space, action_space)
        except ValueError as error:
            raise ValueError(
                f"teacher {self.teachers.names} does not fit this student: {error}"
            ) from error

    def advise(
        self,
        observation: Observation,
        student_actions: NDArray[Any],
        compared_actions: NDArray[Any] | None = None,
        *,
        episode_steps: NDArray[np.int64] | None = None,
        student_values: StudentValues | None = None,
    ) -> Advice:
        """Replace the actions of the arms that should be advised.

        :param observation: `observation`, `achieved_goal` and `desired_goal`, each (n_envs, size),
            not normalised
        :param student_actions: (n_envs, n_arms * action_size), in the environment's units; not
            modified
        :param compared_actions: the same shape, what a correcting strategy judges with
            compare="noise-free"
        :param episode_steps: (n_envs,) steps since each environment's episode began, where the
            strategy reads them
        :param student_values: the student's own critics, where the strategy asks them
        :return: actions and mask; the student's own array and an all-False mask where nothing is
            advised
        """
        mask = np.zeros((len(student_actions), self.mapping.n_arms), dtype=bool)
        actions = student_actions
        if self.active:
            context = self._context(
                observation,
                student_actions if compared_actions is None else compared_actions,
                episode_steps=episode_steps,
                student_values=student_values,
            )
            wanted = self._decide(context)
            granted = self.budget.spend(np.any(wanted, axis=1))
            mask = wanted & granted[:, np.newaxis]
            self._window.add_context(context)
            if mask.any():
                by_arm = self.mapping.split_action(student_actions)
                advised = np.where(mask[..., np.newaxis], context.teacher_actions, by_arm)
                actions = self.mapping.join_actions(advised).astype(
                    student_actions.dtype, copy=False
                )
        self._count(mask)
        return Advice(actions, mask)

    def _decide(self, context: AdviceContext) -> Mask:
        """The strategy's mask, held to the arms that may be advised.

        :raises ValueError: for anything but a mask of environments and arms, which would be
            stretched to one unseen
        """
        wanted = np.asarray(self.strategy.decide(context))
        if wanted.shape != context.shape or wanted.dtype != np.bool_:
            raise ValueError(
                f"strategy {self.strategy.name!r} decided {wanted.dtype} {wanted.shape}: it must "
                f"return truth values of shape (n_envs, n_arms) = {context.shape}"
            )
        return wanted & self._advisable

    def _context(
        self, observation: Observation, student_actions: NDArray[Any], **known: Any
    ) -> AdviceContext:
        observations, goals, achieved_goals = self._by_arm(observation)
        return AdviceContext(
            teachers=self.teachers,
            observations=observations,
            goals=goals,
            achieved_goals=achieved_goals,
            teacher_actions=self.teachers.act(observations, goals, achieved_goals),
            student_actions=self.mapping.split_action(student_actions),
            budget=self.budget,
            twin_minimum=self.twin_minimum,
            arms=self._advisable,
            steps=self._transitions,
            **known,
        )

    def _by_arm(self, observation: Observation) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Observations, desired and achieved goals, each (n_envs, n_arms, size)."""
        return (
            self.mapping.split_observation(observation["observation"]),
            self.mapping.split_goal(observation["desired_goal"]),
            self.mapping.split_goal(observation["achieved_goal"]),
        )

    def teacher_actions(self, observation: Observation) -> FloatArray:
        """What the teachers would do, whatever strategy and budget say; nothing is counted.

        :param observation: as for `advise`
        :return: (n_envs, n_arms, action_size), in the environment's units
        """
        return self.teachers.act(*self._by_arm(observation))

    def demonstrate(self, observation: Observation) -> Advice:
        """All teachers act, at one step of the budget for each environment.

        :param observation: as for `advise`
        :return: the teachers' actions, and an all-True mask
        :raises ValueError: where the budget does not last for all environments, or some arm must
            not be advised
        """
        n_envs = len(observation["observation"])
        if self.budget.remaining < n_envs:
            raise ValueError(
                f"budget={self.budget.total}: {self.budget.remaining} steps remain, and a "
                f"demonstration in {n_envs} environments takes {n_envs}"
            )
        if not self._advisable.all():
            raise ValueError(
                f"arms={np.flatnonzero(self._advisable).tolist()}: in a demonstration a teacher "
                f"drives each of the {self.mapping.n_arms} arms; leave arms out"
            )
        mask = np.ones((n_envs, self.mapping.n_arms), dtype=bool)
        self.budget.spend(np.ones(n_envs, dtype=bool))
        self._count(mask)
        return Advice(self.mapping.join_actions(self.teacher_actions(observation)), mask)

    def student_evaluated(self, success_rate: float) -> None:
        """Tell a strategy that follows the student's progress how an evaluation went.

        :param success_rate: of the student alone
        """
        if isinstance(self.strategy, WatchesStudent):
            self.strategy.student_evaluated(success_rate)

    def _count(self, mask: Mask) -> None:
        self._window.add_mask(mask)
        self._advised_per_arm += mask.sum(axis=0)
        self._transitions += len(mask)

    def log_values(self) -> dict[str, float]:
        """Figures for SB3's logger: totals, and means over the time since `start_window`.

        :return: names such as `advice/share` (advised transitions / transitions),
            `advice/disagreement` (mean norm2(a_tr - a_st), in action units) and, where the strategy
            reads Q values, `advice/q_gap`
        """
        window = self._window
        values: dict[str, float] = {
            "advice/spent": self.budget.spent,
            "advice/remaining": self.budget.remaining,
        }
        if window.transitions:
            values["advice/share"] = window.advised_transitions / window.transitions
            for arm, count in enumerate(window.advised_arms):
                values[f"advice/share_arm_{arm}"] = float(count) / window.transitions
        if window.compared_arms:
            values["advice/disagreement"] = window.disagreement_sum / window.compared_arms
        if window.q_gap_arms:
            values["advice/q_gap"] = window.q_gap_sum / window.q_gap_arms
        return values

    def start_window(self) -> None:
        """Start the means of `log_values` afresh."""
        self._window = _Figures(self.mapping.n_arms)

    def state_dict(self) -> dict[str, Any]:
        """:return: JSON-able state: what was given so far, and under which strategy and teachers"""
        return {
            "strategy": self.strategy.name,
            "settings": dict(self.strategy.settings),
            "teachers": self.teachers.names,
            "compare": self.compare,
            "twin_minimum": self.twin_minimum,
            "budget": self.budget.state_dict(),
            "advised_per_arm": self._advised_per_arm.tolist(),
            "transitions": self._transitions,
            "arms": np.flatnonzero(self._advisable).tolist(),
            "strategy_state": dict(self.strategy.state_dict())
            if isinstance(self.strategy, Remembers)
            else None,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on with the budget of an earlier run.

        :param state: what `state_dict` returned, perhaps by way of JSON or a saved model's
            `advice_state`
        :raises ValueError: where strategy or number of arms differ, or more was spent than the
            budget holds
        """
        if state["strategy"] != self.strategy.name:
            raise ValueError(
                f"the state is of strategy {state['strategy']!r}, this advisor's is "
                f"{self.strategy.name!r}"
            )
        if len(state["advised_per_arm"]) != self.mapping.n_arms:
            raise ValueError(
                f"the state is of {len(state['advised_per_arm'])} arms, this advisor has "
                f"{self.mapping.n_arms}"
            )
        self.budget.load_state_dict(state["budget"])
        self._advised_per_arm = np.asarray(state["advised_per_arm"], dtype=np.int64)
        self._transitions = int(state["transitions"])
        if isinstance(self.strategy, Remembers):
            if not state.get("strategy_state"):
                raise ValueError(
                    f"the state holds no strategy_state, which {self.strategy.name!r} needs"
                )
            self.strategy.load_state_dict(state["strategy_state"])
        self.start_window()

    def __repr__(self) -> str:
        teachers = self.teachers.names
        return f"Advisor({self.strategy}, {teachers=}, {self.mapping}, {self.budget})"


def _arm_mask(arms: Sequence[int] | None, n_arms: int) -> Mask:
    """(n_arms,) from numbers of arms.

    :raises ValueError: for a number that is no arm's, or none at all
    """
    if arms is None:
        return np.ones(n_arms, dtype=bool)
    given = list(arms)
    whole = all(isinstance(arm, (int, np.integer)) and not isinstance(arm, bool) for arm in given)
    if not given or not whole or min(given) < 0 or max(given) >= n_arms:
        raise ValueError(
            f"arms={given} must be one or more of {list(range(n_arms))}: which of the "
            f"{n_arms} arms may be advised"
        )
    mask = np.zeros(n_arms, dtype=bool)
    mask[given] = True
    return mask
