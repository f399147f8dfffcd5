"""The learners: exploration, statistics, composition, and that they learn."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from stable_baselines3 import TD3, HerReplayBuffer
from stable_baselines3.common.vec_env import DummyVecEnv

from saver_advisors.advising import AdvisedMixin, build_advised
from saver_advisors.learner import GoalDDPG, GoalReplayBuffer, GoalSAC, GoalTD3, GoalTQC
from saver_advisors.learner.algorithms import GoalLearnerMixin, episode_horizon
from saver_advisors.learner.policies import GoalTD3Policy

LEARNERS: list[Any] = [GoalDDPG, GoalTD3, GoalSAC, GoalTQC]


class OuterMixin:
    """Stands for advice: the second environment always takes one action."""

    def _sample_action(self, *arguments: Any, **named: Any) -> Any:
        action, stored = super()._sample_action(*arguments, **named)  # type: ignore[misc]
        action, stored = action.copy(), stored.copy()
        action[1] = (3.5, -0.4)
        stored[1] = self.policy.scale_action(action[1])  # type: ignore[attr-defined]
        return action, stored


def make_learner(cls: Any, env: Any, **arguments: Any) -> Any:
    defaults = {
        "buffer_size": 4000,
        "batch_size": 16,
        "train_freq": 10,
        "gradient_steps": 2,
        "learning_starts": 0,
        "exploration_noise": 0.3,
        "seed": 0,
        "policy_kwargs": {"net_arch": [16]},
    }
    return cls("MultiInputPolicy", env, **(defaults | arguments))


def stored_actions(buffer: GoalReplayBuffer, episodes: int) -> npt.NDArray[Any]:
    """(n_envs, steps, action_dim) of full episodes, in the order they came."""
    n_envs, horizon = buffer.n_envs, buffer.horizon
    actions = buffer.action[: n_envs * episodes].reshape(episodes, n_envs, horizon, -1)
    return actions.transpose(1, 0, 2, 3).reshape(n_envs, episodes * horizon, -1)


def executed_actions(env: Any) -> npt.NDArray[Any]:
    return np.array(env.get_attr("executed"))


@pytest.mark.parametrize("cls", LEARNERS)
@pytest.mark.parametrize("outer", [False, True])
def test_the_stored_action_is_the_executed_one(cls: Any, outer: bool, make_env: Any) -> None:
    env = make_env(3)
    if outer:
        cls = type("Outer", (OuterMixin, cls), {})
    model = make_learner(cls, env, learning_starts=60)
    model.learn(180)
    stored, executed = stored_actions(model.replay_buffer, 6), executed_actions(env)
    np.testing.assert_array_equal(model.policy.unscale_action(stored), executed)
    fixed = np.isclose(executed, (3.5, -0.4)).all(axis=2).mean(axis=1)
    np.testing.assert_array_equal(fixed, (0, 1, 0) if outer else (0, 0, 0))
    assert np.unique(stored[0], axis=0).shape[0] > 50


def test_a_trained_policy_acts_before_it_learns(make_env: Any) -> None:
    env = make_env(4)
    model = make_learner(GoalTD3, env, exploration_noise=0.0, random_action_probability=0.0)
    model._last_obs = env.reset()
    own = model.policy.scale_action(model.predict(model._last_obs)[0])
    for is_trained in (False, True):
        model.is_trained = is_trained
        _, stored = model._sample_action(100, None, 4)
        assert np.allclose(stored, own, atol=1e-6) == is_trained


def test_random_actions_replace_at_their_rate_and_cover_the_box(make_env: Any) -> None:
    env = make_env(4)
    model = make_learner(
        GoalTD3, env, exploration_noise=0.0, random_action_probability=0.25, gradient_steps=0
    )
    env.reset()
    model._last_obs = env.reset()
    own, _ = model.predict(model._last_obs)
    draws = [model._sample_action(0, None, 4) for _ in range(1000)]
    actions = np.array([action for action, _ in draws])
    replaced = ~np.isclose(actions, own, atol=1e-6).all(axis=2)
    assert abs(replaced.mean() - 0.25) < 0.03
    # Each environment is chosen by itself, not all of them together.
    assert 0.03 < (replaced[:, 0] & replaced[:, 1]).mean() < 0.1
    random = np.array([stored for _, stored in draws])[replaced]
    assert random.min() < -0.98
    assert random.max() > 0.98
    assert np.abs(random.mean(axis=0)).max() < 0.1


def test_noise_has_its_deviation_and_stays_in_the_box(make_env: Any) -> None:
    env = make_env(4)
    model = make_learner(GoalTD3, env, exploration_noise=0.1, random_action_probability=0.0)
    model._last_obs = env.reset()
    own = model.policy.scale_action(model.predict(model._last_obs)[0])
    stored = np.array([model._sample_action(0, None, 4)[1] for _ in range(500)])
    assert abs((stored - own).std() - 0.1) < 0.01
    loud = make_learner(GoalTD3, env, exploration_noise=9.0, random_action_probability=0.0)
    loud._last_obs = env.reset()
    stored = np.array([loud._sample_action(0, None, 4)[1] for _ in range(50)])
    assert np.abs(stored).max() == 1.0


@pytest.mark.parametrize("cut_short", [False, True])
def test_statistics_are_half_real_and_half_achieved_goals(make_env: Any, cut_short: bool) -> None:
    env = make_env(3, cut_short=cut_short)
    model = make_learner(GoalTD3, env)
    model.learn(120)
    buffer, features = model.replay_buffer, model.policy.shared_features
    rows = []
    for slot in range(buffer.n_slots):
        length = buffer.length[slot]
        if length == 10 or (
            cut_short and length == 4 and slot not in buffer._slot[buffer._running]
        ):
            for step in range(length):
                for goal in (buffer.desired_goal[slot], buffer.achieved_goal[slot, step + 1]):
                    rows.append(np.append(buffer.observation[slot, step], goal))
    assert (features.count == len(rows)).all() and len(rows) > 150
    np.testing.assert_allclose(features.mean.numpy(), np.mean(rows, axis=0, dtype=float), rtol=1e-6)
    np.testing.assert_allclose(
        1 / features.scale.numpy(), np.maximum(np.std(rows, axis=0, dtype=float), 0.01), rtol=1e-4
    )


def test_a_second_learn_does_not_join_episodes(make_env: Any) -> None:
    env = make_env(2)
    model = make_learner(GoalTD3, env, train_freq=4)
    model.learn(24)
    model.learn(24)
    buffer = model.replay_buffer
    for slot in range(buffer.n_slots):
        clock = buffer.observation[slot, : buffer.length[slot] + 1, 2]
        np.testing.assert_array_equal(clock, np.arange(len(clock)))


def test_what_environment_and_discount_imply(make_env: Any) -> None:
    model = make_learner(GoalTD3, make_env(2, horizon=7), gamma=0.95)
    assert model.replay_buffer.horizon == 7
    assert model.policy.critic_target.value_bounds == pytest.approx((-20.0, 0.0))
    assert isinstance(model.policy, GoalTD3Policy)
    given = make_learner(GoalTD3, make_env(2), policy_kwargs={"net_arch": [8], "q_min": -3.0})
    assert given.policy.critic_target.value_bounds == (-3.0, 0.0)
    # The reward function holds the environment and must stay out of SB3's pickled arguments.
    assert set(given.replay_buffer_kwargs) == {"horizon"}


def test_the_horizon_is_found_or_asked_for() -> None:
    class Plain(gymnasium.Env[Any, Any]):
        observation_space = gymnasium.spaces.Box(-1, 1, (2,))
        action_space = gymnasium.spaces.Box(-1, 1, (2,))

    with pytest.raises(ValueError, match="horizon"):
        episode_horizon(DummyVecEnv([Plain]))
    spec = gymnasium.envs.registration.EnvSpec("Plain-v0", max_episode_steps=33)
    plain = Plain()
    plain.spec = spec
    assert episode_horizon(DummyVecEnv([lambda: plain])) == 33


def test_the_same_seed_gives_the_same_run(make_env: Any) -> None:
    actions = []
    for seed in (5, 5, 6):
        env = make_env(2)
        make_learner(GoalTD3, env, seed=seed).learn(80)
        actions.append(executed_actions(env))
    np.testing.assert_array_equal(actions[0], actions[1])
    assert not np.array_equal(actions[0], actions[2])


def test_advising_composes(make_env: Any) -> None:
    cls = build_advised(GoalTD3)
    order = cls.__mro__
    assert order.index(AdvisedMixin) < order.index(GoalLearnerMixin) < order.index(TD3)
    env = make_env(2)
    model = make_learner(cls, env)
    model.learn(40)
    stored = stored_actions(model.replay_buffer, 2)
    np.testing.assert_array_equal(model.policy.unscale_action(stored), executed_actions(env))


def test_wrong_arguments_are_named(make_env: Any) -> None:
    env = make_env(2)
    with pytest.raises(ValueError, match=r"random_action_probability=1\.5"):
        make_learner(GoalTD3, env, random_action_probability=1.5)
    with pytest.raises(ValueError, match="exploration_noise=-1"):
        make_learner(GoalTD3, env, exploration_noise=-1)
    with pytest.raises(TypeError, match="HerReplayBuffer must be GoalReplayBuffer"):
        make_learner(GoalTD3, env, replay_buffer_class=HerReplayBuffer)


@pytest.mark.slow
def test_it_learns_to_reach(make_env: Any) -> None:
    env = make_env(4)
    model = make_learner(
        GoalDDPG,
        env,
        batch_size=128,
        gradient_steps=20,
        gamma=0.95,
        tau=0.02,
        learning_rate=1e-3,
        exploration_noise=0.15,
        policy_kwargs={"net_arch": [64, 64], "action_penalty": 0.1},
    )

    def success_rate() -> float:
        env.seed(1000)
        observation, wins = env.reset(), []
        for _ in range(100):
            action, _ = model.predict(observation, deterministic=True)
            observation, _, dones, infos = env.step(action)
            wins += [info["is_success"] for done, info in zip(dones, infos, strict=True) if done]
        return float(np.mean(wins))

    assert success_rate() < 0.5
    model.learn(1600)
    assert success_rate() >= 0.8
