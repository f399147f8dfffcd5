"""The rows of the vector environment of agents: PettingZoo's agents, and goal learners on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from counting_agents import Counting
from rollouts import assert_same
from sb3_contrib import TQC
from stable_baselines3 import PPO, HerReplayBuffer

from saver_advisors.learner import GoalReplayBuffer, reward_function_of
from saver_envs.envs.agents_vec_env import AgentsVecEnv
from saver_envs.envs.parallel_env import parallel_env
from saver_envs.envs.sb3_vec_env import SaverVecEnv


def test_rows_are_agents_of_any_environment() -> None:
    env = AgentsVecEnv([Counting, Counting, Counting], seed=7)
    assert env.num_envs == 6
    np.testing.assert_array_equal(env.reset(), np.zeros((6, 1)))
    assert [one.seeds for one in env.envs] == [[7], [8], [9]]
    assert [info["begun"] for info in env.reset_infos] == ["left", "right"] * 3
    actions = np.arange(6, dtype=np.float32)[:, None] / 10
    for _ in range(2):
        seen, rewards, dones, infos = env.step(actions)
        np.testing.assert_array_equal(rewards, actions[:, 0])
        assert not dones.any()
        assert [info["of"] for info in infos] == ["left", "right"] * 3
    np.testing.assert_allclose(seen, 2 * actions)
    seen, _, dones, infos = env.step(actions)
    assert dones.all()
    np.testing.assert_array_equal(seen, np.zeros((6, 1)))
    for info, action in zip(infos, actions, strict=True):
        np.testing.assert_allclose(info["terminal_observation"], 3 * action)
        assert not info["TimeLimit.truncated"]
    assert env.envs[0].seeds == [7, None]
    assert np.arange(6)[env.rows_of("right")].tolist() == [1, 3, 5]


def test_what_does_not_fit_is_named() -> None:
    with pytest.raises(ValueError, match="spaces of right"):
        AgentsVecEnv([lambda: Counting(sizes=(1, 2))])
    with pytest.raises(ValueError, match="env_fns"):
        AgentsVecEnv([])
    env = AgentsVecEnv([lambda: Counting(lengths=(2, 3))])
    env.reset()
    env.step(np.zeros((2, 1)))
    with pytest.raises(ValueError, match="ended episodes of environment 0"):
        env.step(np.zeros((2, 1)))
    with pytest.raises(ValueError, match="agent='middle': must be one of"):
        env.rows_of("middle")


def agents_of(env_id: str, m: int = 2, seed: int = 3, **options: Any) -> AgentsVecEnv:
    return AgentsVecEnv([lambda: parallel_env(env_id, **options)] * m, seed)


def stacked(rows: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {key: np.stack([one[key] for one in rows]) for key in rows[0]}


@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", "DualJacoDistance-v0"])
def test_rows_are_the_blocks_of_the_whole_teams_environment(env_id: str) -> None:
    options = {"max_episode_steps": 6}
    rows, whole = (
        agents_of(env_id, own_goals=True, **options),
        SaverVecEnv(env_id, 2, 3, **options),
    )
    task, random = whole.episodes.task, np.random.default_rng(0)
    layouts = {
        "observation": task.observation_layout,
        "achieved_goal": task.goal_layout,
        "desired_goal": task.goal_layout,
    }

    def dealt(seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            name: np.stack([layouts[name].of_agent(row, arm) for row in rows for arm in range(2)])
            for name, rows in seen.items()
        }

    assert_same(rows.reset(), dealt(whole.reset()))
    for step in range(1, 15):
        actions = random.uniform(-1, 1, (2, whole.action_space.shape[0])).astype(np.float32)
        seen, rewards, dones, infos = rows.step(actions.reshape(4, -1))
        expected, _, over, teams = whole.step(actions)
        assert_same(seen, dealt(expected))
        np.testing.assert_array_equal(dones, np.repeat(over, 2))
        assert over.all() == (step % 6 == 0)
        last = [info["terminal_observation"] for info in infos] if over.all() else None
        for row, info in enumerate(infos):
            assert info["team_success"] == teams[row // 2]["is_success"]
            assert info["cost_collision"] == teams[row // 2]["cost_collision"]
            assert info["TimeLimit.truncated"] == over.all()
            goals = last[row] if last else {key: part[row] for key, part in seen.items()}
            reward = rows.envs[0].compute_reward(goals["achieved_goal"], goals["desired_goal"])
            assert rewards[row] == reward
        if last:
            ends = [info["terminal_observation"] for info in teams]
            assert_same(stacked(last), dealt(stacked(ends)))


@pytest.mark.parametrize("env_id", ["DualJacoPushDense-v0", "DualJacoDistance-v0"])
def test_replay_computes_the_rewards_of_the_environment(env_id: str) -> None:
    env = agents_of(env_id, own_goals=True, max_episode_steps=8)
    reward = reward_function_of(env)
    replay = GoalReplayBuffer(
        640, env.observation_space, env.action_space, n_envs=4, horizon=8, reward_function=reward
    )
    seen, random, given = env.reset(), np.random.default_rng(0), {}
    for step in range(16):
        action = random.uniform(-1, 1, (4, *env.action_space.shape)).astype(np.float32)
        after, rewards, dones, infos = env.step(action)
        then = {key: rows.copy() for key, rows in after.items()}
        for row in np.flatnonzero(dones):
            for key, last in infos[row]["terminal_observation"].items():
                then[key][row] = last
        replay.add(seen, then, action, rewards, dones, infos)
        given |= {(4 * (step // 8) + row, step % 8): rewards[row] for row in range(4)}
        seen = after
    drawn = replay.sample_transitions(500)
    own = drawn.goal_step[:, 0] < 0
    assert 0.1 < own.mean() < 0.3
    for index in np.flatnonzero(own):
        assert drawn.reward[index, 0] == given[int(drawn.slot[index]), int(drawn.step[index])]
    relabelled = np.flatnonzero(~own & (drawn.goal_step[:, 0] == drawn.step + 1))
    np.testing.assert_array_equal(
        drawn.desired_goal[relabelled], drawn.next_achieved_goal[relabelled]
    )
    assert len(np.unique(reward(drawn.next_achieved_goal, drawn.desired_goal))) > 1


def test_without_goals_of_their_own_agents_get_the_teams_reward() -> None:
    env = agents_of("DualJacoPushDense-v0", m=1)
    assert env.reset().shape == (2, 31)
    _, rewards, _, _ = env.step(np.ones((2, 3)))
    assert rewards[0] == rewards[1] < 0
    with pytest.raises(ValueError, match="own_goals=False: must be True"):
        env.env_method("compute_reward", np.zeros(3), np.zeros(3), None)
    PPO("MlpPolicy", env, n_steps=4, batch_size=8, n_epochs=1).learn(8)


@pytest.mark.slow
def test_a_stock_algorithm_with_hindsight_replay_learns_in_it() -> None:
    env = agents_of("DualJacoPush-v0", own_goals=True, max_episode_steps=10)
    model = TQC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=80,
        policy_kwargs={"net_arch": [16]},
        seed=0,
    )
    before = model.policy.state_dict()["actor.mu.weight"].clone()
    model.learn(120)
    assert not (model.policy.state_dict()["actor.mu.weight"] == before).all()
