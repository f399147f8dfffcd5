"""The PettingZoo environment: one agent per arm."""

from __future__ import annotations

import copy
import warnings

import gymnasium
import numpy as np
import pettingzoo
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test
from rollouts import DUAL_IDS, assert_same, cubes_of, random_actions

from saver_envs.envs.parallel_env import SaverParallelEnv, parallel_env

FEW_DUAL_IDS = ["DualJacoPush-v0", "DualJacoDistance-v0"]


@pytest.mark.parametrize("own_goals", [False, True])
@pytest.mark.parametrize("env_id", DUAL_IDS)
def test_pettingzoos_own_tests(env_id: str, own_goals: bool) -> None:
    def made() -> SaverParallelEnv:
        return pettingzoo.make("parallel", f"saver_envs/{env_id}", own_goals=own_goals)

    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        parallel_api_test(made(), num_cycles=60)
        parallel_seed_test(made, num_cycles=20)


@pytest.mark.parametrize("env_id", FEW_DUAL_IDS)
def test_is_the_goal_env_dealt_out_to_the_arms(env_id: str) -> None:
    whole, shared = gymnasium.make(env_id), parallel_env(env_id=env_id)
    seen, _ = whole.reset(seed=4)
    dealt, infos = shared.reset(seed=4)
    assert shared.agents == ["arm_0", "arm_1"]
    for action in random_actions(whole.action_space.shape[0], 50, 1)[:, 0]:
        team = [] if seen["achieved_goal"].size == 6 else [seen["achieved_goal"][6:]]
        team += [] if not team else [seen["desired_goal"][6:]]
        for arm, agent in enumerate(shared.possible_agents):
            block = seen["observation"][28 * arm : 28 * (arm + 1)]
            goal = seen["desired_goal"][3 * arm : 3 * (arm + 1)]
            np.testing.assert_array_equal(dealt[agent], np.concatenate([block, goal, *team]))
            assert dealt[agent] in shared.observation_space(agent)
        np.testing.assert_array_equal(shared.state(), np.concatenate(list(order(seen))))
        assert shared.state() in shared.state_space
        halves = dict(zip(shared.agents, np.split(action, 2), strict=True))
        seen, reward, _, over, info = whole.step(action)
        dealt, rewards, terminated, truncated, infos = shared.step(halves)
        assert set(rewards.values()) == {reward}
        assert not any(terminated.values())
        assert set(truncated.values()) == {over}
        reached = []
        for arm, agent in enumerate(shared.possible_agents):
            apart = (seen["achieved_goal"] - seen["desired_goal"])[3 * arm : 3 * (arm + 1)]
            assert infos[agent]["is_success"] == (np.linalg.norm(apart) <= 0.05)
            reached.append(infos[agent]["is_success"])
            assert infos[agent]["team_success"] == info["is_success"]
            assert infos[agent]["cost"] == info["cost"]
        assert info["goal_reached"] == all(reached)
    assert over
    assert shared.agents == []
    assert shared.step({}) == ({}, {}, {}, {}, {})


def order(seen: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    return seen["observation"], seen["achieved_goal"], seen["desired_goal"]


def test_own_success_is_the_own_objects() -> None:
    env = parallel_env(env_id="DualJacoPush-v0")
    env.reset(seed=0)
    episodes = env.episodes
    there = episodes.targets()[0, 1]
    episodes.simulation.qpos[0, cubes_of(episodes).qpos[1, :3]] = there
    idle = {agent: np.zeros(3) for agent in env.agents}
    _, rewards, _, _, infos = env.step(idle)
    assert [infos[agent]["is_success"] for agent in env.possible_agents] == [False, True]
    assert not infos["arm_1"]["team_success"]
    assert rewards == {"arm_0": -1.0, "arm_1": -1.0}


def test_with_goals_of_their_own_agents_are_rewarded_apart() -> None:
    env = parallel_env(env_id="DualJacoPush-v0", own_goals=True)
    env.reset(seed=0)
    there = env.episodes.targets()[0, 1]
    env.episodes.simulation.qpos[0, cubes_of(env.episodes).qpos[1, :3]] = there
    seen, rewards, _, _, _ = env.step({agent: np.zeros(3) for agent in env.agents})
    assert rewards == {"arm_0": -1.0, "arm_1": 0.0}
    for agent, own in seen.items():
        assert own in env.observation_space(agent)
        assert env.compute_reward(own["achieved_goal"], own["desired_goal"]) == rewards[agent]
    achieved = np.stack([own["achieved_goal"] for own in seen.values()])
    rewards = env.compute_reward(achieved[:, None], achieved)
    np.testing.assert_array_equal(rewards, [[0, -1], [-1, 0]])


def test_an_agents_goal_has_what_the_teams_goals_share() -> None:
    env = parallel_env(env_id="DualJacoDistance-v0", own_goals=True)
    seen, _ = env.reset(seed=0)
    state = env.state()
    for own in seen.values():
        assert own["achieved_goal"].shape == own["desired_goal"].shape == (4,)
        assert own["desired_goal"][3] == state[-1]
    own = seen["arm_0"]["desired_goal"]
    assert env.compute_reward(own, own) == 0
    assert env.compute_reward(own + np.array([0, 0, 0, 1]), own) < 0


def test_goals_of_another_size_and_shared_goals_are_refused() -> None:
    env = parallel_env(env_id="DualJacoPush-v0", own_goals=True)
    with pytest.raises(ValueError, match=r"desired_goal.shape=\(6,\): must be \(..., 3\)"):
        env.compute_reward(np.zeros(3), np.zeros(6))
    with pytest.raises(ValueError, match="own_goals=False: must be True"):
        parallel_env(env_id="DualJacoPush-v0").compute_reward(np.zeros(3), np.zeros(3))


def test_bad_actions_change_nothing() -> None:
    env = SaverParallelEnv("DualJacoPush-v0")
    env.reset(seed=0)
    before = env.episodes.get_state().simulation
    fine = np.zeros(3)
    for actions, message in (
        ({"arm_0": fine}, "one is needed for each of"),
        ({"arm_0": fine, "arm_2": fine}, "arm_2"),
        ({"arm_0": fine, "arm_1": np.zeros(4)}, "arm_1's action of shape"),
        ({"arm_0": np.array([0, np.nan, 0]), "arm_1": fine}, "arm_0's action="),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(actions)
        np.testing.assert_array_equal(before, env.episodes.get_state().simulation)


def test_keywords_reach_the_episodes() -> None:
    env = pettingzoo.make(
        "parallel", "saver_envs/DualJacoPush-v0", max_cycles=3, object_mass=0.5, n_arms=3
    )
    assert env.possible_agents == ["arm_0", "arm_1", "arm_2"]
    assert env.episodes.settings.horizon == 3
    assert env.episodes.task.object_mass == 0.5
    with pytest.raises(TypeError, match="valid keywords are"):
        parallel_env(env_id="DualJacoPush-v0", colour="red")


def test_copies_made_in_mid_episode_go_on_identically() -> None:
    env = parallel_env(env_id="DualJacoDistance-v0", max_episode_steps=5)
    env.reset(seed=0)
    twin = copy.deepcopy(env)
    for action in random_actions(8, 14, 1)[:, 0]:
        if not env.agents:
            assert_same(env.reset(), twin.reset())
        halves = dict(zip(env.agents, np.split(action, 2), strict=True))
        assert_same(env.step(halves), twin.step(halves))
