"""Poses in observations: spaces, rate, latency, resets of single environments and vectors."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from saver_envs.perception.parsing import Poses
from saver_envs.simulation import ACTION_DURATION
from saver_envs.wrappers.pose_observation import (
    KEYS,
    NEVER,
    PoseObservation,
    PoseReading,
    PoseStream,
    VectorPoseObservation,
)

ENV = "saver_envs:JacoPush-v0"
SMALL = {"width": 64, "height": 48}


class Counting:
    """Sees one person, whose head's column is the number of the picture."""

    def __init__(self) -> None:
        self.pictures = 0

    def __call__(self, image: np.ndarray) -> Poses:
        assert image.shape == (48, 64, 3)
        assert image.dtype == np.uint8
        joints = np.full((1, 14, 2), np.nan)
        joints[0, 1] = (self.pictures, 24.0)
        scores = np.zeros((1, 14))
        scores[0, 1] = 0.75
        self.pictures += 1
        return Poses(joints, scores, np.full(1, 0.75))


def wrapped(estimator: Any = None, **options: Any) -> PoseObservation:
    env = gymnasium.make(ENV)
    options = {"camera": "overhead", **SMALL, **options}
    return PoseObservation(env, estimator=estimator or Counting(), **options)


def test_the_api_checker_is_content() -> None:
    def bright(image: np.ndarray) -> Poses:
        joints = np.full((1, 14, 2), image.mean() / 8)
        return Poses(joints, np.full((1, 14), 0.5), np.full(1, 0.5))

    env = wrapped(estimator=bright, rate=10.0)
    check_env(env, skip_render_check=True)
    assert set(KEYS) < set(env.observation_space.spaces)
    env.close()


def test_the_same_seed_gives_the_same_and_joints_lie_in_space() -> None:
    env = wrapped()
    first, _ = env.reset(seed=3)
    env.unwrapped.reset(seed=0)
    second, _ = wrapped().reset(seed=3)
    for key in KEYS:
        assert np.array_equal(first[key], second[key])
    assert first["pose_scores"][1] == first["pose_scores_3d"][1] == 0.75
    assert (first["pose_scores"][[0, 2, 13]] == 0).all()
    assert (first["pose_3d"][0] == 0).all()
    # The camera above looks down on bench or floor.
    assert -0.8 < first["pose_3d"][1, 2] < 0.7
    env.close()


def test_rate_and_latency() -> None:
    """Every third action a picture, whose result comes two actions later."""
    env = wrapped(rate=1 / (3 * ACTION_DURATION), latency=2 * ACTION_DURATION)
    observation, _ = env.reset(seed=0)
    columns, ages = [], []
    for _ in range(9):
        columns.append(float(observation["pose_2d"][1, 0]))
        ages.append(float(observation["pose_age"][0]) / ACTION_DURATION)
        observation, *_ = env.step(env.action_space.sample() * 0)
    assert ages[:2] == [NEVER / ACTION_DURATION] * 2
    assert ages[2:] == pytest.approx([2, 3, 4, 2, 3, 4, 2], abs=1e-3)
    assert columns[2:] == [0, 0, 0, 1, 1, 1, 2]
    fresh, _ = env.reset(seed=0)
    assert fresh["pose_age"][0] == NEVER
    env.close()


def test_nobody_is_seen_as_nobody() -> None:
    env = wrapped(estimator=lambda image: Poses.none())
    observation, _ = env.reset(seed=0)
    assert not observation["pose_scores"].any()
    assert not observation["pose_3d"].any()
    assert observation["pose_age"][0] == 0.0
    env.close()


def test_a_slow_camera_skips_pictures_but_never_takes_one_twice() -> None:
    stream, taken = PoseStream(rate=10.0, latency=0.0), []

    def look(now: float) -> PoseReading:
        taken.append(now)
        return PoseReading.nothing(now)

    for time in (0.0, 0.04, 0.08, 0.12, 0.5, 0.54, 0.58, 0.62):
        stream.read(time, look)
    assert taken == [0.0, 0.12, 0.5, 0.62]


def test_a_vector_does_what_its_environments_do() -> None:
    vector = gymnasium.make_vec(ENV, num_envs=2, max_episode_steps=3)
    env = VectorPoseObservation(vector, "overhead", estimator=Counting(), rate=12.5, **SMALL)
    observation, _ = env.reset(seed=5)
    assert env.observation_space.contains(observation)
    single = wrapped(rate=12.5)
    alone, _ = single.reset(seed=6)
    # Episode 1 of the vector, seeded with 6; the pictures are counted over both.
    assert np.array_equal(observation["observation"][1], alone["observation"])
    assert observation["pose_2d"][:, 1, 0].tolist() == [0, 1]
    ages = []
    for _ in range(6):
        observation, *_ = env.step(np.zeros(env.action_space.shape))
        ages.append(np.rint(observation["pose_age"][:, 0] / ACTION_DURATION).tolist())
    # After three actions the next step resets, and takes a picture at once.
    assert ages == [[1, 1], [0, 0], [1, 1], [0, 0], [1, 1], [0, 0]]
    env.close()
    single.close()


def test_bad_arguments_are_named() -> None:
    env = gymnasium.make(ENV)
    with pytest.raises(ValueError, match="camera='webcam': the model has the cameras front"):
        PoseObservation(env, "webcam", estimator=Counting())
    with pytest.raises(ValueError, match="rate=0"):
        PoseObservation(env, "front", estimator=Counting(), rate=0)
    with pytest.raises(ValueError, match="latency=-1"):
        PoseObservation(env, "front", estimator=Counting(), latency=-1)
    with pytest.raises(ValueError, match="'tail' is none of"):
        PoseObservation(env, "front", ["tail"], Counting())
    with pytest.raises(TypeError, match="must be a dictionary"):
        PoseObservation(gymnasium.wrappers.FlattenObservation(env), "front", estimator=Counting())
    vector = gymnasium.make_vec(ENV, num_envs=2, autoreset_mode="SameStep")
    with pytest.raises(ValueError, match="must be 'NextStep' or 'Disabled'"):
        VectorPoseObservation(vector, "front", estimator=Counting())
    vector.close()
