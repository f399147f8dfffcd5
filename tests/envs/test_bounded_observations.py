"""`bounded_observations=True`: finite spaces, and values within them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rollouts import ALL_IDS, FEW_IDS, assert_same, begun, cubes_of, random_actions

from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.tasks.layout import LIMITS, Layout, Part


def finite(space: Any) -> bool:
    boxes = space.values() if isinstance(space, gymnasium.spaces.Dict) else [space]
    return all(np.isfinite([box.low, box.high]).all() for box in boxes)


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_spaces_are_finite_on_request_alone(env_id: str) -> None:
    assert finite(gymnasium.make(env_id, bounded_observations=True).observation_space)
    assert not finite(gymnasium.make(env_id).observation_space)


def test_in_every_interface() -> None:
    name, options = "DualJacoDistance-v0", {"bounded_observations": True}
    vector = gymnasium.make_vec(name, num_envs=2, **options)
    assert finite(vector.observation_space)
    assert vector.reset(seed=0)[0] in vector.observation_space
    batch = SaverVecEnv(name, 2, seed=0, **options)
    assert finite(batch.observation_space)
    arms = pettingzoo.make("parallel", f"saver_envs/{name}", **options)
    seen, _ = arms.reset(seed=0)
    assert finite(arms.state_space)
    assert arms.state() in arms.state_space
    for agent in arms.possible_agents:
        assert finite(arms.observation_space(agent))
        assert seen[agent] in arms.observation_space(agent)


@pytest.mark.parametrize("env_id", FEW_IDS)
def test_regular_episodes_are_not_clipped(env_id: str) -> None:
    bounded = gymnasium.make(env_id, bounded_observations=True)
    usual = gymnasium.make(env_id)
    assert_same(bounded.reset(seed=2), usual.reset(seed=2))
    for action in random_actions(bounded.action_space.shape[0], 50, 1)[:, 0]:
        result = bounded.step(action)
        assert_same(result, usual.step(action))
        assert result[0] in bounded.observation_space


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.tuples(*[st.floats(-1e5, 1e5)] * 6))
def test_whatever_flies_off_is_clipped_and_the_reward_belongs_to_it(
    position: tuple[float, ...], velocity: tuple[float, ...]
) -> None:
    episodes = begun("JacoPushDense-v0", 1, bounded_observations=True)
    cube = cubes_of(episodes)
    episodes.simulation.qpos[0, cube.qpos[0, :3]] = position
    episodes.simulation.qvel[0, cube.dof[0]] = velocity
    episodes.simulation.refresh()
    episodes._read()
    seen = episodes.observation()
    task = episodes.task
    for values, layout in (
        (seen.observation, task.observation_layout),
        (seen.achieved_goal, task.goal_layout),
        (seen.desired_goal, task.goal_layout),
    ):
        assert (np.abs(values) <= layout.limits.astype(np.float32)).all()
    reward = episodes._outcome(np.zeros(1, dtype=bool)).reward
    assert reward == task.reward(seen.achieved_goal, seen.desired_goal)


def test_limits_are_scaled_and_in_order() -> None:
    layout = Layout((Part("a", 2, "m/s", 0.2), Part("b", 1, "N", shared=True, limit=7.0)), 2)
    np.testing.assert_allclose(layout.limits, [LIMITS["m/s"] * 0.2] * 4 + [7.0])


def test_a_part_of_an_unknown_unit_needs_a_limit() -> None:
    with pytest.raises(ValueError, match=r"the part 'b' needs a limit, as its unit 'N'"):
        _ = Layout((Part("b", 1, "N"),), 1).limits
