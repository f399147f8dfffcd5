"""The built-in strategies, and the registry that finds a strategy by its name.

`none`, `early`, `mc-q`, `mc-act`, `mc-actabs` and `early-mc` are the dissertation's; `random`,
`jump-start`, `ibrl` and `dagger` are comparisons. `register_strategy` adds your own.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Final, TypeAlias, TypeVar

import numpy as np

from saver_advisors.advising.context import (
    AdviceBudget,
    AdviceContext,
    AdvisingStrategy,
    Mask,
    RunPlan,
)
from saver_advisors.learner.imitation import better_by_arm
from saver_envs.validation import NonNegativeInt, PositiveInt, check_fields, import_named

DEFAULT_THRESHOLD: Final = 0.1
"""Default of t_I and alpha: the largest of the paper's 0.01, 0.05, 0.1, which advises least."""


Rate: TypeAlias = Annotated[float, "in (0, 1]", lambda value: 0 < value <= 1]
Threshold: TypeAlias = Annotated[
    float, "at least 0 (the paper uses 0.01, 0.05 and 0.1)", lambda value: value >= 0
]


class _BuiltIn:
    """A strategy that is a dataclass, whose settings are the fields of its constructor."""

    needs_critics: ClassVar[bool] = False
    labels: ClassVar[bool] = False

    @property
    def settings(self) -> Mapping[str, Any]:
        own: Any = self
        return {one.name: getattr(self, one.name) for one in fields(own) if one.init}


@dataclass(frozen=True)
class NoAdvice(_BuiltIn):
    """NA: the teacher gives no advice."""

    name: ClassVar[str] = "none"

    def decide(self, context: AdviceContext) -> Mask:
        return np.zeros(context.shape, dtype=bool)


@dataclass(frozen=True)
class EarlyAdvising(_BuiltIn):
    """EA: advise every step until the budget is spent."""

    name: ClassVar[str] = "early"

    def decide(self, context: AdviceContext) -> Mask:
        return np.ones(context.shape, dtype=bool)


@dataclass(frozen=True)
class _Correcting(_BuiltIn):
    """Base of the mistake-correcting strategies.

    :param threshold: t_I or alpha; finite and not negative.
    :raises ValueError: if it is negative or infinite.
    :raises TypeError: if it is not a number.
    """

    threshold: Threshold = DEFAULT_THRESHOLD

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class MistakeCorrectingQ(_Correcting):
    """MC-Q: advise where the teacher's critic rates its own action higher by more than t_I
    (eq. 5.10).
    """

    name: ClassVar[str] = "mc-q"
    needs_critics: ClassVar[bool] = True

    def decide(self, context: AdviceContext) -> Mask:
        return context.q_gap > self.threshold


@dataclass(frozen=True)
class MistakeCorrectingAction(_Correcting):
    """MC-ACT: advise where the distance of the two actions exceeds t_a = alpha (eq. 5.11)."""

    name: ClassVar[str] = "mc-act"

    def decide(self, context: AdviceContext) -> Mask:
        return context.disagreement > self.threshold


@dataclass(frozen=True)
class MistakeCorrectingRelativeAction(_Correcting):
    """MC-ACTABS: as MC-ACT with t_a = alpha * norm2(a_i_tr).

    This follows the equation (5.11); the sentence above it in the dissertation swaps the two names.
    """

    name: ClassVar[str] = "mc-actabs"

    def decide(self, context: AdviceContext) -> Mask:
        size = np.linalg.norm(context.teacher_actions, axis=-1)
        return context.disagreement > self.threshold * size


@dataclass(frozen=True)
class EarlyThenCorrecting(_BuiltIn):
    """EAMC: early advising for the first half of the budget, then a correcting strategy.

    The switch is exact inside a vector environment: if 3 steps of the first half remain, the first
    3 environments are advised early and the others are corrected.

    :param correcting: the strategy of the second half.
    """

    correcting: AdvisingStrategy = MistakeCorrectingQ()
    name: ClassVar[str] = "early-mc"

    @property
    def needs_critics(self) -> bool:  # type: ignore[override]  # the second half's
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


