"""The single environment: what Gymnasium, SB3 and their users hold it to."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st
from rollouts import (
    ALL_IDS,
    CUBE_IDS,
    FEW_IDS,
    SPARSE_IDS,
    assert_same,
    begun,
    cubes_of,
    objects_of,
    pickled_and_back,
    random_actions,
)
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.envs.parallel_env import SaverParallelEnv
from saver_envs.envs.pixel_env import SaverPixelEnv
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.people.contact_forces import FORCE_COSTS, TORQUE_COSTS
from saver_envs.registration import ENVIRONMENTS, default_options
from saver_envs.tasks.arm_straighten import ArmStraighten
from saver_envs.tasks.intake import Intake
from saver_envs.tasks.log_roll import LogRoll


def quiet() -> Any:
    """Filter the checkers' advice on infinite boxes, which goals and velocities need."""
    warnings.filterwarnings("ignore", message=".*(infinity|infinite|Infinity|inf).*")


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_gymnasium_checker(env_id: str) -> None:
    env = gymnasium.make(env_id)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        quiet()
        check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("env_id", ALL_IDS)
def test_sb3_checker(env_id: str) -> None:
    env = gymnasium.make(env_id)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        quiet()
        sb3_check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_sizes_are_those_of_the_table(env_id: str) -> None:
    sizes = {
        "JacoPush-v0": (28, 3, 3),
        "JacoPickAndPlace-v0": (28, 4, 3),
        "DualJacoPush-v0": (56, 6, 6),
        "DualJacoPickAndPlace-v0": (56, 8, 6),
        "DualJacoDistance-v0": (56, 8, 7),
        "DualJacoCarry-v0": (52, 8, 6),
        "ArmStraighten-v0": (76, 8, 8),
        "LegStraighten-v0": (88, 6, 8),
        "Intake-v0": (80, 6, 4),
        "LogRoll-v0": (66, 6, 2),
        "WristPush-v0": (56, 6, 6),
    }
    jaco = env_id.replace("Mico", "Jaco")
    env = gymnasium.make(env_id)
    observation, action, goal = sizes[jaco]
    space = env.observation_space
    assert isinstance(space, gymnasium.spaces.Dict)
    assert {name: box.shape for name, box in space.items()} == {
        "observation": (observation,),
        "achieved_goal": (goal,),
        "desired_goal": (goal,),
    }
    assert all(box.dtype == np.float32 for box in space.values())
    assert env.action_space.shape == (action,)


@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_episode_api(env_id: str) -> None:
    """Truncated at the horizon and never terminated; success and costs in every info."""
    env = SaverGoalEnv(env_id, max_episode_steps=4)
    _, info = env.reset(seed=0)
    names = {"is_success", "safe_success", "goal_reached", "object_lost", "diverged"}
    names |= {"cost", "cost_collision"}
    names |= {"cost_distance"} if "Distance" in env_id else set()
    names |= {"tilt", "cost_tilt", "cost_dropped"} if "Carry" in env_id else set()
    if "LogRoll" in env_id:
        names |= {"twist", "head", "way", *FORCE_COSTS, *TORQUE_COSTS}
        names |= {f"cost_{name}" for name in LogRoll.costs}
    if "Straighten" in env_id:
        names |= {*FORCE_COSTS, *TORQUE_COSTS}
        names |= {f"cost_{name}" for name in ArmStraighten.costs}
    if "Intake" in env_id:
        names |= {*FORCE_COSTS, *TORQUE_COSTS}
        names |= {f"cost_{name}" for name in Intake.costs}
    if "Wrist" in env_id:
        names |= {"torso_force", "torso_displacement"}
        names |= {"cost_torso_force", "cost_torso_displacement"}
    assert set(info) == names
    assert not info["is_success"]
    for step in range(1, 5):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space
        assert reward in (-1.0, 0.0)
        assert isinstance(reward, float)
        assert terminated is False
        assert truncated is (step == 4)
        assert set(info) == names
        assert info["cost"] in (0.0, 1.0)


