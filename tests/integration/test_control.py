"""The loop below the person: as the environment without latency, limits, faults, stops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from gymnasium.utils import seeding
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from small_loops import Push, SmallLoop

from saver_advisors.integration.bench import EpisodesBench
from saver_advisors.integration.control_stages import ServoStage
from saver_advisors.integration.health import Health
from saver_advisors.integration.safety import (
    EmergencyStop,
    SafetyLimits,
    TargetLimits,
    kept_clear,
)
from saver_advisors.pretrained import load_policy
from saver_envs.control import LEAD_LIMIT, SetPointRule, least_squares_step
from saver_envs.registration import make_episodes
from saver_envs.robots import JACO, MICO
from saver_envs.scenes import Arms
from saver_envs.simulation import ACTION_DURATION
from saver_envs.tasks.regions import regions
from saver_envs.wrappers.finger_readings import translated_fingers

WORKSPACE = regions(Arms(MICO, 2)).workspace


def speed(loop: SmallLoop) -> float:
    return float(
        np.linalg.norm(loop.bench.episodes.simulation.arm_state().tool_velocity, axis=-1).max()
    )


def test_without_latency_the_loop_is_the_environment(make_loop: Callable[..., SmallLoop]) -> None:
    policy = load_policy("dual-jaco-push")
    loop = make_loop(policy)
    reference = make_episodes("DualMicoPush-v0")
    reference.set_generator(0, seeding.np_random(0)[0])
    reference.reset()
    for step in range(20):
        loop.graph.run_until((step + 1) * ACTION_DURATION, loop.bench.advance_to)
        seen = reference.observation().as_dict()
        seen["observation"] = translated_fingers(
            seen["observation"], reference.task.observation_layout, MICO, JACO
        )
        reference.step(policy.predict(seen)[0])
        np.testing.assert_allclose(
            loop.bench.episodes.simulation.qpos, reference.simulation.qpos, atol=1e-8
        )
    assert not loop.health.log


NUMBERS = st.floats(-3, 3)


@settings(max_examples=100, deadline=None)
@given(
    previous=arrays(float, (2, 3), elements=NUMBERS),
    motion=arrays(float, (2, 3), elements=st.floats(-1, 1)),
    # Away from the corners of the box that are out of reach, where reach goes first.
    tool=arrays(float, (2, 3), elements=st.floats(-0.3, 0.3)),
    force=arrays(float, (2,), elements=st.floats(0, 200)),
    torso=st.floats(0, 120),
)
def test_no_set_point_leaves_the_limits(
    previous: np.ndarray, motion: np.ndarray, tool: np.ndarray, force: np.ndarray, torso: float
) -> None:
    limits = SafetyLimits(max_speed=0.5)
    tool = WORKSPACE.clip(tool + np.array([0.4, 0.0, 0.1]))
    freedom = limits.freedom(force, torso)
    rule = SetPointRule(WORKSPACE, limits.longest)
    position = WORKSPACE.clip(rule.unclipped(previous, motion, tool, freedom[:, None]))
    lower, upper = WORKSPACE.lower, WORKSPACE.upper
    assert (position >= lower - 1e-9).all()
    assert (position <= upper + 1e-9).all()
    ahead = np.linalg.norm(position - tool, axis=-1)
    # Clipping into a region that the tool is in brings a point no farther from it, but for the
    # reach, which is level: a point above the tool's height may be moved a little more.
    assert (ahead <= LEAD_LIMIT * limits.longest * freedom + 0.02).all()
    if torso >= limits.torso_force:
        np.testing.assert_allclose(position, tool, atol=1e-9)


@pytest.mark.parametrize(
    ("force", "share"), [(0.0, 1.0), (12.5, 1.0), (18.75, 0.5), (25.0, 0.0), (80.0, 0.0)]
)
def test_force_shortens_the_leash(force: float, share: float) -> None:
    assert SafetyLimits().freedom(np.zeros(2), force) == pytest.approx([share, share])


@pytest.mark.parametrize("env_id", ["DualJacoPickAndPlace-v0", "DualMicoPush-v0"])
@pytest.mark.parametrize("way", range(3))
def test_a_lead_that_is_too_long_is_refused(env_id: str, way: int) -> None:
    """At a held height, only its level part counts: the hand may rise back to that height."""
    bench = EpisodesBench(make_episodes(env_id))
    bench.reset(0)
    arms, limits = bench.reading(), SafetyLimits(max_speed=0.5, clearance=0.0)
    rule = TargetLimits(bench.geometry, limits)
    assert rule.broken(arms.joint_position, arms, None) == ""
    lead = np.zeros((2, 3))
    lead[:, way] = (1 if way == 2 else -1) * 1.5 * LEAD_LIMIT * limits.longest
    targets = arms.joint_position + least_squares_step(arms.jacobian[:, :3], lead, 1e-6)
    held = bench.geometry.held_height is not None
    assert ("too far for its force" in rule.broken(targets, arms, None)) == (way < 2 or not held)


def test_a_braking_joint_is_held_where_it_turns_round() -> None:
    class Joints(EpisodesBench):
        position, velocity = np.zeros((2, 4)), np.zeros((2, 4))

        def joint_position(self) -> np.ndarray:
            return self.position.copy()

        def joint_velocity(self) -> np.ndarray:
            return self.velocity.copy()

    bench = Joints(make_episodes("DualMicoPush-v0"))
    gate = ServoStage(bench, Health((), {}), EmergencyStop(), SafetyLimits())
    held = None
    # (position, velocity) of a joint -> where it is held: it overshoots to 0.3, turns, goes back.
    course = ((0.1, 2.0, 0.1), (0.3, 0.5, 0.1), (0.29, -0.1, 0.29), (0.2, -0.5, 0.29))
    for sign in (1.0, -1.0):
        held = None
        for position, velocity, expected in course:
            bench.position[:, 1], bench.velocity[:, 1] = sign * position, sign * velocity
            held = gate._braked(held)
            np.testing.assert_allclose(held[:, 1], sign * expected)
            np.testing.assert_allclose(np.delete(held, 1, axis=1), 0.0)


def test_set_points_keep_clear_of_the_hips() -> None:
    base = np.array([[0.0, -0.36, 0.0], [0.0, 0.36, 0.0]])
    hips = np.array([[0.35, -0.09, 0.1], [0.35, 0.09, 0.1]])
    inside = np.array([[0.4, 0.0, 0.02], [0.4, 0.0, 0.02]]) - base
    moved, changed = kept_clear(inside, hips, base, 0.10)
    np.testing.assert_allclose((moved + base)[:, 1], [-0.19, 0.19])
    assert changed
    outside = np.array([[0.4, -0.3, 0.02], [0.4, 0.3, 0.02]]) - base
    kept, changed = kept_clear(outside, hips, base, 0.10)
    np.testing.assert_array_equal(kept, outside)
    assert not changed


def test_nothing_moves_while_the_emergency_stop_is_pressed(
    make_loop: Callable[..., SmallLoop],
) -> None:
    loop = make_loop(Push((1.0, 0.0, 0.0)))
    loop.graph.run_until(0.3, loop.bench.advance_to)
    assert speed(loop) > 0.2
    loop.stop.press("a person came near")
    loop.graph.run_until(0.4, loop.bench.advance_to)
    assert speed(loop) < 0.02
    before = loop.bench.joint_position()
    loop.graph.run_until(1.4, loop.bench.advance_to)
    np.testing.assert_allclose(loop.bench.joint_position(), before, atol=5e-3)
    told = [str(event) for event in loop.health.log]
    assert len(told) == 1
    assert "emergency stop: a person came near" in told[0]
    loop.stop.release()
    loop.graph.run_until(1.7, loop.bench.advance_to)
    assert loop.health.log[-1].kind == "resumed"
    assert speed(loop) > 0.05


def test_the_first_reason_of_a_stop_stays() -> None:
    stop = EmergencyStop()
    stop.press("first")
    stop.press("second")
    assert (stop.pressed, stop.reason) == (True, "first")
    with pytest.raises(ValueError, match="reason=''"):
        stop.press("")
    stop.release()
    assert not stop.pressed


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ((np.nan, 0.0, 0.0), "not finite"),
        ((50.0, 0.0, 0.0), "a point 1.00 m away, out of reach of one action"),
    ],
)
def test_what_the_policy_cannot_mean_stops_the_arms(
    make_loop: Callable[..., SmallLoop], motion: tuple[float, float, float], words: str
) -> None:
    policy = Push((1.0, 0.0, 0.0))
    loop = make_loop(policy)
    loop.graph.run_until(0.3, loop.bench.advance_to)
    policy.motion = np.array(motion)
    loop.graph.run_until(0.4, loop.bench.advance_to)
    assert speed(loop) < 0.02
    assert words in str(loop.health.log[0])
    policy.motion = np.array([-1.0, 0.0, 0.0])
    loop.graph.run_until(0.6, loop.bench.advance_to)
    assert [event.kind for event in loop.health.log] == ["stopped", "resumed"]
    assert speed(loop) > 0.1


@settings(max_examples=60, deadline=None)
@given(
    targets=arrays(float, (2, 4), elements=st.floats(-0.2, 0.2)),
    last=arrays(float, (2, 4), elements=st.floats(-0.2, 0.2)),
    left=arrays(float, (2,), elements=st.floats(0, 1.4)),
)
def test_commands_stay_within_the_speed_limits(
    targets: np.ndarray, last: np.ndarray, left: np.ndarray
) -> None:
    bench = EpisodesBench(make_episodes("DualMicoPush-v0"))
    limits = TargetLimits(bench.geometry, SafetyLimits())
    present, jacobian = np.zeros((2, 4)), bench.reading().jacobian
    command, used = limits.slowed(targets, present, last, jacobian, left)
    kept = np.clip(targets, np.minimum(last, 0), np.maximum(last, 0))
    tool = np.linalg.norm((jacobian[:, :3] @ (command - kept)[..., None])[..., 0], axis=-1)
    assert (used <= left).all()
    assert (tool <= used * 0.2 * ACTION_DURATION + 1e-12).all()
    for arm in range(2):
        if used[arm] < left[arm]:
            np.testing.assert_allclose(command[arm], targets[arm], atol=1e-12)
    backwards, free = limits.slowed(0.5 * last, present, last, jacobian, np.zeros(2))
    np.testing.assert_array_equal(backwards, 0.5 * last)
    assert (free == 0).all()


@pytest.mark.parametrize("name", ["max_speed", "torso_force", "hand_force"])
def test_limits_that_cannot_be_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}=0.0"):
        SafetyLimits(**{name: 0.0})
