"""Putting a stage in force on a learner: its reward, its advice, and what the actor maximises."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from saver_advisors.advising import Advisor
from saver_advisors.learner.replay import GoalReplayBuffer
from saver_advisors.variable_reward.rewards import constrained_task, reward_of
from saver_advisors.variable_reward.stages import Stage, StageClock
from saver_envs.tasks.distance import Distance


class StageControl:
    """The stages of one learner's run.

    Where the learner has a value for each part of the goal, the constraint's is learned all along,
    from rewards that no stage changes; the actor minds it in exploring alone.

    :param model: an off-policy algorithm with a ``GoalReplayBuffer``
    :param stages: in their order
    :param constraint_value_weight: of the constraint's own value beside each arm's, where the
        learner has one
    :raises ValueError: for an order that cannot be, an environment without a constraint, teaching
        without an advisor, or a negative weight
    :raises TypeError: for a replay buffer that keeps the rewards of an earlier stage
    """

    def __init__(
        self,
        model: OffPolicyAlgorithm,
        stages: Sequence[Stage],
        *,
        constraint_value_weight: float = 1.0,
    ) -> None:
        if not constraint_value_weight >= 0:
            raise ValueError(f"constraint_value_weight={constraint_value_weight} must be 0 or more")
        self.clock = StageClock(stages)
        self._weight = constraint_value_weight
        self._task = self._checked(model)
        self.apply(model)

    def _checked(self, model: OffPolicyAlgorithm) -> Distance:
        """The constrained task, of a model that stages can work on."""
        buffer = model.replay_buffer
        if not isinstance(buffer, GoalReplayBuffer):
            raise TypeError(
                f"replay_buffer_class={type(buffer).__name__} keeps rewards of an earlier stage: "
                "use saver_advisors.learner.GoalReplayBuffer or ConstraintReplayBuffer, which "
                "compute every reward when it is drawn"
            )
        if self.clock.stages[0].advised and not isinstance(_advisor(model), Advisor):
            raise ValueError("stage 'teaching' needs a teacher: give the model an advisor")
        assert model.env is not None
        return constrained_task(model.env)

    @property
    def stage(self) -> Stage:
        """The stage in force."""
        return self.clock.stage

    def update(self, model: OffPolicyAlgorithm, *, success_rate: float | None = None) -> bool:
        """Go on to the next stage where the one in force is over.

        :param model: the learner
        :param success_rate: of an evaluation that is new, else None
        :return: whether another stage is in force now
        """
        advisor = _advisor(model)
        left = advisor.budget.remaining if isinstance(advisor, Advisor) else 0
        switched = self.clock.update(
            model.num_timesteps, advice_left=left, success_rate=success_rate
        )
        if switched:
            self.apply(model)
        return switched

    def apply(self, model: OffPolicyAlgorithm) -> None:
        """Put the stage in force.

        :param model: the learner
        """
        buffer = model.replay_buffer
        assert isinstance(buffer, GoalReplayBuffer)
        apart = len(buffer.part_columns) > 1
        always_constrained = Stage("exploring")
        buffer.reward_function = reward_of(always_constrained if apart else self.stage, self._task)
        if apart:
            own = self._weight if self.stage.constrained else 0.0
            weights = (1.0,) * (len(buffer.part_columns) - 1) + (own,)
            model.value_weights = weights  # type: ignore[attr-defined]  # of GoalTD3
        advisor = _advisor(model)
        if isinstance(advisor, Advisor):
            advisor.enabled = self.stage.advised

    def state_dict(self) -> dict[str, Any]:
        """:return: JSON-able state"""
        return self.clock.state_dict()

    def load_state_dict(self, state: Mapping[str, Any], model: OffPolicyAlgorithm) -> None:
        """Go on where a run stopped, with its stage in force.

        :param state: what ``state_dict`` returned
        :param model: the learner
        :raises ValueError: where it is of other stages
        """
        self.clock.load_state_dict(state)
        self.apply(model)


def _advisor(model: OffPolicyAlgorithm) -> Any:
    return getattr(model, "advisor", None)
