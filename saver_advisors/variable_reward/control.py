"""Apply a training stage to a learner: its reward, its advice, and the actor's objective."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from saver_advisors.advising import Advisor
from saver_advisors.learner.algorithms import task_of
from saver_advisors.learner.replay import GoalReplayBuffer, RewardFunction
from saver_advisors.variable_reward.stages import StageClock, TrainingStage, check_stages
from saver_envs.validation import require


def reward_of(stage: TrainingStage, task: Any) -> RewardFunction:
    """Return the reward function of a stage.

    This function holds all that the package knows about tasks: the field ``reward_stage``.

    :param stage: the current stage.
    :param task: of the environment; it defines how goal and constraint combine.
    :return: a function of achieved and desired goals, (batch, goal_dim) each; it holds no
        environment.
    :raises ValueError: if the task's reward has no such stage.
    """
    name = "constrained" if stage.constrained else "goal"
    try:
        reward: RewardFunction = replace(task, reward_stage=name).reward
    except (TypeError, ValueError) as error:
        kind = "none of this package's" if task is None else task.name
        raise ValueError(
            f"stages need a task with a constraint, whose reward has the stage {name!r}; this "
            f"environment's is {kind}"
        ) from error
    return reward


class StageControl(StageClock):
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
        weight = constraint_value_weight
        require("constraint_value_weight", weight, weight >= 0, "0 or more")
        super().__init__(stages)
        self._model: Any = model
        self._weight = weight
        buffer = model.replay_buffer
        if not isinstance(buffer, GoalReplayBuffer):
            raise TypeError(
                f"replay_buffer_class={type(buffer).__name__} keeps rewards of an earlier stage: "
                "use saver_advisors.learner.GoalReplayBuffer or ConstraintReplayBuffer, which "
                "compute rewards when transitions are sampled"
            )
        if self.stage.advised and self._advisor is None:
            raise ValueError("stage 'teaching' needs a teacher: pass the model an advisor")
        assert model.env is not None
        self._task = task_of(model.env)
        self._apply()

    @property
    def _advisor(self) -> Advisor | None:
        advisor = getattr(self._model, "advisor", None)
        return advisor if isinstance(advisor, Advisor) else None

    def advance(self, success_rate: float | None = None) -> bool:
        """Switch to the next stage if the current one is over.

        :param success_rate: of a new evaluation, else None.
        :return: whether the stage changed.
        """
        left = 0 if self._advisor is None else self._advisor.budget.remaining
        switched = self.update(
            self._model.num_timesteps, advice_left=left, success_rate=success_rate
        )
        if switched:
            self._apply()
        return switched

    def _apply(self) -> None:
        """Apply the current stage."""
        model = self._model
        n_parts = len(model.replay_buffer.part_columns)
        # Separate parts have separate values, and the constraint's is learned in every stage.
        rewarded = self.stage if n_parts == 1 else TrainingStage("exploring")
        model.replay_buffer.reward_function = reward_of(rewarded, self._task)
        if n_parts > 1:
            own = self._weight if self.stage.constrained else 0.0
            model.value_weights = (1.0,) * (n_parts - 1) + (own,)
        if self._advisor is not None:
            self._advisor.enabled = self.stage.advised

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore and apply the stage of an earlier run.

        :param state: the result of ``state_dict``.
        :raises ValueError: if the state belongs to other stages.
        """
        super().load_state_dict(state)
        self._apply()


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
            self.control.load_state_dict({**state, "switched_at": began})
        self.model.stage_state = self.control.state_dict()  # type: ignore[attr-defined]

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        assert self.control is not None
        model: Any = self.model
        successes = model.ep_success_buffer
        full = successes is not None and len(successes) == successes.maxlen
        switched = self.control.advance(float(np.mean(successes)) if full else None)
        model.stage_state = self.control.state_dict()
        if switched and self.verbose:
            print(f"{model.num_timesteps} steps: stage {self.control.stage.name}")
        self.logger.record("stages/stage", self.control.stages.index(self.control.stage))
