"""The parameters of an episode as a part of its observation, scaled to [-1, 1]."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from rollouts import assert_same, pickled_and_back, random_actions
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.vec_env import DummyVecEnv

from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.envs.vector_env import SaverVectorEnv
from saver_envs.wrappers.observe_parameters import (
    KEY,
    ObserveParameters,
    VectorObserveParameters,
)
from saver_envs.wrappers.sb3_observe_parameters import VecObserveParameters

PUSH, DUAL, WRISTS = "JacoPush-v0", "DualJacoPush-v0", "WristPush-v0"
HORIZON = 5
OPTIONS: dict[str, Any] = {"randomization": "wide", "max_episode_steps": HORIZON}


@pytest.mark.parametrize("env_id", [PUSH, "JacoPickAndPlace-v0", WRISTS])
def test_gymnasiums_checker_is_content(env_id: str) -> None:
    check_env(ObserveParameters(SaverGoalEnv(env_id, **OPTIONS)), skip_render_check=True)


@pytest.mark.parametrize("batched", [True, False])
def test_stable_baselines_learns_from_it_with_hindsight(batched: bool) -> None:
    venv = (
        VecObserveParameters(SaverVecEnv(PUSH, 2, **OPTIONS))
        if batched
        else DummyVecEnv([lambda: ObserveParameters(gymnasium.make(PUSH, **OPTIONS))] * 2)
    )
    settings: dict[str, Any] = {"learning_starts": 20, "buffer_size": 100, "batch_size": 8}
    buffer: Any = HerReplayBuffer
    model = SAC("MultiInputPolicy", venv, replay_buffer_class=buffer, **settings)
    model.learn(40)
    batch = model.replay_buffer.sample(30)  # type: ignore[union-attr]
    parameters = batch.observations[KEY].numpy()  # type: ignore[index]
    assert np.abs(parameters).max() <= 1
    # In an episode they stay the same, its last observation included.
    assert_same(parameters, batch.next_observations[KEY].numpy())  # type: ignore[index]


def test_the_space_is_bounded() -> None:
    env = ObserveParameters(gymnasium.make(DUAL, **OPTIONS))
    assert isinstance(env.observation_space, spaces.Dict)
    space = env.observation_space[KEY]
    # 6 of the cubes and the table, a tool point of 3 an arm, two camera's 3, and 6 more.
    assert space == spaces.Box(-1.0, 1.0, (6 + 2 * 3 + 2 * 3 + 7,), np.float32)
    plain = gymnasium.make(DUAL).observation_space
    assert isinstance(plain, spaces.Dict)
    assert set(env.observation_space) == {*plain, KEY}


def test_values_are_scaled_between_the_ends() -> None:
    """In the order of the parameters; one that is always the same is 0."""
    varied = {
        "max_speed": 0.3,
        "object_size": [0.04, 0.08],
        "tool_offset": [-0.004, 0.004],
        "action_delay": {"choice": [0, 1, 2]},
    }
    env = ObserveParameters(gymnasium.make(PUSH, randomization=varied, report_parameters=True))
    found = []
    for seed in range(12):
        observation, info = env.reset(seed=seed)
        drawn = info["parameters"]
        assert list(drawn) == ["object_size", "tool_offset", "max_speed", "action_delay"]
        expected = [
            (drawn["object_size"] - 0.06) / 0.02,
            *(drawn["tool_offset"] / 0.004),
            0.0,
            drawn["action_delay"] - 1,
        ]
        assert observation[KEY].dtype == np.float32
        np.testing.assert_allclose(observation[KEY], expected, atol=1e-6)
        assert observation in env.observation_space
        stepped = env.step(env.action_space.sample())[0]
        assert_same(stepped[KEY], observation[KEY])
        found.append(observation[KEY])
    assert set(np.array(found)[:, 5]) == {-1.0, 0.0, 1.0}


def test_it_is_recorded_in_the_specification() -> None:
    env = ObserveParameters(gymnasium.make(PUSH, **OPTIONS))
    assert env.spec is not None
    again = gymnasium.make(pickled_and_back(env.spec))
    assert_same(env.reset(seed=3)[0], again.reset(seed=3)[0])
    assert KEY in again.reset()[0]
    assert gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json()))


def test_it_can_be_pickled_within_an_episode() -> None:
    env = ObserveParameters(SaverGoalEnv(PUSH, **OPTIONS))
    env.reset(seed=1)
    action = np.ones(3, np.float32)
    env.step(action)
    copied = pickled_and_back(env)
    assert_same(env.step(action), copied.step(action))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_vector_gives_what_single_ones_give(mode: AutoresetMode) -> None:
    ours = VectorObserveParameters(SaverVectorEnv(DUAL, 3, autoreset_mode=mode, **OPTIONS))
    theirs = SyncVectorEnv(
        [lambda: ObserveParameters(SaverGoalEnv(DUAL, **OPTIONS))] * 3, autoreset_mode=mode
    )
    assert ours.single_observation_space == theirs.single_observation_space
    assert ours.observation_space == theirs.observation_space
    assert_same(ours.reset(seed=2), theirs.reset(seed=2))
    for action in random_actions(6, 3 * HORIZON, 3):
        one, other = ours.step(action), theirs.step(action)
        assert one[0] in ours.observation_space
        finals = [result[4].pop("final_obs", np.empty(0)).tolist() for result in (one, other)]
        assert_same(*finals)
        assert_same(one, other)
        if mode is AutoresetMode.DISABLED and one[3].any():
            mask = one[3].copy()  # Gymnasium's own takes it out of the options
            seen = [env.reset(options={"reset_mask": mask})[0] for env in (ours, theirs)]
            assert_same(*seen)


def test_the_batch_of_stable_baselines_gives_what_single_ones_give() -> None:
    batch = VecObserveParameters(SaverVecEnv(DUAL, 3, seed=2, **OPTIONS))
    singles = [ObserveParameters(SaverGoalEnv(DUAL, **OPTIONS)) for _ in range(3)]
    assert batch.observation_space == singles[0].observation_space
    seen: Any = batch.reset()
    alone = [env.reset(seed=2 + row)[0] for row, env in enumerate(singles)]
    for action in random_actions(6, 3 * HORIZON, 3):
        for row, one in enumerate(alone):
            assert_same({name: values[row] for name, values in seen.items()}, one)
        seen, _, dones, infos = batch.step(action)
        for row, env in enumerate(singles):
            alone[row], _, _, over, _ = env.step(action[row])
            assert over == dones[row]
            if over:
                assert_same(infos[row]["terminal_observation"], alone[row])
                alone[row] = env.reset()[0]
    chosen: Any = batch.reset_episodes([7, 8, 9])
    assert_same(chosen[KEY][0], singles[0].reset(seed=7)[0][KEY])


def test_what_has_no_parameters_is_refused() -> None:
    with pytest.raises(ValueError, match="randomization='none': nothing varies"):
        ObserveParameters(gymnasium.make(PUSH))
    with pytest.raises(ValueError, match="choose another one when the environment is made"):
        VectorObserveParameters(SaverVectorEnv(PUSH, 2))
    with pytest.raises(ValueError, match="nothing varies"):
        VecObserveParameters(SaverVecEnv(PUSH, 2))
    with pytest.raises(TypeError, match="must be an environment of saver_envs"):
        ObserveParameters(gymnasium.make("Pendulum-v1"))
