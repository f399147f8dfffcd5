"""Training stages: teaching, stretching and exploring, and the rules that switch between them.

In teaching and stretching the reward is that of the goal alone, f_g; in exploring it is the
constrained one, in the dissertation min(f_c, f_g). A teacher advises in teaching only
(dissertation, chapter 6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Literal, get_args

from saver_envs.validation import require

StageName = Literal["teaching", "stretching", "exploring"]
STAGES: Final[tuple[str, ...]] = get_args(StageName)

RuleKind = Literal["budget", "steps", "success"]


@dataclass(frozen=True)
class SwitchRule:
    """When a stage ends.

    :param kind: ``budget``: when the advice budget is spent; ``steps``: after a number of
        environment steps of the stage; ``success``: when an evaluation reaches a success rate.
    :param value: the steps or the rate, None for ``budget``.
    """

    kind: RuleKind
    value: float | None = None

    @classmethod
    def parse(cls, text: str) -> SwitchRule:
        """Parse ``budget``, ``steps 250000`` or ``success 0.5``.

        :param text: of a configuration.
        :return: the rule.
        :raises ValueError: for any other text.
        """
        words = text.split()
        if words == ["budget"]:
            return cls("budget")
        with suppress(ValueError):
            kind, number = words
            value = float(number)
            if kind == "steps" and value > 0 and value.is_integer():
                return cls("steps", value)
            if kind == "success" and 0 < value <= 1:
                return cls("success", value)
        wanted = "'budget', 'steps N' with N above 0, or 'success S' with S above 0 and at most 1"
        raise ValueError(f"until={text!r}: must be {wanted}")

    def is_met(self, stage_steps: int, advice_left: int, success_rate: float | None) -> bool:
        """Return whether the stage is over.

        :param stage_steps: environment steps since it began.
        :param advice_left: environment steps that may still be advised.
        :param success_rate: of a new evaluation, else None.
        """
        if self.kind == "budget":
            return advice_left <= 0
        assert self.value is not None
        if self.kind == "steps":
            return stage_steps >= self.value
        return success_rate is not None and success_rate >= self.value


@dataclass(frozen=True)
class TrainingStage:
    """One stage of a training run.

    :param name: ``teaching``, ``stretching`` or ``exploring``.
    :param until: when it ends; None for the last.
    :raises ValueError: for an unknown name, or a stage other than teaching that ends with the
        advice budget.
    """

    name: StageName
    until: SwitchRule | None = None

    def __post_init__(self) -> None:
        require("stage", self.name, self.name in STAGES, f"one of {', '.join(STAGES)}")
        if self.until is not None and self.until.kind == "budget" and not self.advised:
            raise ValueError(
                f"stage {self.name!r} cannot end with the advice budget, which is spent only in "
                "teaching"
            )

    @classmethod
    def parse(cls, stage: str, until: str | None = None) -> TrainingStage:
        """Parse a stage of a configuration, e.g. ``stretching`` until ``steps 250000``.

        :param stage: its name.
        :param until: as for :meth:`SwitchRule.parse`; None for the last.
        :return: the stage.
        :raises ValueError: for an unknown name or rule.
        """
        # The constructor checks the name.
        return cls(stage, None if until is None else SwitchRule.parse(until))  # type: ignore[arg-type]

    @property
    def advised(self) -> bool:
        """Whether a teacher advises."""
        return self.name == "teaching"

    @property
    def constrained(self) -> bool:
        """Whether the reward is the constrained one."""
        return self.name == "exploring"


def check_stages(stages: Sequence[TrainingStage]) -> None:
    """Check the order of stages and their ends.

    :param stages: in their order; stages may be omitted, as in ablations.
    :raises ValueError: if there is no stage, the order is wrong, a stage occurs twice, a stage
        other than the last has no end, or the last has one.
    """
    names = [stage.name for stage in stages]
    require("stages", names, bool(names), f"one or more of {', '.join(STAGES)}")
    places = [STAGES.index(name) for name in names]
    if any(first >= second for first, second in pairwise(places)):
        raise ValueError(f"stages={names}: their order is {', '.join(STAGES)}, each at most once")
    for stage in stages[:-1]:
        if stage.until is None:
            raise ValueError(
                f"stage {stage.name!r} is followed by another: set when it ends (until)"
            )
    if stages[-1].until is not None:
        raise ValueError(f"stage {stages[-1].name!r} is the last: it runs until training ends")


class StageClock:
    """Track which stage a run is in.

    :param stages: in their order.
    :raises ValueError: see :func:`check_stages`.
    """

    def __init__(self, stages: Sequence[TrainingStage]) -> None:
        check_stages(stages)
        self.stages = tuple(stages)
        self._index = 0
        self._switched_at: list[int] = []

    @property
    def stage(self) -> TrainingStage:
        """The current stage."""
        return self.stages[self._index]

    def update(
        self, steps: int, *, advice_left: int = 0, success_rate: float | None = None
    ) -> bool:
        """Switch to the next stage if the current one is over; by one stage at most.

        :param steps: environment steps of the run.
        :param advice_left: environment steps that may still be advised.
        :param success_rate: of a new evaluation, else None.
        :return: whether the stage changed.
        """
        began = self._switched_at[-1] if self._switched_at else 0
        until = self.stage.until
        if until is None or not until.is_met(steps - began, advice_left, success_rate):
            return False
        self._index += 1
        self._switched_at.append(steps)
        return True

    def state_dict(self) -> dict[str, Any]:
        """Return the JSON-able state."""
        return {
            "stages": [stage.name for stage in self.stages],
            "stage": self.stage.name,
            "switched_at": list(self._switched_at),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the stage of an earlier run.

        :param state: the result of ``state_dict``.
        :raises ValueError: if the state belongs to other stages.
        """
        names = [stage.name for stage in self.stages]
        switched = [int(steps) for steps in state["switched_at"]]
        if list(state["stages"]) != names or len(switched) >= len(names):
            raise ValueError(f"the state is of stages {state['stages']}, this run has {names}")
        self._index = len(switched)
        self._switched_at = switched