@dataclass(eq=False)
class RandomAdvising(_BuiltIn):
    """Advise all arms of an environment at random steps: the baseline for every other rule.

    By default the budget is spread over the whole run: with b advised steps and n steps left, a
    step is advised with probability b / n. This is sampling without replacement, so all sets of
    steps are equally likely and the budget lasts exactly until the end of the run.

    :param probability: of advising a step, until the budget is spent, in (0, 1]; None to spread it.
    :param seed: of the strategy's own generator; the run's if None.
    :raises ValueError: if the probability is outside (0, 1], or the seed negative.
    """

    name: ClassVar[str] = "random"
    probability: Rate | None = None
    seed: NonNegativeInt | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        self._random = np.random.default_rng(self.seed)

    def begin(self, run: RunPlan, budget: AdviceBudget) -> None:
        """Take the run's length and seed.

        :param run: its `total_steps` is required unless there is a `probability`.
        :param budget: unused; each step reads the remaining budget.
        :raises ValueError: if neither is known.
        """
        if self.probability is None and run.total_steps is None:
            raise ValueError(
                "strategy 'random' spreads its budget over the run: give total_steps, or "
                "settings={'probability': 0.1}"
            )
        # Not read with a probability.
        self._total_steps = run.total_steps or 0
        # A separate stream, independent of the others that the run's seed starts.
        seed = np.random.SeedSequence([run.seed, 0xAD]) if self.seed is None else self.seed
        self._random = np.random.default_rng(seed)

    def decide(self, context: AdviceContext) -> Mask:
        n_envs, n_arms = context.shape
        drawn = self._random.random(n_envs)
        if self.probability is not None:
            chosen = drawn < self.probability
        else:
            chosen = self._spread(drawn, context)
        return np.repeat(chosen[:, np.newaxis], n_arms, axis=1)

    def _spread(self, drawn: Any, context: AdviceContext) -> Mask:
        """Decide for one environment after the other, since each choice changes the rest."""
        to_give, to_do = context.budget.remaining, self._total_steps - context.steps
        chosen = np.zeros(len(drawn), dtype=bool)
        for index, number in enumerate(drawn):
            # The last block may exceed the run's total, and then spends the rest of the budget.
            chosen[index] = number * max(to_do, 1) < to_give
            to_give -= int(chosen[index])
            to_do -= 1
        return chosen

    def state_dict(self) -> Mapping[str, Any]:
        """Return the JSON-able state of the generator."""
        return {"random": self._random.bit_generator.state}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`."""
        self._random.bit_generator.state = state["random"]


@dataclass(eq=False)
class JumpStart(_BuiltIn):
    """Jump-start RL: the teacher begins each episode, the student ends it (Uchendu et al.,
    arXiv 2204.02372).

    All arms are advised in the first h steps of each episode; h falls in stages. Stage k of n has
    h = horizon * (1 - k / n), rounded up, so the first stage is early advising. By default each
    stage takes an n-th of the budget. With `success` the student's progress decides: stage k begins
    once an evaluation of the student alone has reached k / n of `success`, and stages do not go
    back. In both cases advice ends with the budget.

    The original compares the joint success of teacher and student with its best so far. Here
    training acts with exploration noise, which hides that success, so the evaluated student counts.

    :param stages: n, at least 1.
    :param success: success rate of the student alone, in (0, 1], at which advice ends; None for the
        schedule over the budget.
    :param horizon: steps of an episode; the run's if None.
    :raises ValueError: if a value is out of range.
    """

    name: ClassVar[str] = "jump-start"
    stages: PositiveInt = 10
    success: Rate | None = None
    horizon: PositiveInt | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        self._horizon: int | None = self.horizon
        self._reached = 0

    def begin(self, run: RunPlan, budget: AdviceBudget) -> None:
        """Take the length of an episode.

        :param run: its `horizon` is required unless the strategy has one.
        :param budget: unused; each step reads the remaining budget.
        :raises ValueError: if neither is known.
        """
        self._horizon = run.horizon if self.horizon is None else self.horizon
        if self._horizon is None:
            raise ValueError(
                "strategy 'jump-start' shortens the teacher's part of an episode: give horizon, "
                "the steps of one"
            )

    def teacher_steps(self, budget: AdviceBudget) -> int:
        """Compute the length of the teacher's part of an episode.

        :param budget: of the run.
        :return: h, in steps.
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
        """Enter the stage that belongs to a success rate of the student alone."""
        if self.success is not None:
            # Rounded: 0.3 / 0.9 * 3 is slightly below 1 in floating point.
            stage = math.floor(round(self.stages * success_rate / self.success, 9))
            self._reached = max(self._reached, min(self.stages, stage))

    def state_dict(self) -> Mapping[str, Any]:
        """Return the JSON-able stage."""
        return {"reached": self._reached}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`."""
        self._reached = int(state["reached"])


@dataclass(frozen=True)
class BetterOfBoth(_BuiltIn):
    """IBRL: an arm receives the teacher's action if the student's own critics prefer it (Hu et
    al., Imitation Bootstrapped Reinforcement Learning, arXiv 2311.02198).

    A joint critic rates every combination of teacher's and student's actions, 2^n for n arms. With
    per-arm critics each arm queries its own, while the other arms keep the student's actions. Ties
    go to the student. The learner's target makes the same choice with `Advisor.propose`.
    """

    name: ClassVar[str] = "ibrl"

    def decide(self, context: AdviceContext) -> Mask:
        if context.student_values is None:
            raise ValueError(
                "strategy 'ibrl' reads the student's critics: advise through AdvisedMixin or "
                "AdvisingCallback, or pass student_values to Advisor.advise"
            )
        return better_by_arm(
            context.student_actions,
            context.teacher_actions,
            context.student_values,
            context.advisable,
        )


@dataclass(frozen=True)
class Labelling(_BuiltIn):
    """DAgger: the student acts, and the teacher says in every state what it would do (Ross et al.,
    arXiv 1011.0686). Each answer costs one step of the budget.
    """

    name: ClassVar[str] = "dagger"
    labels: ClassVar[bool] = True

    def decide(self, context: AdviceContext) -> Mask:
        return np.zeros(context.shape, dtype=bool)


_CORRECTING: Final = (MistakeCorrectingQ, MistakeCorrectingAction, MistakeCorrectingRelativeAction)
_BUILT_IN: Final[tuple[type[AdvisingStrategy], ...]] = (
    NoAdvice,
    EarlyAdvising,
    *_CORRECTING,
    EarlyThenCorrecting,
    RandomAdvising,
    JumpStart,
    BetterOfBoth,
    Labelling,
)

STRATEGIES: Final[dict[str, type[AdvisingStrategy]]] = {one.name: one for one in _BUILT_IN}
"""Every strategy by the name that configurations use."""

Strategy = TypeVar("Strategy", bound=type[AdvisingStrategy])

_MEMBERS: Final = ("name", "needs_critics", "settings", "decide")


def register_strategy(strategy: Strategy) -> Strategy:
    """Register a strategy under its name; a decorator.

    :param strategy: a class with the members of `AdvisingStrategy`.
    :return: the same class.
    :raises TypeError: if a member is missing.
    :raises ValueError: if another strategy has that name.
    """
    _require_strategy(strategy)
    known = STRATEGIES.setdefault(strategy.name, strategy)
    if known is not strategy:
        raise ValueError(
            f"name={strategy.name!r} of {strategy.__name__} belongs to {known.__name__} already: "
            "choose another"
        )
    return strategy


def make_strategy(
    name: str,
    threshold: float | None = None,
    *,
    correcting: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> AdvisingStrategy:
    """Create a strategy by name.

    :param name: a key of `STRATEGIES`, or "module:Class" for an unregistered one.
    :param threshold: t_I (mc-q) or alpha (mc-act, mc-actabs), or that of early-mc's second half;
        0.1 by default.
    :param correcting: early-mc's second half: mc-q (default), mc-act or mc-actabs.
    :param settings: further arguments of the strategy's class, by name.
    :raises ValueError: if the name is unknown, the threshold is out of range, or the strategy does
        not accept an argument.
    :raises TypeError: if "module:Class" is not a strategy.
    """
    if name not in STRATEGIES and ":" not in name:
        raise ValueError(
            f"strategy={name!r} is unknown: use one of {', '.join(STRATEGIES)}, or 'module:Class' "
            "for one of your own"
        )
    strategy = STRATEGIES.get(name) or import_object("strategy", name)
    _require_strategy(strategy)
    parameters = inspect.signature(strategy).parameters
    arguments = dict(settings or {})
    if correcting is not None and name != "early-mc":
        raise ValueError(f"correcting={correcting!r} belongs to 'early-mc' only, not to {name!r}")
    if name == "early-mc":
        known = {one.name: one for one in _CORRECTING}
        second = known.get("mc-q" if correcting is None else correcting)
        if second is None:
            raise ValueError(f"correcting={correcting!r} is unknown: use one of {', '.join(known)}")
        arguments["correcting"] = second(DEFAULT_THRESHOLD if threshold is None else threshold)
    elif threshold is not None:
        arguments["threshold"] = threshold
    unknown = [f"{one}={arguments[one]!r}" for one in sorted(set(arguments) - set(parameters))]
    any_name = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters.values())
    if unknown and not any_name:
        raise ValueError(
            f"strategy {name!r} takes no {', '.join(unknown)}; its settings are "
            f"{', '.join(parameters) or 'none'}"
        )
    made: AdvisingStrategy = strategy(**arguments)
    _require_members(made, _MEMBERS)
    return made


def import_object(what: str, name: str) -> Any:
    """Import an object.

    :param what: it is, for the message.
    :param name: "module:attribute".
    :raises ValueError: if there is none; the message names it.
    """
    module, _, attribute = name.partition(":")
    found = import_named(f"{what}={name!r}", module)
    try:
        return getattr(found, attribute)
    except AttributeError as error:
        raise ValueError(f"{what}={name!r} cannot be imported: {error}") from error


def _require_strategy(found: Any) -> None:
    if not isinstance(found, type):
        raise TypeError(f"{found!r} must be a class with the members {', '.join(_MEMBERS)}")
    # The constructor may set the other members.
    _require_members(found, ("name", "decide"))


def _require_members(found: Any, members: tuple[str, ...]) -> None:
    missing = [member for member in members if not hasattr(found, member)]
    if missing:
        raise TypeError(
            f"{found!r} lacks {', '.join(missing)}: a strategy has {', '.join(_MEMBERS)} "
            "(see AdvisingStrategy)"
        )
