"""Steps of six values, for libraries of safe learning."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from saver_envs.wrappers.cost_step import CostStep, CostVectorStep

DISTANCE = "DualJacoDistance-v0"


def test_the_cost_stands_after_the_reward() -> None:
    env, plain = (gymnasium.make(DISTANCE, in_hand_probability=1.0) for _ in range(2))
    env = CostStep(env)
    env.reset(seed=0)
    plain.reset(seed=0)
    action = np.array([0, -1, 0.3, -1, 0, 1, 0.3, -1])  # both cubes in hand, pulled apart
    for _ in range(50):
        observation, reward, cost, terminated, truncated, info = env.step(action)
        same, value, *flags, its_info = plain.step(action)
        np.testing.assert_array_equal(observation["observation"], same["observation"])
        assert (reward, [terminated, truncated], info) == (value, flags, its_info)
        assert isinstance(cost, float)
        assert cost == info["cost_distance"]
    assert truncated
    assert cost == 1.0


def test_another_cost() -> None:
    env = CostStep(gymnasium.make(DISTANCE), "cost_collision")
    env.reset(seed=0)
    for _ in range(20):
        result = env.step(-np.ones(8))
        assert result[2] == result[5]["cost_collision"]
    assert env.spec is not None
    assert env.spec.additional_wrappers[-1].kwargs == {"cost": "cost_collision"}


@pytest.mark.parametrize("wrap", [CostStep, CostVectorStep])
def test_an_unknown_cost_is_refused(wrap: type) -> None:
    made = gymnasium.make(DISTANCE) if wrap is CostStep else gymnasium.make_vec(DISTANCE)
    env = wrap(made, "cost_torso_force")
    with pytest.raises(ValueError, match=r"cost='cost_torso_force'.*cost, cost_collision, cost_di"):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="it has none"):
        CostStep(gymnasium.make("Pendulum-v1")).reset()


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vectors_have_the_cost_of_the_step(mode: AutoresetMode) -> None:
    """Also of the step that ends an episode and begins another, whose cost is 0."""
    made = gymnasium.make_vec(DISTANCE, num_envs=2, autoreset_mode=mode, max_episode_steps=10)
    env = CostVectorStep(made)
    singles = [CostStep(gymnasium.make(DISTANCE, max_episode_steps=10)) for _ in range(2)]
    env.reset(seed=4)
    for index, single in enumerate(singles):
        single.reset(seed=4 + index)
    random = np.random.default_rng(0)
    for _ in range(10):
        actions = random.uniform(-1, 1, (2, 8))
        _, reward, cost, _, truncated, _ = env.step(actions)
        alone = [single.step(action) for single, action in zip(singles, actions, strict=True)]
        assert cost.tolist() == [result[2] for result in alone]
        assert reward.tolist() == [result[1] for result in alone]
    assert truncated.all()
    assert cost.any()
