"""The advisor: queries teachers and strategy, spends the budget and replaces actions.

`make_advisor` builds one from the names and numbers of a configuration.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os import PathLike
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray

from saver_advisors.advising.context import (
    AdviceBudget,
    AdviceContext,
    AdvisingStrategy,
    Mask,
    PlansAhead,
    Remembers,
    RunPlan,
    StudentValues,
    WatchesStudent,
)
from saver_advisors.advising.strategies import import_object, make_strategy
from saver_advisors.policies.files import load_teacher
from saver_advisors.policies.inference import FloatArray
from saver_advisors.policies.mapping import ArmMapping, flat_size
from saver_advisors.policies.scripted import EXPERT, PREFIX, ExpertGroup, scripted_teachers
from saver_advisors.policies.teacher import FunctionTeacher, Teacher, TeacherFunction, TeacherGroup
from saver_envs.episodes import Episodes
from saver_envs.experts import Expert, expert_of
from saver_envs.validation import require

Compare = Literal["noisy", "noise-free"]
"""The student action that a correcting strategy compares: the one about to be executed, with
exploration noise and uniform during warm-up, or the policy's deterministic one.
"""

Observation = Mapping[str, NDArray[Any]]

TeacherLike = str | PathLike[str] | Teacher | TeacherFunction


class Advice(NamedTuple):
    """The outcome of one step.

    :param actions: (n_envs, n_arms * action_size), the student's with the advised arms' blocks
        replaced.
    :param mask: (n_envs, n_arms), which arms were advised.
    """

    actions: NDArray[Any]
    mask: Mask


class Advisor:
    """Advise a student of n arms with single-arm teachers.

    Attributes: ``enabled``, False in the stages of a run that have no teacher; ``advisable``,
    (n_arms,) which arms may be advised; ``advised_per_arm``, (n_arms,) transitions in which each
    arm was advised; ``labels``, (n_envs, n_arms * action_size) the teachers' actions at the last
    step, NaN where the budget did not suffice, None unless the strategy labels states.

    :param strategy: decides when an arm is advised.
    :param teachers: one teacher for every arm, one per arm, or a group that advises all arms.
    :param mapping: where each arm's block lies.
    :param budget: how many environment steps may be advised.
    :param compare: the student action that correcting strategies compare.
    :param twin_minimum: whether Q_tr is the minimum of the teacher's critics, else the first.
    :param arms: indices of the arms that may be advised; every arm if None.
    :param run: settings of the run, for strategies that depend on them.
    :raises ValueError: if teacher, strategy and mapping do not match; the message names the sizes.
    """

    def __init__(
        self,
        strategy: AdvisingStrategy,
        teachers: Teacher | Sequence[Teacher] | TeacherGroup,
        mapping: ArmMapping,
        budget: AdviceBudget,
        *,
        compare: Compare = "noisy",
        twin_minimum: bool = True,
        arms: Sequence[int] | None = None,
        run: RunPlan | None = None,
    ) -> None:
        known = get_args(Compare)
        require("compare", compare, compare in known, f"one of {', '.join(known)}")
        self.strategy = strategy
        self.teachers = (
            teachers
            if isinstance(teachers, TeacherGroup)
            else TeacherGroup(teachers, mapping.n_arms)
        )
        if self.teachers.n_arms != mapping.n_arms:
            raise ValueError(
                f"{self.teachers.names[0]!r} advises {self.teachers.n_arms} arms, the student has "
                f"{mapping.n_arms}"
            )
        self.mapping = mapping
        self.budget = budget
        self.compare: Compare = compare
        self.twin_minimum = twin_minimum
        self.advisable = _arm_mask(arms, mapping.n_arms)
        self.enabled = True
        self.labels: FloatArray | None = None
        if strategy.needs_critics and not self.teachers.has_critics:
            raise ValueError(
                f"strategy {strategy.name!r} compares Q values, but teacher "
                f"{sorted({t.name for t in self.teachers.teachers if not t.has_critics})} has no "
                "critics: use 'early', 'mc-act' or 'mc-actabs', or a teacher saved with its critics"
            )
        if isinstance(strategy, PlansAhead):
            strategy.begin(run or RunPlan(), budget)
        self.advised_per_arm = np.zeros(mapping.n_arms, dtype=np.int64)
        self._transitions = 0
        self.start_window()

    @property
    def spent(self) -> int:
        """Environment steps advised so far."""
        return self.budget.spent

    @property
    def active(self) -> bool:
        """Whether any advice can still be given."""
        return self.enabled and self.budget.remaining > 0 and self.strategy.name != "none"

    @property
    def gives_labels(self) -> bool:
        """Whether the strategy labels states, besides or instead of choosing actions."""
        return bool(getattr(self.strategy, "labels", False))

    @property
    def needs_noise_free(self) -> bool:
        """Whether the next call of `advise` needs the student's deterministic actions."""
        return self.active and self.compare == "noise-free"

    def check_spaces(
        self, observation_space: spaces.Space[Any], action_space: spaces.Space[Any]
    ) -> None:
        """Check that this advisor fits a student, before training starts.

        :param observation_space: the student's.
        :param action_space: the student's.
        :raises ValueError: if sizes differ; the message names them.
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
            not normalised.
        :param student_actions: (n_envs, n_arms * action_size), in the environment's units; not
            modified.
        :param compared_actions: the same shape; the student's deterministic actions, with
            compare="noise-free".
        :param episode_steps: (n_envs,) steps since the start of each environment's episode, for
            strategies that read them.
        :param student_values: the student's own critics, for strategies that ask them.
        :return: actions and mask; the student's own array and an all-False mask where nothing is
            advised.
        """
        mask = np.zeros((len(student_actions), self.mapping.n_arms), dtype=bool)
        actions = student_actions
        self.labels = None
        if self.active:
            compared = student_actions if compared_actions is None else compared_actions
            by_arm = self.mapping.split_action(student_actions)
            observations, goals, achieved_goals = self.mapping.split(observation)
            context = AdviceContext(
                teachers=self.teachers,
                observations=observations,
                goals=goals,
                achieved_goals=achieved_goals,
                teacher_actions=self.teachers.act(observations, goals, achieved_goals),
                student_actions=self.mapping.split_action(compared),
                budget=self.budget,
                advisable=self.advisable,
                twin_minimum=self.twin_minimum,
                episode_steps=episode_steps,
                student_values=student_values,
                steps=self._transitions,
            )
            wanted = self._decide(context)
            granted = self.budget.spend(np.any(wanted, axis=1))
            mask = wanted & granted[:, np.newaxis]
            if self.gives_labels:
                asked = self.budget.spend(np.ones(len(mask), dtype=bool))
                given = self.mapping.join_actions(context.teacher_actions)
                self.labels = np.where(asked[:, np.newaxis], given, np.float32(np.nan))
            self._log("disagreement", context.disagreement)
            # Reading this cached property would compute it; do so only if the strategy has.
            if "q_gap" in vars(context):
                self._log("q_gap", context.q_gap)
            if mask.any():
                advised = np.where(mask[..., np.newaxis], context.teacher_actions, by_arm)
                actions = self.mapping.join_actions(advised).astype(
                    student_actions.dtype, copy=False
                )
        self._count(mask)
        return Advice(actions, mask)

    def _decide(self, context: AdviceContext) -> Mask:
        """Return the strategy's mask, restricted to the arms that may be advised.

        :raises ValueError: if it is not a mask of environments and arms: NumPy would broadcast it
            silently.
        """
        wanted = np.asarray(self.strategy.decide(context))
        if wanted.shape != context.shape or wanted.dtype != np.bool_:
            raise ValueError(
                f"strategy {self.strategy.name!r} decided {wanted.dtype} {wanted.shape}: it must "
                f"return truth values of shape (n_envs, n_arms) = {context.shape}"
            )
        return wanted & self.advisable

    def teacher_actions(self, observation: Observation) -> FloatArray:
        """Compute the teachers' actions, regardless of strategy and budget; nothing is counted.

        :param observation: as for `advise`.
        :return: (n_envs, n_arms, action_size), in the environment's units.
        """
        return self.teachers.act(*self.mapping.split(observation))

    def propose(
        self,
        scale: Callable[[NDArray[Any]], NDArray[Any]],
        observations: Mapping[str, th.Tensor],
    ) -> tuple[FloatArray, Mask] | None:
        """Return the teachers' actions in stored states, for the learner's target (IBRL).

        Proposals end with the budget, as advice does. They do not cost budget, since nothing is
        executed.

        :param scale: from the environment's units to [-1, 1], an SB3 policy's `scale_action`.
        :param observations: entries (batch, dim), not normalised.
        :return: scaled actions (batch, n_arms, action_size), and (n_arms,) which arms may take
            them; None once the budget is spent.
        """
        if not self.enabled or self.budget.remaining == 0:
            return None
        arrays = {key: value.cpu().numpy() for key, value in observations.items()}
        scaled = scale(self.mapping.join_actions(self.teacher_actions(arrays)))
        clipped = np.clip(scaled, -1.0, 1.0).astype(np.float32)
        return self.mapping.split_action(clipped), self.advisable

    def demonstrate(self, observation: Observation) -> Advice:
        """Let the teachers control every arm, for one step of the budget per environment.

        :param observation: as for `advise`.
        :return: the teachers' actions, and an all-True mask.
        :raises ValueError: if the budget does not suffice for all environments, or some arm must
            not be advised.
        """
        n_envs = len(observation["observation"])
        if self.budget.remaining < n_envs:
            raise ValueError(
                f"budget={self.budget.total}: {self.budget.remaining} steps remain, and a "
                f"demonstration in {n_envs} environments takes {n_envs}"
            )
        if not self.advisable.all():
            raise ValueError(
                f"arms={np.flatnonzero(self.advisable).tolist()}: a demonstration needs a teacher "
                f"for each of the {self.mapping.n_arms} arms; omit arms"
            )
        mask = np.ones((n_envs, self.mapping.n_arms), dtype=bool)
        self.budget.spend(np.ones(n_envs, dtype=bool))
        self._count(mask)
        return Advice(self.mapping.join_actions(self.teacher_actions(observation)), mask)

    def student_evaluated(self, success_rate: float) -> None:
        """Pass the result of an evaluation to a strategy that follows the student's progress.

        :param success_rate: of the student alone.
        """
        if isinstance(self.strategy, WatchesStudent):
            self.strategy.student_evaluated(success_rate)

    def _count(self, mask: Mask) -> None:
        self.advised_per_arm = self.advised_per_arm + mask.sum(axis=0)
        self._transitions += len(mask)
        self._log("share", np.any(mask, axis=1))
        for arm in range(self.mapping.n_arms):
            self._log(f"share_arm_{arm}", mask[:, arm])

    def _log(self, name: str, values: NDArray[Any]) -> None:
        """Add values to a mean of `log_values`."""
        total, count = self._window.get(name, (0.0, 0))
        self._window[name] = total + float(values.sum()), count + values.size

    def log_values(self) -> dict[str, float]:
        """Return values for SB3's logger: totals, and means over the time since `start_window`.

        :return: names such as `advice/share` (advised transitions / transitions),
            `advice/disagreement` (mean norm2(a_tr - a_st), in action units) and, if the strategy
            reads Q values, `advice/q_gap`.
        """
        means = {f"advice/{name}": total / n for name, (total, n) in self._window.items()}
        totals = {"advice/spent": self.budget.spent, "advice/remaining": self.budget.remaining}
        return {**totals, **means}

    def start_window(self) -> None:
        """Restart the means of `log_values`."""
        #: Sum and number of the values of each mean.
        self._window: dict[str, tuple[float, int]] = {}

    def state_dict(self) -> dict[str, Any]:
        """Return the JSON-able state: the advice so far, its strategy and its teachers."""
        return {
            "strategy": self.strategy.name,
            "settings": dict(self.strategy.settings),
            "teachers": self.teachers.names,
            "compare": self.compare,
            "twin_minimum": self.twin_minimum,
            "budget": self.budget.state_dict(),
            "advised_per_arm": self.advised_per_arm.tolist(),
            "transitions": self._transitions,
            "arms": np.flatnonzero(self.advisable).tolist(),
            "strategy_state": dict(self.strategy.state_dict())
            if isinstance(self.strategy, Remembers)
            else None,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the state of an earlier run.

        :param state: the result of `state_dict`, possibly from JSON or a saved model's
            `advice_state`.
        :raises ValueError: if strategy or number of arms differ, or more was spent than the budget
            holds.
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
        self.advised_per_arm = np.asarray(state["advised_per_arm"], dtype=np.int64)
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


def make_advisor(
    strategy: str | AdvisingStrategy,
    teacher: TeacherLike | Sequence[TeacherLike] | Expert,
    budget: int,
    *,
    episodes: Episodes | None = None,
    n_arms: int | None = None,
    observation_space: spaces.Space[Any] | None = None,
    action_space: spaces.Space[Any] | None = None,
    threshold: float | None = None,
    correcting: str | None = None,
    settings: Mapping[str, Any] | None = None,
    compare: Compare = "noisy",
    twin_minimum: bool = True,
    arms: Sequence[int] | None = None,
    total_steps: int | None = None,
    horizon: int | None = None,
    seed: int = 0,
) -> Advisor:
    """Build an advisor from names, for either a number of arms or a student's spaces.

    :param strategy: a strategy's name, "module:Class" of an unregistered one, or a strategy.
    :param teacher: a shipped policy's name; a weight file; the folder of a run; the zip file of an
        SB3 model; a teacher; a function of one arm's observation and goal, or its name
        "module:function" (see ``FunctionTeacher``); or a list of those, one per arm.
        ``scripted:ID`` is the scripted expert of an environment, for each arm by itself; an
        expert of ``saver_envs.experts.make_expert`` advises all arms, which give way, as does
        ``expert``, that of ``episodes``.
    :param budget: environment steps that may be advised.
    :param episodes: the student's, for the teacher ``expert``.
    :param n_arms: arms of the student; may be omitted if the spaces are given, except for a
        function, whose sizes follow from both.
    :param observation_space: the student's, checked immediately.
    :param action_space: the student's, checked immediately.
    :param threshold: t_I or alpha of a correcting strategy.
    :param correcting: the second half of `early-mc`.
    :param settings: further arguments of a strategy given by name.
    :param compare: "noisy" or "noise-free": the student action that a correcting strategy compares.
    :param twin_minimum: whether Q_tr is the minimum of the teacher's critics, else the first.
    :param arms: indices of the arms that may be advised; every arm if None.
    :param total_steps: environment steps of the run, over which `random` spreads its budget.
    :param horizon: steps of an episode, which `jump-start` divides.
    :param seed: of the run, for strategies that draw random numbers.
    :return: the advisor.
    :raises ValueError: if parts do not match; the message names the sizes.
    """
    spendable = AdviceBudget(budget)
    if isinstance(strategy, str):
        strategy = make_strategy(strategy, threshold, correcting=correcting, settings=settings)
    elif threshold is not None or correcting is not None or settings:
        raise ValueError(
            "threshold, correcting and settings belong to a strategy given by name: set them on "
            "the object instead"
        )
    teachers: Sequence[Teacher] | ExpertGroup
    shared = 0
    if teacher == EXPERT:
        if episodes is None:
            raise ValueError(
                f"teacher={EXPERT!r} is the scripted expert of the student's environment, which is "
                "not one of saver_envs: pass make_expert(ID)"
            )
        teacher = expert_of(episodes.task, episodes.settings)
    if isinstance(teacher, Expert):
        teachers = ExpertGroup(teacher)
        first, shared = teachers.teachers[0], teacher.task.observation_layout.shared
    else:
        of_function = partial(_of_function, n_arms, observation_space, action_space)
        teachers = _resolve(teacher, of_function)
        first = teachers[0]
    if n_arms is None:
        if observation_space is None or action_space is None:
            raise ValueError("give n_arms, or observation_space and action_space to read it from")
        size = flat_size("action", action_space)
        n_arms, rest = divmod(size, first.action_size)
        if rest or n_arms == 0:
            raise ValueError(
                f"teacher {first.name!r} has actions of size {first.action_size}, which do not "
                f"divide the student's action of size {size}: choose a teacher of the same task"
            )
    sizes = first.observation_size, first.goal_size, first.action_size
    mapping = ArmMapping(n_arms, *sizes, shared_observation=shared)
    advisor = Advisor(
        strategy,
        teachers,
        mapping,
        spendable,
        compare=compare,
        twin_minimum=twin_minimum,
        arms=arms,
        run=RunPlan(total_steps, horizon, seed),
    )
    if observation_space is not None and action_space is not None:
        advisor.check_spaces(observation_space, action_space)
    return advisor


def names_code(teacher: TeacherLike) -> bool:
    """Return whether a teacher is "module:function", the name of code to import."""
    word = str(teacher) if isinstance(teacher, (str, PathLike)) else ""
    return ":" in word and not word.startswith(PREFIX) and not os.path.exists(word)


def _resolve(
    teacher: TeacherLike | Sequence[TeacherLike], of_function: Callable[[Any], Teacher]
) -> list[Teacher]:
    """Load the teachers given by name or path; equal names share one teacher."""
    one = isinstance(teacher, (str, PathLike, Teacher)) or callable(teacher)
    given: list[Any] = [teacher] if one else list(teacher)  # type: ignore[arg-type]
    if not given:
        raise ValueError("teacher is an empty list: give one teacher for all arms, or one per arm")
    loaded: dict[Any, list[Teacher]] = {}
    for each in sorted(dict.fromkeys(given), key=names_code):
        if isinstance(each, Teacher):
            loaded[each] = [each]
        elif callable(each) or names_code(each):
            loaded[each] = [of_function(each)]
        elif str(each).startswith(PREFIX):
            loaded[each] = list(scripted_teachers(str(each)))
        else:
            loaded[each] = [load_teacher(each)]
    return [member for each in given for member in loaded[each]]


def _of_function(
    n_arms: int | None,
    observation_space: spaces.Space[Any] | None,
    action_space: spaces.Space[Any] | None,
    function: str | TeacherFunction,
) -> FunctionTeacher:
    """Return the teacher that a function is for one arm of a student."""
    if n_arms is None or not isinstance(observation_space, spaces.Dict):
        raise ValueError(
            f"teacher={function!r} is a function: give n_arms, observation_space and action_space, "
            "from which its sizes follow"
        )
    given = {**observation_space.spaces, "action": action_space}
    names = ("observation", "desired_goal", "action")
    observation, goal, action = (flat_size(name, given.get(name)) // n_arms for name in names)
    found = import_object("teacher", function) if isinstance(function, str) else function
    if not callable(found):
        raise TypeError(f"teacher={function!r} must be a function of observation and goal")
    return FunctionTeacher(found, (observation, goal, action), str(function))


def _arm_mask(arms: Sequence[int] | None, n_arms: int) -> Mask:
    """Turn indices of arms into a mask (n_arms,).

    :raises ValueError: for an index out of range, or none at all.
    """
    if arms is None:
        return np.ones(n_arms, dtype=bool)
    given = list(arms)
    whole = all(isinstance(arm, (int, np.integer)) and not isinstance(arm, bool) for arm in given)
    valid = bool(given) and whole and min(given) >= 0 and max(given) < n_arms
    wanted = f"one or more of {list(range(n_arms))}: which of the {n_arms} arms may be advised"
    require("arms", given, valid, wanted)
    return np.isin(np.arange(n_arms), given)
