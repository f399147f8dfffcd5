"""Stages as a callback, for any off-policy algorithm of SB3 with our replay buffer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from saver_advisors.variable_reward.control import StageControl
from saver_advisors.variable_reward.stages import Stage, check_stages


class StagesCallback(BaseCallback):
    """Runs a model through its stages while ``learn`` does.

    RL Zoo builds it from its settings files, where stages are names and rules::

        callback:
          - saver_advisors.variable_reward.StagesCallback:
              stages: [{stage: teaching, until: budget}, {stage: exploring}]

    The stage may change at the end of each rollout. ``success S`` is judged by SB3's own success
    buffer, the training episodes that ended last (100 of them), once it is full. The model keeps
    ``stage_state``, which its zip holds: ``learn`` again, after ``load`` too, goes on in the same
    stage. Where the model counts its steps from 0 again, as RL Zoo has it, so does that stage.

    :param stages: in their order, or the arguments of :meth:`Stage.parse` for each
    :param constraint_value_weight: as for ``StageControl``
    :param verbose: 1 to print each switch
    :raises ValueError: for stages that cannot be, see :func:`check_stages`
    """

    def __init__(
        self,
        stages: Sequence[Stage | Mapping[str, Any]],
        *,
        constraint_value_weight: float = 1.0,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        self.stages = tuple(one if isinstance(one, Stage) else Stage.parse(**one) for one in stages)
        check_stages(self.stages)
        self.constraint_value_weight = constraint_value_weight
        self.control: StageControl | None = None

    def _on_training_start(self) -> None:
        if not isinstance(self.model, OffPolicyAlgorithm):
            raise TypeError(
                f"{type(self.model).__name__} has no replay buffer: stages need an off-policy "
                "algorithm"
            )
        model: Any = self.model
        self.control = StageControl(
            model, self.stages, constraint_value_weight=self.constraint_value_weight
        )
        state = getattr(model, "stage_state", None)
        if state is not None:
            began = [min(steps, model.num_timesteps) for steps in state["switched_at"]]
            self.control.load_state_dict({**state, "switched_at": began}, model)
        model.stage_state = self.control.state_dict()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        assert self.control is not None
        model: Any = self.model
        successes = model.ep_success_buffer
        full = successes is not None and len(successes) == successes.maxlen
        rate = float(np.mean(successes)) if full else None
        if self.control.update(model, success_rate=rate):
            model.stage_state = self.control.state_dict()
            if self.verbose:
                print(f"{model.num_timesteps} steps: stage {self.control.stage.name}")
        index = self.control.clock.stages.index(self.control.stage)
        self.logger.record("stages/stage", index)
