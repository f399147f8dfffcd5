"""TD3 with an imitation loss on advised transitions."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest
import torch as th
from stable_baselines3 import TD3
from stable_baselines3.common.vec_env import DummyVecEnv

from saver_advisors.learner import GoalTD3
from saver_advisors.learner.algorithms import GoalLearnerMixin
from saver_advisors.learner.policies import GoalTD3Policy
from tests.learner.conftest import PointReach, before_resets


class PlainTD3(GoalLearnerMixin, TD3):
    """SB3's own updates."""

    policy_aliases: ClassVar[Any] = {"MultiInputPolicy": GoalTD3Policy}


class Shown:
    """Marks every transition as advised and stores one and the same action."""

    def __init__(self, model: Any, action: tuple[float, float]) -> None:
        self.model = model
        self.action = np.tile(np.asarray(action, np.float32), (model.n_envs, 1))

    def collect(self, episodes: int) -> None:
        """Fill the buffer with advised episodes."""
        env, buffer = self.model.env, self.model.replay_buffer
        observation = env.reset()
        for _ in range(episodes * 10):
            executed = self.model.policy.unscale_action(self.action)
            after, reward, done, infos = env.step(executed)
            following = before_resets(after, done, infos)
            infos = [{**info, "advised": True} for info in infos]
            buffer.add(observation, following, self.action, reward, done, infos)
            observation = after


def learner(weight: float | None, algorithm: Any = GoalTD3, filter_from: int = 0) -> Any:
    env = DummyVecEnv([PointReach for _ in range(2)])
    return algorithm(
        "MultiInputPolicy",
        env,
        buffer_size=2_000,
        policy_kwargs={"net_arch": [32, 32]},
        learning_rate=3e-3,
        seed=0,
        device="cpu",
        **(
            {}
            if weight is None
            else {"imitation_weight": weight, "imitation_filter_start": filter_from}
        ),
    )


def mean_action(model: Any) -> Any:
    observation = {key: np.repeat(value, 1, 0) for key, value in model.env.reset().items()}
    with th.no_grad():
        tensors, _ = model.policy.obs_to_tensor(observation)
        return model.actor(tensors).numpy().mean(axis=0)


def trained(model: Any) -> Any:
    model._setup_learn(100, None)
    Shown(model, (0.6, -0.4)).collect(10)
    model.train(200, 64)
    return model


def filtered(model: Any, passes: bool) -> Any:
    """Replace the critic's ranking: shown actions are all better than the actor's, or all worse."""
    original, calls = model.critic.q1_forward, {"count": 0}

    def q1_forward(observation: Any, action: th.Tensor) -> th.Tensor:
        calls["count"] += 1
        own = calls["count"] % 2 == 1
        return original(observation, action) * 0.0 + (1.0 if own != passes else 0.0)

    model.critic.q1_forward = q1_forward
    return model


def test_the_actor_is_drawn_to_advised_actions() -> None:
    action = mean_action(trained(filtered(learner(5.0), passes=True)))
    np.testing.assert_allclose(action, (0.6, -0.4), atol=0.1)


def test_actions_that_the_critic_finds_worse_are_not_imitated() -> None:
    model = filtered(learner(5.0), passes=False)
    before = [parameter.clone() for parameter in model.actor.parameters()]
    trained(model)
    for parameter, old in zip(model.actor.parameters(), before, strict=True):
        assert th.equal(parameter, old)


def test_before_its_step_the_filter_is_open() -> None:
    action = mean_action(trained(filtered(learner(5.0, filter_from=1_000), passes=False)))
    np.testing.assert_allclose(action, (0.6, -0.4), atol=0.1)


def test_without_weight_it_is_plain_td3() -> None:
    plain, weightless = trained(learner(None, PlainTD3)), trained(learner(0.0))
    for first, second in zip(
        plain.policy.parameters(), weightless.policy.parameters(), strict=True
    ):
        assert th.equal(first, second)


def test_a_negative_weight_is_refused() -> None:
    with pytest.raises(ValueError, match="imitation_weight=-1"):
        learner(-1.0)
