"""`max_episode_steps` means one thing in every interface, and the specification tells it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.wrappers import TimeAwareObservation
from rollouts import ALL_IDS, assert_same, random_actions

from saver_advisors.learner.algorithms import episode_horizon
from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.envs.vector_env import SaverVectorEnv
from saver_envs.registration import ENVIRONMENTS, PIXELS

STEPS = 56  # beyond the task's horizon


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_the_specification_has_the_horizon(env_id: str) -> None:
    assert gymnasium.spec(env_id).max_episode_steps == ENVIRONMENTS[env_id].task.horizon


def test_so_has_that_of_pictures() -> None:
    for env_id, behind in PIXELS.items():
        horizon = ENVIRONMENTS[behind].task.horizon
        assert gymnasium.spec(env_id).max_episode_steps == horizon


def length_of(env: Any) -> int:
    """Steps of a single environment until it is truncated."""
    env.reset(seed=0)
    for step in range(1, 2 * STEPS):
        if env.step(np.zeros(env.action_space.shape))[3]:
            return step
    raise AssertionError("never truncated")


@pytest.mark.parametrize("steps", [None, 7, STEPS])
def test_make(steps: int | None) -> None:
    env = gymnasium.make("JacoPush-v0", max_episode_steps=steps)
    expected = steps or 50
    assert env.spec is not None
    assert env.spec.max_episode_steps == expected
    assert length_of(env) == expected
    assert length_of(gymnasium.make(env.spec)) == expected
    own = {} if steps is None else {"max_episode_steps": steps}
    assert length_of(SaverGoalEnv("JacoPush-v0", **own)) == expected


def test_time_aware_observations() -> None:
    made = gymnasium.make("JacoPush-v0", max_episode_steps=STEPS)
    env = TimeAwareObservation(made, flatten=False)
    env.reset(seed=0)
    for _ in range(STEPS):
        seen, _, _, truncated, _ = env.step(np.zeros(3))
    assert truncated
    assert seen["time"] == [STEPS]
    assert seen in env.observation_space


@pytest.mark.parametrize("mode", ["sync", "async", "vector_entry_point", None])
@pytest.mark.parametrize("steps", [None, STEPS])
def test_make_vec(mode: str | None, steps: int | None) -> None:
    more = {} if steps is None else {"max_episode_steps": steps}
    env = gymnasium.make_vec("JacoPush-v0", num_envs=2, vectorization_mode=mode, **more)
    env.reset(seed=0)
    truncations = [env.step(np.zeros((2, 3), np.float32))[3] for _ in range(steps or 50)]
    assert np.all(truncations, axis=1).tolist() == [False] * (len(truncations) - 1) + [True]
    env.close()


def test_pettingzoo_and_sb3() -> None:
    for name in ("max_episode_steps", "max_cycles"):
        arms = pettingzoo.make("parallel", "saver_envs/DualJacoPush-v0", **{name: STEPS})
        arms.reset(seed=0)
        steps = 0
        while arms.agents:
            arms.step({agent: np.zeros(3) for agent in arms.agents})
            steps += 1
        assert steps == STEPS
    batch = SaverVecEnv("JacoPush-v0", 2, seed=0, max_episode_steps=STEPS)
    batch.reset()
    ended = [batch.step(np.zeros((2, 3)))[2].all() for _ in range(STEPS)]
    assert ended == [False] * (STEPS - 1) + [True]
    assert episode_horizon(batch) == STEPS


def test_the_learner_asks_the_limit() -> None:
    from stable_baselines3.common.vec_env import DummyVecEnv

    made = DummyVecEnv([lambda: gymnasium.make("JacoPush-v0", max_episode_steps=STEPS)])
    assert episode_horizon(made) == STEPS


def test_pictures_too() -> None:
    env = gymnasium.make("WristPushPixels-v0", max_episode_steps=2)
    assert length_of(env) == 2
    env.close()


def test_single_and_vector_agree_beyond_the_horizon() -> None:
    single = gymnasium.make("JacoPush-v0", max_episode_steps=STEPS)
    vector = gymnasium.make_vec("JacoPush-v0", num_envs=1, max_episode_steps=STEPS)
    single.reset(seed=3)
    vector.reset(seed=3)
    for action in random_actions(3, STEPS, 1):
        one, other = single.step(action[0]), vector.step(action)
        assert_same(one[0]["observation"], other[0]["observation"][0])
        assert (one[1], one[3]) == (other[1][0], other[3][0])


def test_its_former_name_is_refused_with_the_new_one() -> None:
    with pytest.raises(TypeError, match=r"keyword argument 'horizon' \(it is 'max_episode_steps'"):
        gymnasium.make("JacoPush-v0", horizon=80)


def test_rated_episodes_that_end_too_early_are_said_to() -> None:
    """Gymnasium applies the registered limit, whatever the keywords are."""
    env = gymnasium.make("JacoPush-v0", rated=True)
    assert length_of(env) == 50
    with pytest.warns(UserWarning, match="pass max_episode_steps=125"):
        env.reset()
    with pytest.warns(UserWarning, match="pass max_episode_steps=125"):
        gymnasium.make_vec("JacoPush-v0", num_envs=2, rated=True)
    assert SaverVectorEnv("JacoPush-v0", 2, rated=True).episodes.settings.horizon == 125
