"""A value for each part of a goal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch as th

from saver_advisors.learner import GoalTD3
from saver_advisors.learner.policies import GoalTQCPolicy, conservative_values
from saver_advisors.training.settings import RunConfig
from tests.learner.test_policies import make_policy


def second_part_met(achieved: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """The first coordinate never matters, the second is met by the very same number alone."""
    return np.where(achieved[:, 1] == desired[:, 1], 0.0, -1.0)


def test_each_part_has_a_value_of_its_own(make_env: Any) -> None:
    model = GoalTD3(
        "MultiInputPolicy",
        make_env(2),
        buffer_size=2_000,
        learning_rate=3e-3,
        policy_kwargs={"net_arch": [32, 32], "n_values": 2},
        replay_buffer_kwargs={
            "goal_parts": (1, 1),
            "relabel_probability": 0.0,
            "reward_function": second_part_met,
        },
        seed=0,
        device="cpu",
    )
    model.learn(200)
    model.train(400, 64)
    drawn = model.replay_buffer.sample(64)
    with th.no_grad():
        first, second = th.stack(model.critic(drawn.observations, drawn.actions)).mean(dim=(0, 1))
        value = conservative_values(model.critic, drawn.observations, drawn.actions).mean()
    assert abs(float(first)) < 0.5
    assert float(second) < -2.0
    # What is reported of the student lies between its parts.
    assert float(second) < float(value) < float(first)


def test_algorithms_with_one_value_refuse_parts() -> None:
    with pytest.raises(ValueError, match="n_values=2"):
        make_policy(GoalTQCPolicy, n_values=2)
    with pytest.raises(ValueError, match="n_values=0"):
        make_policy(n_values=0)
    with pytest.raises(ValueError, match="per_arm_critics=True needs algorithm='td3', not 'sac'"):
        RunConfig("DualJacoPush-v0", algorithm="sac", per_arm_critics=True)
