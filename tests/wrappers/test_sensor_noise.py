"""Sensor errors: their size, what they leave alone, and the same in every adapter."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st
from saver_envs.wrappers.sb3_sensor_noise import NoisyVecSensors
from saver_envs.wrappers.sensor_noise import (
    NoisySensors,
    NoisyVectorSensors,
    SensorErrors,
    SensorNoise,
)

from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.envs.vector_env import SaverVectorEnv
from saver_envs.registration import make_episodes
from saver_envs.robots import ROBOTS
from saver_envs.tasks.arm_and_object import ARM_AND_OBJECT
from saver_envs.tasks.layout import Layout
from saver_envs.wrappers.finger_readings import translated_fingers

PICK, PUSH = "DualMicoPickAndPlace-v0", "DualMicoPush-v0"
HORIZON = 6


LAYOUT = Layout(ARM_AND_OBJECT, 2)


def slices() -> dict[str, slice]:
    """Where each part of an arm's block lies, from the table that the docs use."""
    found, start = {}, 0
    for part in ARM_AND_OBJECT:
        found[part.name] = slice(start, start + part.size)
        start += part.size
    return found


def exact(n: int, arms: int = 2) -> Any:
    """Observations (n, 28 * arms) that could be ones."""
    random = np.random.default_rng(0)
    blocks = random.normal(scale=0.2, size=(n, arms, 28))
    parts = slices()
    quaternion = parts["object orientation, a quaternion with w >= 0"]
    turn = random.normal(size=(n, arms, 4))
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    blocks[..., quaternion] = np.where(turn[..., :1] < 0, -turn, turn)
    position, tool = parts["object position"], parts["gripper position"]
    relative = parts["object position relative to the gripper"]
    blocks[..., relative] = blocks[..., position] - blocks[..., tool]
    return blocks.reshape(n, -1).astype(np.float32)


def errors(noise: SensorNoise, n: int, moving: bool = True) -> SensorErrors:
    """Seeded ones, begun."""
    made = SensorErrors(noise, n, LAYOUT, moving)
    for index in range(n):
        made.seed(index, index)
    made.begin(range(n))
    return made


def test_errors_have_the_size_that_they_are_given() -> None:
    noise, n = SensorNoise(), 4000
    before = exact(n)
    change = (errors(noise, n).disturb(before) - before).reshape(n, 2, 28)
    parts = slices()
    expected = {
        "gripper position": noise.tool_position,
        "gripper linear velocity": 0.2 * noise.tool_velocity,
        "finger positions": noise.finger_position,
        "finger velocities": 0.04 * noise.finger_velocity,
        "object position": np.hypot(noise.object_position, noise.object_offset),
        "object position relative to the gripper": np.linalg.norm(
            [noise.object_position, noise.object_offset, noise.tool_position]
        ),
        "object linear velocity": 0.2 * noise.object_velocity,
        "object angular velocity": 0.04 * noise.object_angular_velocity,
    }
    for name, deviation in expected.items():
        measured = change[..., parts[name]]
        assert measured.std() == pytest.approx(deviation, rel=0.05), name
        assert abs(measured.mean()) < deviation / 20, name


@settings(deadline=None, max_examples=30)
@given(factor=st.floats(0.0, 20.0), seed=st.integers(0, 2**31))
def test_what_is_read_stays_an_observation(factor: float, seed: int) -> None:
    """Unit quaternions with w >= 0, and a relative position that is the difference of the two."""
    before = exact(5)
    made = SensorErrors(SensorNoise().scaled(factor), 5, LAYOUT, True)
    for index in range(5):
        made.seed(index, seed + index)
    made.begin(range(5))
    after = made.disturb(before).reshape(5, 2, 28)
    parts = slices()
    quaternion = after[..., parts["object orientation, a quaternion with w >= 0"]]
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0, atol=1e-5)
    assert (quaternion[..., 0] >= 0).all()
    difference = after[..., parts["object position"]] - after[..., parts["gripper position"]]
    relative = after[..., parts["object position relative to the gripper"]]
    np.testing.assert_allclose(relative, difference, atol=1e-5)


