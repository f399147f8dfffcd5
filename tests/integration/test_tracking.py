"""The filter: velocities, missing joints, outliers, hold-last, and whom the robot hides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_advisors.integration.bench import BenchGeometry
from saver_advisors.integration.control_stages import as_cubes
from saver_advisors.integration.messages import ArmReading, SpacePose, Stamp
from saver_advisors.integration.stage import Inputs, Mailbox, StageFault
from saver_advisors.integration.tracking import (
    ELBOWS,
    HIPS,
    WRISTS,
    FilterSettings,
    FilterStage,
    Track,
    segment_distance,
)
from saver_envs.robots import MICO
from saver_envs.scenes import Arms
from saver_envs.tasks.regions import regions
from saver_envs.tasks.wrist_push import STANDOFF

BASE = np.array([[0.0, -0.36, 0.0], [0.0, 0.36, 0.0]])
GEOMETRY = BenchGeometry(MICO, BASE, regions(Arms(MICO, 2)).workspace, None)
PERIOD = 1 / 30
#: Longer than the default, to see that it is a limit.
HOLD_HIDDEN = 0.5


def joints(right_wrist: tuple[float, ...] = (0.3, -0.45, 0.04)) -> np.ndarray:
    positions = np.full((14, 3), np.nan)
    positions[list(WRISTS)] = [right_wrist, (0.3, 0.45, 0.04)]
    positions[list(HIPS)] = [(0.35, -0.09, 0.1), (0.35, 0.09, 0.1)]
    return positions


def reading(tool: tuple[float, float, float]) -> ArmReading:
    """Both tools at a place of the bench, hands pointing down."""
    tools = np.array(tool) - BASE
    return ArmReading(
        Stamp(0.0, 1, "encoders"),
        *(np.zeros((2, 4)), np.zeros((2, 4)), tools, np.zeros((2, 3))),
        *(np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 6, 4)), np.zeros(2)),
        torso_force=0.0,
    )


class Feed:
    """A filter, and pictures at 30 Hz."""

    def __init__(self, tool: tuple[float, float, float] = (0.6, 0.0, 0.3)) -> None:
        self.stage = FilterStage(GEOMETRY, FilterSettings(hold_hidden=HOLD_HIDDEN))
        self.boxes = {"bench_pose": Mailbox(), "arms": Mailbox()}
        self.boxes["arms"].put(reading(tool))
        self.number = 0

    def __call__(self, positions: np.ndarray):
        self.number += 1
        time = self.number * PERIOD
        scores = np.isfinite(positions).all(axis=1).astype(float)
        pose = SpacePose(Stamp(time, self.number, "bench frame"), positions, scores)
        self.boxes["bench_pose"].put(pose)
        return self.stage.process(Inputs(self.boxes), time)


def test_targets_lie_beside_the_hips() -> None:
    person = Feed()(joints())
    np.testing.assert_allclose(person.targets[:, 1], [-0.09 - STANDOFF, 0.09 + STANDOFF])
    np.testing.assert_allclose(person.targets[:, 2], 0.04)
    np.testing.assert_allclose(person.wrists, joints()[list(WRISTS)])


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_a_steady_motion_is_followed(x: float, y: float) -> None:
    feed = Feed()
    for step in range(45):
        moved = (0.3 + x * step * PERIOD, -0.45 + y * step * PERIOD, 0.04)
        person = feed(joints(moved))
    np.testing.assert_allclose(person.wrists[0], moved, atol=0.004)
    np.testing.assert_allclose(person.wrist_velocity[0], [x, y, 0.0], atol=0.03)


def test_noise_is_reduced() -> None:
    random = np.random.default_rng(0)
    settings = FilterSettings()
    track = Track(settings.wrist_gain, settings.wrist_speed_gain, settings)
    places = []
    for step in range(400):
        track.update(random.normal(0, 0.01, 3), step * PERIOD)
        places.append(track.position.copy())
    assert np.std(places[20:]) < 0.0085


def test_a_hidden_wrist_is_told_at_once() -> None:
    feed = Feed()
    feed(joints())
    with pytest.raises(StageFault, match="the right wrist is hidden"):
        feed(joints((np.nan, np.nan, np.nan)))
    assert not feed(joints()).held.any()


def test_a_wrist_under_the_robots_arm_is_held_for_a_while() -> None:
    feed = Feed(tool=(0.28, -0.45, 0.06))
    feed(joints())
    hidden = joints((np.nan, np.nan, np.nan))
    for _ in range(int(HOLD_HIDDEN / PERIOD)):
        person = feed(hidden)
    np.testing.assert_allclose(person.wrists[0], (0.3, -0.45, 0.04))
    assert person.held.tolist() == [True, False]
    with pytest.raises(StageFault, match="the right wrist is hidden"):
        feed(hidden)


def test_by_default_a_hidden_wrist_stops_at_once_in_any_case() -> None:
    feed = Feed(tool=(0.28, -0.45, 0.06))
    feed.stage = FilterStage(GEOMETRY, FilterSettings())
    feed(joints())
    with pytest.raises(StageFault, match="the right wrist is hidden"):
        feed(joints((np.nan, np.nan, np.nan)))


def test_forearms_lie_as_elbows_and_wrists_tell() -> None:
    feed, positions = Feed(), joints()
    np.testing.assert_array_equal(feed(positions).wrist_quaternion[0], [1, 0, 0, 0])
    positions[ELBOWS[0]] = (0.1, -0.45, 0.04)  # the forearm along x
    positions[ELBOWS[1]] = (0.3, 0.25, 0.04)  # and along y
    person = feed(positions)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        person.wrist_quaternion, [[1, 0, 0, 0], [half, 0, 0, half]], atol=1e-9
    )


def test_a_jump_is_refused_and_believed_when_it_stays() -> None:
    feed = Feed()
    for _ in range(3):
        feed(joints())
    away = joints((0.3, 0.1, 0.04))
    with pytest.raises(StageFault, match=r"the right wrist has jumped by 0\.55 m"):
        feed(away)
    assert not feed(joints()).held.any()
    refused = 0
    for _ in range(60):
        try:
            person = feed(away)
            break
        except StageFault:
            refused += 1
    assert refused == pytest.approx(FilterSettings().reacquire / PERIOD, abs=1.5)
    np.testing.assert_allclose(person.wrists[0], (0.3, 0.1, 0.04))


def test_a_policy_of_cubes_is_told_of_cubes() -> None:
    person = Feed()(joints())
    told = as_cubes(replace(person, wrist_velocity=np.ones((2, 3))), 0.028)
    assert told.wrists[:, 2].tolist() == told.targets[:, 2].tolist() == [0.028, 0.028]
    assert told.wrist_velocity[:, 2].tolist() == [0.0, 0.0]
    np.testing.assert_array_equal(told.wrists[:, :2], person.wrists[:, :2])


def test_a_small_jump_is_not_believed_sooner_by_waiting() -> None:
    feed = Feed()
    for _ in range(3):
        feed(joints())
    away = joints((0.3, -0.25, 0.04))
    for _ in range(int(0.9 * FilterSettings().reacquire / PERIOD)):
        with pytest.raises(StageFault, match="has jumped"):
            feed(away)


def test_distance_of_segments() -> None:
    x, y, z = np.eye(3)
    zero = np.zeros(3)
    assert segment_distance(zero, x, z, z + y) == pytest.approx(1.0)
    assert segment_distance(zero, x, 0.5 * x - y, 0.5 * x + y) == pytest.approx(0.0)
    assert segment_distance(zero, x, 3 * x, 4 * x) == pytest.approx(2.0)
    assert segment_distance(zero, x, 2 * y, 2 * y + x) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("name", "value"), [("wrist_gain", 1.5), ("jump", 0.0), ("hold", -1.0), ("hip_gain", 0.0)]
)
def test_settings_that_cannot_be_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}={value}"):
        FilterSettings(**{name: value})
