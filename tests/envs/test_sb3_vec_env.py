"""The SB3 vector environment."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from rollouts import FEW_IDS, assert_same, pickled_and_back, random_actions, row_of
from stable_baselines3.common.env_util import make_vec_env

from saver_envs.envs.sb3_vec_env import SaverVecEnv


@pytest.mark.slow
@pytest.mark.parametrize("env_id", FEW_IDS)
def test_equals_sb3s_own_vector_of_single_envs_over_200_steps(env_id: str) -> None:
    ours = SaverVecEnv(env_id, 3, seed=10)
    theirs = make_vec_env(env_id, 3, seed=10)
    assert_same(ours.reset(), theirs.reset())
    for action in random_actions(ours.action_space.shape[0], 200, 3):
        one, other = ours.step(action), theirs.step(action)
        for infos in one[3], other[3]:
            for info in infos:
                info.pop("episode", None)  # the monitor's, which ours does not have
                info.setdefault("TimeLimit.truncated", False)
        assert_same(one, other)


def test_terminal_observations() -> None:
    ours = SaverVecEnv("JacoPush-v0", 2, seed=0, max_episode_steps=3)
    single = gymnasium.make("JacoPush-v0", max_episode_steps=3)
    single.reset(seed=1)
    ours.reset()
    for step, action in enumerate(random_actions(3, 3, 2)):
        observation, _, done, infos = ours.step(action)
        alone = single.step(action[1])[0]
        if step < 2:
            assert not done.any()
            assert "terminal_observation" not in infos[1]
    assert done.all()
    assert infos[1]["TimeLimit.truncated"] is True
    assert_same(infos[1]["terminal_observation"], alone)
    assert_same(row_of(observation, 1), single.reset()[0])
    observation["observation"][:] = 0  # neither is a view of the other
    assert_same(infos[1]["terminal_observation"], alone)


def test_seeds() -> None:
    env = SaverVecEnv("JacoPickAndPlace-v0", 3)
    env.seed(4)
    first = env.reset()
    assert_same(first, env.reset_episodes([4, 5, 6]))
    env.reset()
    env.seed(4)
    assert_same(first, env.reset())
    with pytest.raises(ValueError, match="2 seeds"):
        env.reset_episodes([1, 2])


def test_bad_actions_change_nothing() -> None:
    env = SaverVecEnv("JacoPush-v0", 2, seed=0)
    env.reset()
    before = env.episodes.get_state().simulation
    for bad in (np.full((2, 3), np.inf), np.zeros((3, 3))):
        with pytest.raises(ValueError, match=r"shape|finite"):
            env.step(bad)
    np.testing.assert_array_equal(before, env.episodes.get_state().simulation)


def test_relabelling_as_her_calls_it() -> None:
    env = SaverVecEnv("DualJacoDistance-v0", 2, seed=0)
    observation = env.reset()
    achieved, desired = observation["achieved_goal"], observation["desired_goal"]
    rewards = env.env_method("compute_reward", achieved, desired, [{}, {}], indices=[0])
    assert rewards[0].shape == (2,)
    np.testing.assert_array_equal(
        env.env_method("compute_reward", desired, desired, [{}, {}], indices=[0])[0], 0
    )


def test_copies_made_in_mid_episode_go_on_identically() -> None:
    env = SaverVecEnv("JacoPickAndPlace-v0", 2, seed=0, max_episode_steps=6)
    env.reset()
    env.step(random_actions(4, 1, 2)[0])
    twin = pickled_and_back(env)
    for action in random_actions(4, 15, 2, seed=1):
        assert_same(env.step(action), twin.step(action))