def test_the_turn_of_the_object_is_as_large_as_it_is_said_to_be() -> None:
    noise = SensorNoise(object_orientation=0.2)
    before = exact(4000)
    part = slices()["object orientation, a quaternion with w >= 0"]
    first = before.reshape(-1, 28)[:, part]
    second = errors(noise, 4000).disturb(before).reshape(-1, 28)[:, part]
    angle = 2 * np.arccos(np.clip(np.abs((first * second).sum(axis=1)), 0, 1))
    # The length of a vector of three Gaussian components: sigma * sqrt(8 / pi) on average.
    assert angle.mean() == pytest.approx(0.2 * np.sqrt(8 / np.pi), rel=0.03)


def test_the_offset_stays_for_an_episode_and_is_drawn_anew() -> None:
    silent = dict.fromkeys(SensorNoise().__dict__, 0.0)
    made = errors(SensorNoise(**{**silent, "object_offset": 0.01}), 3)
    before = exact(3)
    first, second = made.disturb(before), made.disturb(before)
    np.testing.assert_array_equal(first, second)
    made.begin([1])
    third = made.disturb(before)
    np.testing.assert_array_equal(first[[0, 2]], third[[0, 2]])
    assert np.abs(first[1] - third[1]).max() > 1e-3


def test_no_noise_and_locked_fingers_leave_readings_alone() -> None:
    before = exact(3)
    nothing = errors(SensorNoise().scaled(0.0), 3).disturb(before)
    np.testing.assert_allclose(nothing, before, atol=1e-6)
    assert nothing is not before
    locked = errors(SensorNoise(), 3, moving=False).disturb(before).reshape(3, 2, 28)
    parts = slices()
    for name in ("finger positions", "finger velocities"):
        np.testing.assert_array_equal(
            locked[..., parts[name]], before.reshape(3, 2, 28)[..., parts[name]]
        )


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_impossible_deviations_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match=r"tool_position=.*: must be finite and at least 0"):
        SensorNoise(tool_position=value)


def actions(steps: int, n: int, size: int) -> Any:
    return np.random.default_rng(1).uniform(-1, 1, (steps, n, size)).astype(np.float32)


@pytest.mark.parametrize("env_id", [PUSH, PICK])
def test_the_same_errors_in_every_adapter(env_id: str) -> None:
    """Over the end of an episode and into the next one, with its last observation."""
    n, steps, seed = 2, HORIZON + 3, 11
    made = [NoisySensors(gymnasium.make(env_id, max_episode_steps=HORIZON)) for _ in range(n)]
    same = NoisyVectorSensors(
        SaverVectorEnv(env_id, n, max_episode_steps=HORIZON, autoreset_mode="SameStep")
    )
    sb3 = NoisyVecSensors(SaverVecEnv(env_id, n, max_episode_steps=HORIZON))
    sb3.seed(seed)
    singles = [env.reset(seed=seed + i)[0]["observation"] for i, env in enumerate(made)]
    vector, of_sb3 = same.reset(seed=seed)[0]["observation"], sb3.reset()["observation"]
    for action in actions(steps, n, made[0].action_space.shape[0]):
        np.testing.assert_array_equal(vector, np.stack(singles))
        np.testing.assert_array_equal(of_sb3, vector)
        results = [env.step(one) for env, one in zip(made, action, strict=True)]
        seen, _, _, truncated, infos = same.step(action)
        sb3_seen, _, dones, sb3_infos = sb3.step(action)
        np.testing.assert_array_equal(truncated, dones)
        for index, (result, env) in enumerate(zip(results, made, strict=True)):
            singles[index] = result[0]["observation"]
            if result[3]:
                last = infos["final_obs"][index]["observation"]
                np.testing.assert_array_equal(last, singles[index])
                of_sb3_last = sb3_infos[index]["terminal_observation"]["observation"]
                np.testing.assert_array_equal(of_sb3_last, singles[index])
                singles[index] = env.reset()[0]["observation"]
        vector, of_sb3 = seen["observation"], sb3_seen["observation"]
    assert truncated.dtype == bool


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_a_new_episode_has_a_new_offset(mode: AutoresetMode) -> None:
    silent = dict.fromkeys(SensorNoise().__dict__, 0.0)
    noise = SensorNoise(**{**silent, "object_offset": 0.01})
    env = NoisyVectorSensors(
        SaverVectorEnv(PUSH, 2, max_episode_steps=HORIZON, autoreset_mode=mode), noise
    )
    plain = SaverVectorEnv(PUSH, 2, max_episode_steps=HORIZON, autoreset_mode=mode)
    seen, exact_one = env.reset(seed=3)[0], plain.reset(seed=3)[0]
    part = slices()["object position"]
    offsets = [(seen["observation"] - exact_one["observation"])[:, part]]
    for action in actions(HORIZON + 1, 2, 6):
        if mode is AutoresetMode.DISABLED and len(offsets) == HORIZON + 1:
            chosen = {"reset_mask": np.array([True, False])}
            seen, exact_one = env.reset(options=chosen)[0], plain.reset(options=chosen)[0]
        else:
            seen, exact_one = env.step(action)[0], plain.step(action)[0]
        offsets.append((seen["observation"] - exact_one["observation"])[:, part])
    first, last = offsets[0], offsets[-1]
    np.testing.assert_allclose(offsets[HORIZON], first, atol=1e-6)
    assert np.abs(last[0] - first[0]).max() > 1e-4
    if mode is AutoresetMode.DISABLED:
        np.testing.assert_allclose(last[1], first[1], atol=1e-6)


