"""Errors of the sensors: their size, what they leave alone, and that they can be reproduced."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rollouts import assert_same, begun, random_actions

from saver_envs import sensor_errors
from saver_envs.registration import make_episodes
from saver_envs.sensor_errors import SENSORS, Sensor, SensorErrors
from saver_envs.tasks.arm_and_object import ARM_AND_OBJECT
from saver_envs.tasks.layout import Layout

LAYOUT = Layout(ARM_AND_OBJECT, 2)
TURN = "object orientation, a quaternion with w >= 0"
RELATIVE = "object position relative to the gripper"
#: Every sensor by the part of the observation that it measures.
BY_PART = {one.part: one for one in SENSORS}


def exact(n: int) -> NDArray[np.float64]:
    """Observations (n, 28 * 2) that could be ones."""
    random = np.random.default_rng(0)
    values = random.normal(scale=0.2, size=(n, LAYOUT.size))
    turn = random.normal(size=(n, 2, 4))
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    LAYOUT.get(values, TURN)[...] = np.where(turn[..., :1] < 0, -turn, turn)
    between = LAYOUT.get(values, "object position") - LAYOUT.get(values, "gripper position")
    LAYOUT.get(values, RELATIVE)[...] = between
    return values


def begun_errors(n: int, moving: bool = True, seed: int = 0) -> SensorErrors:
    errors = SensorErrors(n, LAYOUT, moving)
    for row in range(n):
        errors.begin(row, np.random.default_rng(seed + row))
    return errors


def disturbed(errors: SensorErrors, values: NDArray[np.float64], factor: float = 1.0) -> Any:
    n = len(values)
    return errors.disturb(values, np.arange(n), np.full((n, 1), factor))


def only(monkeypatch: pytest.MonkeyPatch, *sensors: Sensor) -> None:
    monkeypatch.setattr(sensor_errors, "SENSORS", sensors)


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_errors_have_the_size_that_the_table_says(factor: float) -> None:
    n = 4000
    before = exact(n)
    change = disturbed(begun_errors(n), before, factor) - before
    expected = {
        part.name: np.hypot(BY_PART[part.name].deviation, BY_PART[part.name].offset)
        for part in ARM_AND_OBJECT
        if part.name not in (TURN, RELATIVE)
    }
    expected[RELATIVE] = np.hypot(expected["object position"], expected["gripper position"])
    for name, deviation in expected.items():
        measured = LAYOUT.get(change, name)
        size = factor * LAYOUT.part(name).scale * deviation
        assert measured.std() == pytest.approx(size, rel=0.05), name
        assert abs(measured.mean()) < size / 20, name


def test_the_object_is_turned_as_far_as_the_table_says() -> None:
    before = exact(4000)
    after = disturbed(begun_errors(4000), before)
    cosine = np.abs((LAYOUT.get(before, TURN) * LAYOUT.get(after, TURN)).sum(axis=-1))
    angle = 2 * np.arccos(np.clip(cosine, 0, 1))
    # The length of a vector of three Gaussian components: sigma * sqrt(8 / pi) on average.
    assert angle.mean() == pytest.approx(BY_PART[TURN].deviation * np.sqrt(8 / np.pi), rel=0.03)


@settings(deadline=None, max_examples=30, derandomize=True)
@given(factor=st.floats(0.0, 10.0), seed=st.integers(0, 2**31))
def test_what_is_read_stays_an_observation(factor: float, seed: int) -> None:
    """Unit quaternions with w >= 0, and a relative position that is the difference of the two."""
    before = exact(5)
    after = disturbed(begun_errors(5, seed=seed), before, factor)
    quaternion = LAYOUT.get(after, TURN)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0, atol=1e-12)
    assert (quaternion[..., 0] >= 0).all()
    between = LAYOUT.get(after, "object position") - LAYOUT.get(after, "gripper position")
    np.testing.assert_allclose(LAYOUT.get(after, RELATIVE), between, atol=1e-12)


def test_the_offset_stays_for_an_episode_and_is_drawn_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    only(monkeypatch, Sensor("object position", 0.0, offset=0.01), Sensor("gripper position", 0.0))
    errors, before = begun_errors(3), exact(3)
    first, second = disturbed(errors, before), disturbed(errors, before)
    np.testing.assert_array_equal(first, second)
    errors.begin(1, np.random.default_rng(77))
    third = disturbed(errors, before)
    np.testing.assert_array_equal(first[[0, 2]], third[[0, 2]])
    assert np.abs(first[1] - third[1]).max() > 1e-3


def test_what_arms_share_is_measured_once() -> None:
    n, task = 4000, make_episodes("DualJacoCarry-v0").task
    layout = task.observation_layout
    before = np.random.default_rng(0).normal(scale=0.2, size=(n, layout.size))
    turn = layout.get(before, TURN)
    turn[:] = [1.0, 0.0, 0.0, 0.0]
    errors = SensorErrors(n, layout, moving_fingers=True)
    for row in range(n):
        errors.begin(row, np.random.default_rng(row))
    after = disturbed(errors, before)
    for part in layout.parts:
        change = layout.get(after - before, part.name)
        if part.name in BY_PART and part.name != TURN:
            sensor = BY_PART[part.name]
            size = part.scale * np.hypot(sensor.deviation, sensor.offset)
            assert change.std() == pytest.approx(size, rel=0.05), part.name
    turned = layout.get(after, TURN)
    assert turned.shape == (n, 4)
    assert 2 * turned[:, 1:].std() == pytest.approx(BY_PART[TURN].deviation, rel=0.05)
    # No two errors are the same number.
    independent = np.corrcoef((after - before)[:, : layout.block].T)
    relative = np.flatnonzero(np.abs(np.triu(independent, 1)) > 0.1)
    assert relative.size == 6  # the end relative to the gripper, from both


def test_locked_fingers_are_not_measured() -> None:
    before = exact(3)
    after = disturbed(begun_errors(3, moving=False), before)
    for name in ("finger positions", "finger velocities"):
        np.testing.assert_array_equal(LAYOUT.get(after, name), LAYOUT.get(before, name))
    assert (LAYOUT.get(after, "gripper position") != LAYOUT.get(before, "gripper position")).all()


# ---------------------------------------------------------------- in episodes


@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", "JacoPickAndPlace-v0", "WristPush-v0"])
def test_a_factor_of_0_is_exact_and_goals_and_rewards_always_are(env_id: str) -> None:
    silent, noisy = (begun(env_id, 3, randomization={"sensor_noise": one}) for one in (0, 2.0))
    # The generators have given up the same numbers: the starts are the same.
    for action in random_actions(silent.action_size, 8, 3):
        one, other = silent.observation(), noisy.observation()
        assert_same(one.achieved_goal, other.achieved_goal)
        assert_same(one.desired_goal, other.desired_goal)
        task, simulation = silent.task, silent.simulation
        parts = task.observe(simulation, silent.memory, simulation.arm_state())
        assert_same(one.observation, task.observation_layout.join(parts).astype(np.float32))
        assert (one.observation != other.observation).any(axis=1).all()
        outcomes = silent.step(action), noisy.step(action)
        assert_same(outcomes[0].reward, outcomes[1].reward)
        assert_same(outcomes[0].info(), outcomes[1].info())


def test_each_episode_has_its_own_factor() -> None:
    factors = {"sensor_noise": {"choice": [0, 1]}}
    noisy = begun("DualJacoPush-v0", 12, randomization=factors)
    chosen = noisy.worlds.values["sensor_noise"][:, 0]
    assert set(chosen.tolist()) == {0.0, 1.0}
    task, simulation = noisy.task, noisy.simulation
    for action in [None, *random_actions(noisy.action_size, 5, 12)]:
        if action is not None:
            noisy.step(action)
        parts = task.observe(simulation, noisy.memory, simulation.arm_state())
        truth = task.observation_layout.join(parts).astype(np.float32)
        wrong = (noisy.observation().observation != truth).any(axis=1)
        np.testing.assert_array_equal(wrong, chosen > 0)


def test_a_seed_gives_the_same_errors_again() -> None:
    options: dict[str, Any] = {"randomization": {"sensor_noise": [0, 2]}}
    one, other = (begun("DualJacoPush-v0", 3, seed=5, **options) for _ in range(2))
    for action in random_actions(one.action_size, 10, 3):
        assert_same(one.observation().observation, other.observation().observation)
        one.step(action)
        other.step(action)
