"""A simulation that breaks down ends its own episode and nothing else."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from mujoco.batch import Batch, SimulationError
from rollouts import FEW_IDS, assert_same, begun, cubes_of, random_actions

from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.episodes import Episodes


def break_down(episodes: Episodes, row: int, how: str) -> None:
    simulation = episodes.simulation
    if how == "velocity":
        simulation.qvel[row, 0] = np.nan
    elif how == "position":
        simulation.qpos[row, cubes_of(episodes).qpos[0, 0]] = np.inf
    else:
        simulation.qvel[row] = 1e12


@pytest.mark.parametrize("how", ["velocity", "position", "explosion"])
@pytest.mark.parametrize("env_id", FEW_IDS)
def test_that_episode_alone_is_truncated(env_id: str, how: str) -> None:
    n, broken, others = 4, 2, [0, 1, 3]
    episodes, untouched = begun(env_id, n), begun(env_id, n)
    for step, action in enumerate(random_actions(episodes.action_size, 12, n)):
        seen = episodes.observation()
        if step == 5:
            break_down(episodes, broken, how)
        outcome, reference = episodes.step(action), untouched.step(action)
        assert outcome.diverged.tolist() == [row == broken and step == 5 for row in range(n)]
        assert (outcome.truncated == outcome.diverged).all()
        assert not reference.diverged.any()
        now = episodes.observation()
        assert all(np.isfinite(values).all() for values in vars(now).values())
        assert np.isfinite(episodes.simulation.qpos).all()
        if step == 5:  # what was seen last still stands
            assert_same(now.observation[broken], seen.observation[broken])
            assert_same(now.achieved_goal[broken], seen.achieved_goal[broken])
            episodes.reset([broken])
            now = episodes.observation()
        then = untouched.observation()
        for name in vars(now):
            assert_same(getattr(now, name)[others], getattr(then, name)[others], name)
        assert_same(outcome.reward[others], reference.reward[others])
        for name, values in outcome.info().items():
            assert_same(values[others], reference.info()[name][others], name)


def test_an_error_of_the_simulator_truncates_its_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    episodes = begun("JacoPush-v0", 3)

    def fail(self: Batch, *arguments: object) -> None:
        raise SimulationError(np.array([1]), "engine error", 3)

    monkeypatch.setattr(Batch, "step", fail)
    outcome = episodes.step(np.zeros((3, episodes.action_size)))
    assert outcome.diverged.tolist() == outcome.truncated.tolist() == [False, True, False]


def test_positions_between_actions_are_kept_on_request() -> None:
    episodes = begun("JacoPush-v0", 1)
    simulation, push = episodes.simulation, np.ones((1, episodes.action_size))
    episodes.step(push)
    assert not simulation.samples.any()
    simulation.keep_samples = True
    before = simulation.qpos.copy()
    episodes.step(push)
    assert_same(simulation.samples[0], before)
    assert_same(simulation.samples[-1], simulation.qpos)


def test_the_single_env_says_so_in_info() -> None:
    env = gymnasium.make("JacoPush-v0").unwrapped
    env.reset(seed=0)
    break_down(env.episodes, 0, "velocity")
    seen, reward, terminated, truncated, info = env.step(np.zeros(3))
    assert (terminated, truncated, info["diverged"]) == (False, True, True)
    assert seen in env.observation_space
    assert np.isfinite(reward)
    _, info = env.reset()
    assert not info["diverged"]
    for action in random_actions(3, 49, 1)[:, 0]:
        _, _, _, truncated, info = env.step(action)
        assert not truncated
        assert not info["diverged"]


def test_the_sb3_env_resets_it_at_once() -> None:
    env, untouched = SaverVecEnv("JacoPush-v0", 3, seed=0), SaverVecEnv("JacoPush-v0", 3, seed=0)
    env.reset()
    untouched.reset()
    break_down(env.episodes, 1, "velocity")
    action = random_actions(3, 1, 3)[0]
    seen, _, done, infos = env.step(action)
    then = untouched.step(action)[0]
    assert done.tolist() == [False, True, False]
    assert infos[1]["diverged"]
    assert infos[1]["TimeLimit.truncated"]
    assert set(infos[1]["terminal_observation"]) == set(seen)
    for name in seen:
        assert_same(seen[name][[0, 2]], then[name][[0, 2]])
    assert env.episodes.elapsed.tolist() == [1, 0, 1]
