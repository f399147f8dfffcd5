"""Costs beside goals: stored, sampled, valued, and weighed by a multiplier."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from saver_advisors.learner import GoalReplayBuffer, GoalTD3
from saver_advisors.learner.policies import cost_values, goal_values
from saver_advisors.training.building import build_model
from saver_advisors.training.settings import RunConfig
from saver_envs.envs.sb3_vec_env import SaverVecEnv


def make_model(env: Any, **arguments: Any) -> GoalTD3:
    settings: dict[str, Any] = {
        "buffer_size": 2_000,
        "learning_rate": 3e-3,
        "batch_size": 64,
        "train_freq": (10, "step"),
        "gradient_steps": 2,
        # Without the penalty, the actor seeks actions whose cost the critics underrate.
        "policy_kwargs": {"net_arch": [32, 32], "action_penalty": 0.5},
        "replay_buffer_kwargs": {"cost_key": "cost"},
        "seed": 0,
        "device": "cpu",
    }
    return GoalTD3("MultiInputPolicy", env, **{**settings, **arguments})


def test_costs_survive_relabelling_and_files(make_env: Any, tmp_path: Path) -> None:
    model = make_model(make_env(2), contact_cost=0.5)
    model.learn(200)
    buffer = model.replay_buffer
    assert isinstance(buffer, GoalReplayBuffer)
    drawn = buffer.sample_transitions(300)
    assert (drawn.goal_step >= 0).any() and (drawn.goal_step < 0).any()
    # The point's cost is 1 in every step whose number is odd, whatever the goal.
    np.testing.assert_array_equal(drawn.cost, (drawn.step + 1) % 2)
    sampled = buffer.as_samples(drawn)
    np.testing.assert_array_equal(sampled.rewards[:, 1], -drawn.cost)
    np.testing.assert_array_equal(sampled.rewards[:, 0], drawn.reward[:, 0])
    buffer.save_npz(tmp_path / "replay.npz")
    other = make_model(make_env(2), contact_cost=0.5).replay_buffer
    other.load_npz(tmp_path / "replay.npz")
    np.testing.assert_array_equal(other.cost, buffer.cost)
    plain = make_model(make_env(2), replay_buffer_kwargs={}).replay_buffer
    plain.save_npz(tmp_path / "plain.npz")
    with pytest.raises(ValueError, match="cost"):
        other.load_npz(tmp_path / "plain.npz")


def test_a_missing_cost_is_named(make_env: Any) -> None:
    model = make_model(make_env(2), contact_cost=0.5, replay_buffer_kwargs={})
    with pytest.raises(KeyError, match=r"cost_key='cost_collision'.*info has only"):
        model.learn(20)


def test_the_cost_may_be_another_than_contact(make_env: Any) -> None:
    model = make_model(make_env(2), contact_cost=0.5, cost_key="cost", replay_buffer_kwargs={})
    model.learn(20)
    assert model.replay_buffer.cost.sum() == 10, "of 20 steps"


def test_a_runs_cost_is_one_of_its_task() -> None:
    values = {"env_id": "DualJacoDistance-v0", "n_envs": 2, "cost_limit": 1.0}
    with closing(SaverVecEnv("DualJacoDistance-v0", 2)) as env:
        wrong = RunConfig.from_mapping({**values, "cost_key": "cost_force"})
        with pytest.raises(
            ValueError, match=r"cost_key='cost_force'.*cost_collision, cost_distance"
        ):
            build_model(wrong, env)
        model = build_model(RunConfig.from_mapping({**values, "cost_key": "cost_distance"}), env)
    assert model.replay_buffer.cost_key == "cost_distance"


def test_the_critics_learn_the_cost(make_env: Any) -> None:
    """Every second step costs 1: from a mean state on, 1/2 / (1 - gamma)."""
    model = make_model(make_env(4), contact_cost=0.5, gamma=0.5, tau=0.05)
    model.learn(400)
    model.train(600, 64)
    drawn = model.replay_buffer.sample_transitions(200)
    sampled = model.replay_buffer.as_samples(drawn)
    with th.no_grad():
        values = model.critic(sampled.observations, sampled.actions)[0]
    assert -float(cost_values(model.critic, values).mean()) == pytest.approx(1.0, abs=0.3)
    assert goal_values(model.critic, values).shape == (200, 1)


def test_the_objective_weighs_goal_and_cost(make_env: Any) -> None:
    model = make_model(make_env(2), contact_cost=0.5)
    values = th.tensor([[-4.0, -2.0]])
    assert float(model._weighted(values)) == pytest.approx((-4.0 - 0.5 * 2.0) / 1.5)
    model = make_model(make_env(2), replay_buffer_kwargs={})
    assert float(model._weighted(th.tensor([[-4.0]]))) == -4.0


def test_the_multiplier_follows_the_limit(make_env: Any) -> None:
    """Half of the steps cost 1, whatever the actor does: 5 of an episode's 10."""
    rising = make_model(make_env(2), contact_cost=0.5, cost_limit=1.0, gamma=0.5, tau=0.05)
    falling = make_model(make_env(2), contact_cost=0.5, cost_limit=9.0, gamma=0.5, tau=0.05)
    fixed = make_model(make_env(2), contact_cost=0.5, gamma=0.5, tau=0.05)
    for model in (rising, falling, fixed):
        model.learn(200)
        for _ in range(20):
            model.train(40, 64)
    assert 3.5 < fixed.logger.name_to_value["train/episode_cost"] < 6.0
    assert float(rising.multiplier) > 0.7
    assert float(falling.multiplier) == 0.0
    assert float(fixed.multiplier) == 0.5
    assert rising.logger.name_to_value["train/cost_multiplier"] == float(rising.multiplier)


def test_a_student_value_is_of_the_goal_alone(make_env: Any) -> None:
    env = make_env(2)
    model = make_model(env, contact_cost=0.5)
    observation = env.reset()
    action, _ = model.predict(observation, deterministic=True)
    before = model.student_value(observation, action)
    for network in model.critic.q_networks:
        network[-1].bias.data[1] -= 7.0
    np.testing.assert_array_equal(model.student_value(observation, action), before)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"contact_cost": -1.0}, "contact_cost=-1.0"), ({"cost_limit": -0.1}, "cost_limit=-0.1")],
)
def test_arguments_out_of_range(make_env: Any, arguments: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_model(make_env(2), **arguments)