def test_the_distance_task_counts_its_own_cost() -> None:
    env = gymnasium.make("DualJacoDistance-v0")
    env.reset(seed=0)
    for action in random_actions(8, 50, 1)[:, 0]:
        info = env.step(action)[4]
        assert info["cost"] == info["cost_distance"]
    env = gymnasium.make("DualJacoPush-v0")
    env.reset(seed=0)
    for action in random_actions(6, 50, 1)[:, 0]:
        info = env.step(action)[4]
        assert info["cost"] == info["cost_collision"]


@pytest.mark.parametrize("env_id", FEW_IDS)
def test_the_same_seed_gives_the_same_episode_after_a_second_reset(env_id: str) -> None:
    env = gymnasium.make(env_id)

    def episode(seed: int | None) -> list[Any]:
        steps: list[Any] = [env.reset(seed=seed)]
        return steps + [env.step(action) for action in actions]

    actions = random_actions(env.action_space.shape[0], 12, 1)[:, 0]
    first, second = episode(3), episode(None)
    assert_same([first, second], [episode(3), episode(None)])
    goals = [steps[0][0]["desired_goal"] for steps in (first, second, episode(4))]
    assert not np.array_equal(goals[0], goals[1])
    assert not np.array_equal(goals[0], goals[2])


@pytest.mark.parametrize("env_id", FEW_IDS)
def test_observations_are_no_views(env_id: str) -> None:
    """What a user does to a returned array changes nothing that follows."""
    env, untouched = gymnasium.make(env_id), gymnasium.make(env_id)
    actions = random_actions(env.action_space.shape[0], 6, 1)[:, 0]
    observation, _ = env.reset(seed=1)
    untouched.reset(seed=1)
    kept = []
    for action in actions:
        for values in observation.values():
            values[:] = np.nan
        sent = action.copy()
        result = env.step(sent)
        sent[:] = np.nan
        observation = result[0]
        kept.append((observation["observation"], observation["observation"].copy()))
        assert_same(result, untouched.step(action))
        observation = copy.deepcopy(observation)
    for handed_out, copied in kept:
        np.testing.assert_array_equal(handed_out, copied)