def test_rewards_and_goals_stay_exact() -> None:
    noisy = NoisySensors(gymnasium.make(PUSH, max_episode_steps=HORIZON), SensorNoise().scaled(10))
    plain = gymnasium.make(PUSH, max_episode_steps=HORIZON)
    first, second = noisy.reset(seed=5)[0], plain.reset(seed=5)[0]
    for action in actions(HORIZON, 1, 6)[:, 0]:
        for key in ("achieved_goal", "desired_goal"):
            np.testing.assert_array_equal(first[key], second[key])
        first, reward, *_ = noisy.step(action)
        second, plain_reward, *_ = plain.step(action)
        assert reward == plain_reward
    assert np.abs(first["observation"] - second["observation"]).max() > 0


def test_gymnasiums_checker_is_content() -> None:
    env = NoisySensors(gymnasium.make(PICK, max_episode_steps=HORIZON).unwrapped, SensorNoise())
    check_env(env, skip_render_check=True)


def test_foreign_environments_are_refused() -> None:
    with pytest.raises(TypeError, match="must be an environment of saver_envs"):
        NoisySensors(gymnasium.make("Pendulum-v1"))


def test_fingers_read_as_those_of_the_other_hand() -> None:
    jaco, mico = ROBOTS["jaco"], ROBOTS["mico"]
    parts = slices()
    blocks = exact(3).reshape(3, 2, 28)
    blocks[0, :, parts["finger positions"]] = mico.finger_open
    blocks[1, :, parts["finger positions"]] = mico.finger_closed
    before = blocks.reshape(3, -1).copy()
    read = translated_fingers(before, LAYOUT, mico, jaco).reshape(3, 2, 28)
    np.testing.assert_allclose(read[0, :, parts["finger positions"]], jaco.finger_open, atol=1e-6)
    np.testing.assert_allclose(read[1, :, parts["finger positions"]], jaco.finger_closed, atol=1e-6)
    np.testing.assert_array_equal(before, blocks.reshape(3, -1))
    others = np.ones(28, bool)
    for name in ("finger positions", "finger velocities"):
        others[parts[name]] = False
    np.testing.assert_array_equal(read[..., others], blocks[..., others])
    there = translated_fingers(before, LAYOUT, mico, jaco)
    there_and_back = translated_fingers(there, LAYOUT, jaco, mico)
    np.testing.assert_allclose(there_and_back, before, atol=1e-6)


def test_the_locked_hands_of_a_push_read_as_in_training() -> None:
    """What the translation is for: the same constant as in the Jaco's observations."""
    read = []
    for env_id in (PUSH, "DualJacoPush-v0"):
        episodes = make_episodes(env_id)
        episodes.reset()
        read.append(episodes.observation().observation)
    part = slices()["finger positions"]
    translated = translated_fingers(read[0], LAYOUT, ROBOTS["mico"], ROBOTS["jaco"])
    np.testing.assert_allclose(
        translated.reshape(2, 28)[:, part], read[1].reshape(2, 28)[:, part], atol=1e-6
    )
    assert np.abs(read[0] - read[1]).reshape(2, 28)[:, part].min() > 0.1
