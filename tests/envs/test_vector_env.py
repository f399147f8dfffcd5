"""The vector environment: Gymnasium's vector API, and the single environment n times over."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from rollouts import (
    FEW_IDS,
    SPARSE_IDS,
    assert_same,
    info_row,
    pickled_and_back,
    random_actions,
    row_of,
)

from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.envs.vector_env import SaverVectorEnv


def made(env_id: str, num_envs: int, **kwargs: Any) -> SaverVectorEnv:
    env = gymnasium.make_vec(env_id, num_envs=num_envs, **kwargs)
    assert isinstance(env, SaverVectorEnv)
    return env


@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_make_vec(env_id: str) -> None:
    env = made(env_id, 2, vectorization_mode="vector_entry_point", max_episode_steps=3)
    observation, infos = env.reset(seed=0)
    assert observation in env.observation_space
    assert env.single_observation_space == gymnasium.make(env_id).observation_space
    assert env.action_space.shape == (2, *env.single_action_space.shape)
    assert infos["_is_success"].all()
    for step in range(1, 4):
        observation, reward, terminated, truncated, infos = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert reward.shape == terminated.shape == truncated.shape == (2,)
        assert reward.dtype == np.float64
        assert not terminated.any()
        assert (truncated == (step == 3)).all()
    again = gymnasium.make_vec(pickled_and_back(env.spec))
    assert again.num_envs == 2
    assert again.unwrapped.episodes.settings.horizon == 3
    env.close()


def test_metadata_belongs_to_the_instance() -> None:
    names = {"NextStep": "NEXT_STEP", "SameStep": "SAME_STEP", "Disabled": "DISABLED"}
    envs = {value: made("JacoPush-v0", 1, autoreset_mode=value) for value in names}
    for value, env in envs.items():
        assert env.metadata["autoreset_mode"] is AutoresetMode(value)
        assert SaverVectorEnv.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        by_name = SaverVectorEnv("JacoPush-v0", autoreset_mode=names[value])
        assert by_name.autoreset_mode is AutoresetMode(value)
    with pytest.raises(ValueError, match="'NextStep', 'SameStep', 'Disabled'"):
        made("JacoPush-v0", 1, autoreset_mode="sometimes")


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("env_id", FEW_IDS)
def test_conforms_to_gymnasiums_own_vector_of_single_envs(env_id: str, mode: AutoresetMode) -> None:
    """Every observation, reward, flag and info, bit for bit, in every automatic reset mode."""
    n, horizon = 3, 8
    ours = made(env_id, n, max_episode_steps=horizon, autoreset_mode=mode)
    single = SaverGoalEnv(env_id, max_episode_steps=horizon)
    theirs = SyncVectorEnv([lambda: copy.deepcopy(single)] * n, autoreset_mode=mode)
    assert_same(ours.reset(seed=7), theirs.reset(seed=7))
    assert ours.action_space == theirs.action_space
    assert ours.observation_space == theirs.observation_space
    for action in random_actions(ours.single_action_space.shape[0], 3 * horizon, n):
        one, other = ours.step(action), theirs.step(action)
        finals = [result[4].pop("final_obs", np.empty(0)).tolist() for result in (one, other)]
        assert_same(*finals)
        assert_same(one, other)
        if mode is AutoresetMode.DISABLED and one[3].any():
            options = {"reset_mask": one[3]}
            assert_same(
                ours.reset(options=dict(options))[0], theirs.reset(options=dict(options))[0]
            )


@pytest.mark.slow
@pytest.mark.parametrize("env_id", FEW_IDS)
def test_equals_three_single_envs_over_200_steps(env_id: str) -> None:
    ours = made(env_id, 3, autoreset_mode="SameStep")
    singles = [SaverGoalEnv(env_id) for _ in range(3)]
    observation, infos = ours.reset(seed=20)
    for index, env in enumerate(singles):
        alone, info = env.reset(seed=20 + index)
        assert_same(row_of(observation, index), alone)
        assert_same(info_row(infos, index), info)
    for action in random_actions(ours.single_action_space.shape[0], 200, 3):
        observation, reward, _, truncated, infos = ours.step(action)
        for index, env in enumerate(singles):
            alone, value, _, over, info = env.step(action[index])
            assert (reward[index], truncated[index]) == (value, over)
            if over:
                assert_same(infos["final_obs"][index], alone)
                assert_same(info_row(infos["final_info"], index), info)
                alone, info = env.reset()
            assert_same(row_of(observation, index), alone)
            assert all(info[name] == infos[name][index] for name in info)


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_results(threads: int) -> None:
    one, several = made("DualJacoPush-v0", 5), made("DualJacoPush-v0", 5, threads=threads)
    assert_same(one.reset(seed=0), several.reset(seed=0))
    for action in random_actions(6, 20, 5):
        assert_same(one.step(action), several.step(action))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_episodes_out_of_phase_after_a_divergence(mode: AutoresetMode) -> None:
    """One episode breaks down: it is reset by itself, and the others never notice."""
    n, horizon, broken_at, broken = 3, 9, 4, 1
    ours = made("JacoPush-v0", n, max_episode_steps=horizon, autoreset_mode=mode)
    single = SaverGoalEnv("JacoPush-v0", max_episode_steps=horizon)
    theirs = SyncVectorEnv([lambda: copy.deepcopy(single)] * n, autoreset_mode=mode)
    ours.reset(seed=3)
    theirs.reset(seed=3)
    truncations = []
    for step, action in enumerate(random_actions(3, 32, n)):
        if step == broken_at:
            ours.episodes.simulation.qvel[broken, 0] = np.nan
            theirs.envs[broken].unwrapped.episodes.simulation.qvel[0, 0] = np.nan
        one, other = ours.step(action), theirs.step(action)
        for result in (one, other):
            result[4].pop("final_obs", None)
        assert_same(one, other, f"step {step}")
        assert all(np.isfinite(values).all() for values in one[0].values())
        truncations.append(one[3])
        if mode is AutoresetMode.DISABLED and one[3].any():
            mask = {"reset_mask": one[3]}
            assert_same(ours.reset(options=dict(mask))[0], theirs.reset(options=dict(mask))[0])
    over = np.array(truncations)
    assert over[broken_at].tolist() == [False, True, False]
    period = horizon + (mode is AutoresetMode.NEXT_STEP)
    assert np.flatnonzero(over[:, 0]).tolist() == list(range(horizon - 1, 32, period))
    first = broken_at + period
    assert np.flatnonzero(over[:, broken]).tolist()[1:] == list(range(first, 32, period))


def test_masked_resets_leave_the_others_alone() -> None:
    env = made("JacoPickAndPlace-v0", 3, autoreset_mode="Disabled")
    before, _ = env.reset(seed=[5, None, 7])
    mask = np.array([False, True, False])
    after, infos = env.reset(seed=[1, 5, 1], options={"reset_mask": mask})
    assert_same(row_of(after, 0), row_of(before, 0))
    assert_same(row_of(after, 2), row_of(before, 2))
    assert_same(row_of(after, 1), row_of(before, 0))
    assert infos["_is_success"].tolist() == mask.tolist()
    for bad, error in ((np.array([1, 0, 0]), TypeError), (np.zeros(3, bool), ValueError)):
        with pytest.raises(error, match="reset_mask"):
            env.reset(options={"reset_mask": bad})
    with pytest.raises(ValueError, match="2 seeds"):
        env.reset(seed=[1, 2])


def test_needs_resets() -> None:
    env = made("JacoPush-v0", 2, autoreset_mode="Disabled", max_episode_steps=1)
    with pytest.raises(ResetNeeded, match=r"\[0, 1\] have not begun"):
        env.step(np.zeros((2, 3)))
    env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match=r"\[1\] have not begun"):
        env.step(np.zeros((2, 3)))
    env.reset()
    env.step(np.zeros((2, 3)))
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ResetNeeded, match=r"\[1\] are over"):
        env.step(np.zeros((2, 3)))


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("bad", [np.zeros((2, 4)), np.zeros(3), np.full((2, 3), np.nan)])
def test_bad_actions_change_nothing(mode: AutoresetMode, bad: Any) -> None:
    env = made("JacoPush-v0", 2, autoreset_mode=mode, max_episode_steps=2)
    twin = copy.deepcopy(env)
    for one in (env, twin):
        one.reset(seed=0)
        one.step(np.ones((2, 3)))
        if mode is not AutoresetMode.DISABLED:
            one.step(np.ones((2, 3)))  # the next step begins new episodes
    with pytest.raises(ValueError, match=r"shape|finite"):
        env.step(bad)
    assert_same(env.episodes.get_state().simulation, twin.episodes.get_state().simulation)
    assert_same(env.step(np.ones((2, 3)))[:4], twin.step(np.ones((2, 3)))[:4])


def test_arrays_are_fresh() -> None:
    env = made("DualJacoPush-v0", 2)
    twin = copy.deepcopy(env)
    env.reset(seed=0)
    twin.reset(seed=0)
    for action in random_actions(6, 5, 2):
        result = env.step(action)
        assert_same(result, twin.step(action))
        arrays = [*result[0].values(), *result[1:4], *result[4].values()]
        assert len({id(values) for values in arrays}) == len(arrays)
        for first, values in enumerate(arrays):
            for other in arrays[first + 1 :]:
                assert not np.shares_memory(values, other)
            values[...] = 1


@pytest.mark.parametrize("how", ["pickle", "deepcopy"])
def test_copies_made_in_mid_episode_go_on_identically(how: str) -> None:
    env = made("DualJacoPickAndPlace-v0", 2, max_episode_steps=6)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    twin = pickled_and_back(env) if how == "pickle" else copy.deepcopy(env)
    for action in random_actions(8, 20, 2):
        assert_same(env.step(action), twin.step(action))
