"""Actor-critic policies of on-policy algorithms that start as single-arm teachers, side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import nn

from saver_advisors.advising import make_advisor
from saver_advisors.advising.warm_start import start_policy
from saver_advisors.learner.policies import NormalizedGoalFeatures


class StartedPolicy(MultiInputActorCriticPolicy):
    """Normalised inputs, and a mean action that ends in a tanh, as the teachers' do.

    The mean action starts as the teachers' exactly. The value network and the exploration noise
    start from scratch, and inputs that no teacher has, such as the distance of a constraint, start
    without weight. The algorithms of this package update the statistics of such inputs.

    :param observation_space: of a goal environment.
    :param action_space: a 1-D Box.
    :param lr_schedule: SB3's learning-rate schedule.
    :param teacher: as for ``make_advisor``; None starts from random weights.
    :param log_std_init: logarithm of the exploration noise's standard deviation at the start.
    :param arguments: as for SB3's policy. The achieved goal is an input by default.
    :raises ValueError: if the networks cannot hold the teachers' side by side.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        teacher: str | None = None,
        log_std_init: float = float(np.log(0.1)),
        **arguments: Any,
    ) -> None:
        arguments.setdefault("features_extractor_class", NormalizedGoalFeatures)
        arguments.setdefault("features_extractor_kwargs", {"achieved_goal": True})
        arguments.setdefault("activation_fn", nn.ReLU)
        super().__init__(
            observation_space, action_space, lr_schedule, log_std_init=log_std_init, **arguments
        )
        self.teacher = teacher
        if teacher is not None:
            advisor = make_advisor(
                "none",
                teacher,
                budget=0,
                observation_space=observation_space,
                action_space=action_space,
            )
            start_policy(self, advisor.teachers, advisor.mapping)

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Sequential(self.action_net, nn.Tanh())

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "teacher": self.teacher}