@pytest.mark.parametrize("env_id", CUBE_IDS)
def test_orientation_has_a_positive_real_part(env_id: str) -> None:
    """Also when the cube lies on its head, where the simulation's own quaternion has w < 0."""
    episodes = begun(env_id, 4)
    simulation = episodes.simulation
    turned = [(1, 0, 0, 0), (-0.5, 0.5, 0.5, 0.5), (-1, 0, 0, 0), (0, 0, 1, 0)]
    for row, quaternion in enumerate(turned):
        simulation.qpos[row, cubes_of(episodes).qpos[:, 3:]] = quaternion
    simulation.refresh()
    state = objects_of(episodes)
    assert (state.quaternion[..., 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(state.quaternion, axis=-1), 1)
    np.testing.assert_allclose(state.quaternion[1, 0], (0.5, -0.5, -0.5, -0.5))
    episodes.step(np.zeros((4, episodes.action_size)))
    blocks = episodes.observation().observation.reshape(4, -1, 28)
    assert (blocks[..., 18] >= 0).all()


@pytest.mark.parametrize("env_id", FEW_IDS)
@pytest.mark.parametrize("bad", ["shape", "nan", "inf", "scalar", "complex", "text", "object"])
def test_bad_actions_change_nothing(env_id: str, bad: str) -> None:
    env = gymnasium.make(env_id).unwrapped
    assert isinstance(env, SaverGoalEnv)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    size = env.action_space.shape[0]
    actions: dict[str, Any] = {
        "shape": np.zeros(size + 1),
        "nan": np.full(size, np.nan),
        "inf": np.concatenate([np.zeros(size - 1), [np.inf]]),
        "scalar": 0.5,
        "complex": np.full(size, 0.5 + 0.5j),
        "text": np.full(size, "0.5"),
        "object": [None] * size,
    }
    before, seen = env.episodes.get_state(), env.episodes.observation()
    with pytest.raises(ValueError, match=r"(?s)action.*(shape|finite|real numbers)"):
        env.step(actions[bad])
    after = env.episodes.get_state()
    assert_same(before.simulation, after.simulation)
    assert_same(before.changing, after.changing)
    assert_same(vars(seen), vars(env.episodes.observation()))


@pytest.mark.parametrize("env_id", FEW_IDS)
def test_actions_out_of_range_are_clipped(env_id: str) -> None:
    env, clipped = gymnasium.make(env_id).unwrapped, gymnasium.make(env_id).unwrapped
    env.reset(seed=0)
    clipped.reset(seed=0)
    for action in random_actions(env.action_space.shape[0], 10, 1)[:, 0] * 3:
        assert_same(env.step(action), clipped.step(np.clip(action, -1, 1)))


def test_unknown_keywords_ids_and_modes_list_the_valid_ones() -> None:
    with pytest.raises(TypeError, match="did you mean 'object_size'") as keyword:
        gymnasium.make("JacoPush-v0", objectsize=0.05)
    for name in default_options("JacoPush-v0"):
        assert name in str(keyword.value)
    with pytest.raises(ValueError, match="did you mean 'JacoPush-v0'") as unknown:
        SaverGoalEnv("JacoPushh-v0")
    for env_id in ENVIRONMENTS:
        assert env_id in str(unknown.value)
    with pytest.raises(ValueError, match="human, rgb_array, depth_array"):
        SaverGoalEnv("JacoPush-v0", render_mode="ansi")
    with pytest.raises(ValueError, match="three_quarter"):
        SaverGoalEnv("JacoPush-v0", camera_name="nowhere")


@pytest.mark.parametrize("env_id", FEW_IDS)
@pytest.mark.parametrize("how", ["pickle", "deepcopy"])
def test_copies_made_in_mid_episode_go_on_identically(env_id: str, how: str) -> None:
    env = gymnasium.make(env_id, max_episode_steps=20)
    env.action_space.seed(1)
    env.reset(seed=5)
    for _ in range(7):
        env.step(env.action_space.sample())
    twin = pickled_and_back(env) if how == "pickle" else copy.deepcopy(env)
    assert twin.spec == env.spec
    for _ in range(60):
        action, same = env.action_space.sample(), twin.action_space.sample()
        np.testing.assert_array_equal(action, same)
        result = env.step(action)
        assert_same(result, twin.step(action))
        if result[3]:
            assert_same(env.reset(), twin.reset())  # random numbers go on as well


def test_copies_are_independent() -> None:
    env = gymnasium.make("JacoPush-v0").unwrapped
    env.reset(seed=0)
    twin = copy.deepcopy(env)
    before = env.episodes.get_state().simulation
    twin.step(np.ones(3))
    twin.reset(seed=9)
    np.testing.assert_array_equal(before, env.episodes.get_state().simulation)


def test_going_back_to_a_state_twice_repeats_it() -> None:
    episodes = begun("DualJacoPickAndPlace-v0", 3, max_episode_steps=10)
    state = episodes.get_state()

    def play() -> list[Any]:
        episodes.set_state(state)
        seen = []
        for action in random_actions(8, 15, 3):
            outcome = episodes.step(action)
            if outcome.truncated.any():
                episodes.reset(np.flatnonzero(outcome.truncated))
            seen.append((vars(episodes.observation()), outcome.reward, outcome.cost))
        return seen

    assert_same(play(), play())
    with pytest.raises(ValueError, match="shape"):
        begun("DualJacoPickAndPlace-v0", 2).set_state(state)


@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_specs_can_be_pickled_and_made_again(env_id: str) -> None:
    env = gymnasium.make(env_id, max_episode_steps=7, max_speed=0.3)
    again = gymnasium.make(pickled_and_back(env.spec))
    assert again.unwrapped.episodes.settings == env.unwrapped.episodes.settings
    assert gymnasium.make(copy.deepcopy(env.spec)).spec == env.spec


@given(
    st.sampled_from([np.float32, np.float64, np.int16, np.complex64, "U3", object, np.bool_]),
    st.lists(st.integers(0, 5), max_size=3),
    st.floats(width=32),
)
def test_actions_are_applied_or_refused(kind: Any, shape: list[int], value: float) -> None:
    env = SHARED_ENV
    env.reset(seed=0)
    with np.errstate(all="ignore"):
        action = np.full(shape, value).astype(kind)
    valid = tuple(shape) == (3,) and action.dtype.kind in "fib" and bool(np.isfinite(action).all())
    before = env.episodes.get_state().simulation
    if not valid:
        with pytest.raises(ValueError, match="action"):
            env.step(action)
        assert_same(before, env.episodes.get_state().simulation)
        return
    observation, reward, *_ = env.step(action)
    assert observation in env.observation_space
    assert np.isfinite(reward)


SHARED_ENV = SaverGoalEnv("JacoPush-v0")
GOALS = st.sampled_from([(), (2,), (3,), (4,), (5, 3), (0, 3), (3, 5), (2, 2, 3)])


@given(GOALS, GOALS, st.sampled_from([np.float32, np.int8, np.complex128, "U2", object]))
def test_goals_of_another_size_are_refused(
    achieved: tuple[int, ...], desired: tuple[int, ...], kind: Any
) -> None:
    first, second = np.zeros(achieved), np.ones(desired).astype(kind)
    valid = achieved[-1:] == desired[-1:] == (3,) and second.dtype.kind in "fi"
    try:
        together = np.broadcast_shapes(achieved, desired)
    except ValueError:
        valid = False
    if valid:
        assert SHARED_ENV.compute_reward(first, second, {}).shape == together[:-1]
    else:
        with pytest.raises(ValueError, match=r"_goal(\.shape)?=|broadcast"):
            SHARED_ENV.compute_reward(first, second, {})


@pytest.mark.parametrize(
    "make",
    [
        lambda: SaverGoalEnv("JacoPush-v0"),
        lambda: SaverPixelEnv("WristPush-v0"),
        lambda: gymnasium.make("JacoPush-v0").unwrapped,
        lambda: gymnasium.make_vec("JacoPush-v0", num_envs=2),
        lambda: SaverVecEnv("JacoPush-v0", 2),
        lambda: SaverParallelEnv("DualJacoPush-v0"),
    ],
)
def test_a_step_before_the_first_reset_is_refused(make: Any) -> None:
    """Also by a copy; after the reset both go on."""
    env = make()
    arms = isinstance(env, SaverParallelEnv)
    action: Any = {one: np.zeros(3) for one in env.possible_agents} if arms else None
    action = np.zeros(env.action_space.shape) if action is None else action
    if isinstance(env, SaverVecEnv):
        action = np.zeros((2, 3))
    for one in (env, copy.deepcopy(env)):
        with pytest.raises(ResetNeeded, match=r"Cannot call env.step\(\) before calling env.reset"):
            one.step(action)
    for one in () if isinstance(env, SaverPixelEnv) else (env, copy.deepcopy(env)):
        one.reset()
        one.step(action)
    env.close()


@pytest.mark.parametrize("env_id", [*SPARSE_IDS, "WristPushPixels-v0"])
def test_model_and_data_are_those_of_the_episode(env_id: str) -> None:
    env = gymnasium.make(env_id).unwrapped
    episodes = env.episodes
    for step in range(3):
        episodes.reset() if step == 0 else episodes.step(np.zeros((1, episodes.action_size)))
        np.testing.assert_array_equal(env.data.qpos, episodes.simulation.qpos[0])
        np.testing.assert_array_equal(env.data.qvel, episodes.simulation.qvel[0])
    assert env.model.nq == len(env.data.qpos)
    env.data.qpos[:] = 7
    assert (episodes.simulation.qpos != 7).all()
