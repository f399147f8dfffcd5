"""When an arm gets the teacher's action: the dissertation's strategies, one small class each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from saver_advisors.advising.context import AdviceContext, AdvisingStrategy, Mask

DEFAULT_THRESHOLD: Final = 0.1
"""t_I and alpha where none is given: the largest, that is the most sparing, of the paper's 0.01,
0.05, 0.1.
"""


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
