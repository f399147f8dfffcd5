"""Apply a training stage to a learner: its reward, its advice, and the actor's objective."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from saver_advisors.advising import Advisor
from saver_advisors.learner.replay import GoalReplayBuffer
from saver_advisors.variable_reward.rewards import reward_of, task_of
from saver_advisors.variable_reward.stages import StageClock, TrainingStage, check_stages


class StageControl:
    """Apply the stages of one learner's run.

    If the learner has one value per part of the goal, the constraint's value is learned throughout,
    from rewards that do not depend on the stage; the actor's objective includes it in exploring
    only.

    :param model: an off-policy algorithm with a ``GoalReplayBuffer``.
    :param stages: in their order.
    :param constraint_value_weight: of the constraint's own value relative to each arm's, if the
        learner has one.
    :raises ValueError: if the order is wrong, the environment has no constraint, teaching has no
        advisor, or the weight is negative.
    :raises TypeError: if the replay buffer stores rewards.
    """

    def __init__(
        self,
        model: OffPolicyAlgorithm,
        stages: Sequence[TrainingStage],
        *,
        constraint_value_weight: float = 1.0,
    ) -> None:
        if not constraint_value_weight >= 0:
            raise ValueError(f"constraint_value_weight={constraint_value_weight} must be 0 or more")
        self.clock = StageClock(stages)
        self._weight = constraint_value_weight
        buffer = model.replay_buffer
        if not isinstance(buffer, GoalReplayBuffer):
            raise TypeError(
                f"replay_buffer_class={type(buffer).__name__} keeps rewards of an earlier stage: "
                "use saver_advisors.learner.GoalReplayBuffer or ConstraintReplayBuffer, which "
                "compute rewards when transitions are sampled"
            )
        if self.stage.advised and _advisor(model) is None:
            raise ValueError("stage 'teaching' needs a teacher: pass the model an advisor")
        assert model.env is not None
        self._task = task_of(model.env)
        self.apply(model)

    @property
    def stage(self) -> TrainingStage:
        """The current stage."""
        return self.clock.stage

    def update(self, model: OffPolicyAlgorithm, *, success_rate: float | None = None) -> bool:
        """Switch to the next stage if the current one is over.

        :param model: the learner.
        :param success_rate: of a new evaluation, else None.
        :return: whether the stage changed.
        """
        advisor = _advisor(model)
        left = 0 if advisor is None else advisor.budget.remaining
        switched = self.clock.update(
            model.num_timesteps, advice_left=left, success_rate=success_rate
        )
        if switched:
            self.apply(model)
        return switched

    def apply(self, model: OffPolicyAlgorithm) -> None:
        """Apply the current stage.

        :param model: the learner.
        """
        buffer = model.replay_buffer
        assert isinstance(buffer, GoalReplayBuffer)
        n_parts = len(buffer.part_columns)
        # Separate parts have separate values, and the constraint's is learned in every stage.
        rewarded = self.stage if n_parts == 1 else TrainingStage("exploring")
        buffer.reward_function = reward_of(rewarded, self._task)
        if n_parts > 1:
            own = self._weight if self.stage.constrained else 0.0
            weights = (1.0,) * (n_parts - 1) + (own,)
            model.value_weights = weights  # type: ignore[attr-defined]  # of GoalTD3
        advisor = _advisor(model)
        if advisor is not None:
            advisor.enabled = self.stage.advised

    def state_dict(self) -> dict[str, Any]:
        """Return the JSON-able state."""
        return self.clock.state_dict()

    def load_state_dict(self, state: Mapping[str, Any], model: OffPolicyAlgorithm) -> None:
        """Restore and apply the stage of an earlier run.

        :param state: the result of ``state_dict``.
        :param model: the learner.
        :raises ValueError: if the state belongs to other stages.
        """
        self.clock.load_state_dict(state)
        self.apply(model)


def _advisor(model: OffPolicyAlgorithm) -> Advisor | None:
    advisor = getattr(model, "advisor", None)
    return advisor if isinstance(advisor, Advisor) else None


class StagesCallback(BaseCallback):
    """Run a model through its stages while ``learn`` runs.

    RL Zoo builds it from its settings files, where stages are names and rules::

        callback:
          - saver_advisors.variable_reward.StagesCallback:
              stages: [{stage: teaching, until: budget}, {stage: exploring}]

    The stage may change at the end of each rollout. ``success S`` refers to SB3's success buffer,
    the latest 100 training episodes, once it is full. The model's zip stores ``stage_state``, so
    another ``learn``, also after ``load``, continues in the same stage. If the model's step count
    restarts at 0, as in RL Zoo, the stage's does too.

    :param stages: in their order, or the arguments of :meth:`TrainingStage.parse` for each.
    :param constraint_value_weight: as for ``StageControl``.
    :param verbose: 1 to print each switch.
    :raises ValueError: see :func:`check_stages`.
    """

    def __init__(
        self,
        stages: Sequence[TrainingStage | Mapping[str, Any]],
        *,
        constraint_value_weight: float = 1.0,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.stages = tuple(
            one if isinstance(one, TrainingStage) else TrainingStage.parse(**one) for one in stages
        )
        check_stages(self.stages)
        self.constraint_value_weight = constraint_value_weight
        self.control: StageControl | None = None

    def _on_training_start(self) -> None:
        model: Any = self.model
        if not isinstance(model, OffPolicyAlgorithm):
            raise TypeError(
                f"{type(model).__name__} has no replay buffer: stages need an off-policy algorithm"
            )
        self.control = StageControl(
            model, self.stages, constraint_value_weight=self.constraint_value_weight
        )
        state = getattr(model, "stage_state", None)
        if state is not None:
            began = [min(steps, model.num_timesteps) for steps in state["switched_at"]]
            self.control.load_state_dict({**state, "switched_at": began}, model)
        self._keep_state()

    def _keep_state(self) -> None:
        """Write the state to the model, whose zip stores it."""
        assert self.control is not None
        self.model.stage_state = self.control.state_dict()  # type: ignore[attr-defined]

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        assert self.control is not None
        model: Any = self.model
        successes = model.ep_success_buffer
        full = successes is not None and len(successes) == successes.maxlen
        if self.control.update(model, success_rate=float(np.mean(successes)) if full else None):
            self._keep_state()
            if self.verbose:
                print(f"{model.num_timesteps} steps: stage {self.control.stage.name}")
        clock = self.control.clock
        self.logger.record("stages/stage", clock.stages.index(clock.stage))
