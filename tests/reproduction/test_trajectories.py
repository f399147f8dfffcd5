"""Recorded trials are the episodes of an evaluation, told exactly whatever the sensors say."""

from __future__ import annotations

from typing import Any

import numpy as np

from reproduction.transfer.trajectories import run_trials
from saver_advisors.evaluation.episodes import evaluate_policy
from saver_envs.envs.sb3_vec_env import SaverVecEnv
from saver_envs.robots import ROBOTS
from saver_envs.tasks.arm_and_object import ARM_AND_OBJECT
from saver_envs.tasks.layout import Layout
from saver_envs.wrappers.finger_readings import translated_fingers

PUSH, PICK = "DualMicoPush-v0", "DualMicoPickAndPlace-v0"
OPTIONS = {"max_episode_steps": 12, "randomization": {"object_size": 0.07}}
NOISY = {"max_episode_steps": 12, "randomization": {"object_size": 0.07, "sensor_noise": 1.0}}
LAYOUT = Layout(ARM_AND_OBJECT, 2)


def follow(observation: Any) -> Any:
    """Towards the object, each row by itself; the gripper closes where there is one."""
    blocks = observation["observation"].reshape(len(observation["observation"]), 2, 28)
    motion = np.clip(8 * blocks[..., 15:18], -1, 1)
    goal = observation["desired_goal"].shape[1]
    assert goal == 6
    return motion.reshape(len(blocks), -1).astype(np.float32)


def grasp(observation: Any) -> Any:
    """The same with a closed gripper on arm 1."""
    motion = follow(observation).reshape(-1, 2, 3)
    gripper = np.broadcast_to(np.array([[[1.0], [-1.0]]], np.float32), (len(motion), 2, 1))
    return np.concatenate([motion, gripper], axis=-1).reshape(len(motion), -1)


def test_trials_are_the_episodes_of_an_evaluation() -> None:
    trials = run_trials(follow, PUSH, 5, seed=3, env_kwargs=OPTIONS)
    outcomes = evaluate_policy(follow, PUSH, episodes=5, seed=3, env_kwargs=OPTIONS)
    assert [one.success for one in trials] == outcomes.success.tolist()
    np.testing.assert_allclose(
        [one.distance[-1] for one in trials], outcomes.final_distances, atol=1e-6
    )
    collisions = [int(one.collided.sum()) for one in trials]
    assert collisions == outcomes.cost_sums["cost_collision"].astype(int).tolist()
    for one in trials:
        assert one.tool.shape == one.object.shape == (13, 2, 3)
        assert one.object_speed.shape == (13, 2)
        assert (one.steps, one.object_size, one.threshold, one.reach) == (12, 0.07, 0.05, 0.48)
        assert not one.closing.any()


def test_what_is_recorded_is_the_true_state_and_not_the_noisy_observation() -> None:
    told: list[Any] = []

    def spy(observation: Any) -> Any:
        told.append(observation["observation"].copy())
        return follow(observation)

    trials = run_trials(spy, PUSH, 3, seed=8, env_kwargs=NOISY)
    env = SaverVecEnv(PUSH, 3, **NOISY)
    observation = env.reset_episodes([8, 9, 10])
    for step, seen in enumerate(told):
        np.testing.assert_array_equal(seen, observation["observation"])
        # The achieved goals are exact.
        true = np.stack([one.object[step].ravel() for one in trials])
        np.testing.assert_array_equal(true.astype(np.float32), observation["achieved_goal"])
        observation = env.step(follow(observation))[0]
    first = told[0].reshape(3, 2, 28)[..., 12:15]
    errors = np.abs(np.stack([one.object[0] for one in trials]) - first)
    assert 1e-4 < errors.max() < 0.05


def test_conditions_with_cubes_of_one_size_have_the_same_starts() -> None:
    different = {"object_friction": 0.1, "sensor_noise": 1.0}
    slippery = {"max_episode_steps": 12, "randomization": different}
    usual = run_trials(follow, PUSH, 4, seed=8, env_kwargs={"max_episode_steps": 12})
    changed = run_trials(follow, PUSH, 4, seed=8, env_kwargs=slippery)
    for one, other in zip(usual, changed, strict=True):
        np.testing.assert_array_equal(one.target, other.target)
        np.testing.assert_allclose(one.object[0], other.object[0], atol=1e-9)
    ends = [np.stack([one.object[-1] for one in trials]) for trials in (usual, changed)]
    assert (ends[0] != ends[1]).any()


def test_the_policy_reads_the_hand_that_it_knows() -> None:
    told: list[Any] = []

    def spy(observation: Any) -> Any:
        told.append(observation["observation"].copy())
        return grasp(observation)

    jaco, mico = ROBOTS["jaco"], ROBOTS["mico"]
    trials = run_trials(spy, PICK, 2, env_kwargs={"max_episode_steps": 4}, hand=jaco)
    translated, told[:] = list(told), []
    run_trials(spy, PICK, 2, env_kwargs={"max_episode_steps": 4}, hand=mico)
    np.testing.assert_array_equal(translated[0], translated_fingers(told[0], LAYOUT, mico, jaco))
    for one in trials:
        assert one.closing[:, 1].all()
        assert not one.closing[:, 0].any()


def test_the_same_call_plays_the_same_trials_and_shows_them() -> None:
    shown: list[int] = []
    arguments: dict[str, Any] = {"env_kwargs": NOISY}
    first = run_trials(follow, PUSH, 2, **arguments)
    second = run_trials(
        follow, PUSH, 2, frame_callback=lambda _, step: shown.append(step), **arguments
    )
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.object, other.object)
    assert shown == list(range(13))
