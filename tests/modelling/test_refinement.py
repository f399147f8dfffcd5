"""Guesses refined in compiled code: exact, within the limits, on the present branch."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from saver_envs.modelling.arms import ARMS, arm_named
from saver_envs.modelling.arms.description import KinematicArm
from saver_envs.modelling.kinematics import LearnedInverseKinematics
from saver_envs.modelling.refinement import ORIENTATION_ENOUGH, POSITION_ENOUGH, Refinement
from saver_envs.modelling.solvers import nearest, newton, pose_error
from saver_envs.modelling.workspace import workspace_samples
from saver_envs.registration import make_episodes

Floats = NDArray[np.float64]


def lack(arm: KinematicArm, joints: Floats, targets: Floats) -> Floats:
    """What the tool lacks (n, rows), by the code for whole data sets."""
    return np.abs(pose_error(arm.tool_chain.frames(joints), targets))


def misses(arm: KinematicArm, joints: Floats, targets: Floats) -> NDArray[np.bool_]:
    error = lack(arm, joints, targets)
    return (error[:, :3] > POSITION_ENOUGH).any(axis=1) | (error[:, 3:] > ORIENTATION_ENOUGH).any(
        axis=1
    )


def within(arm: KinematicArm, joints: Floats) -> bool:
    return bool(((joints >= arm.joint_lower) & (joints <= arm.joint_upper)).all())


@pytest.mark.parametrize("robot", ARMS)
def test_guesses_nearby_become_exact(robot: str) -> None:
    arm, samples = arm_named(robot), workspace_samples(robot, 200, 1)
    refine = Refinement(arm)
    guess = samples.joints + 0.03 * np.random.default_rng(0).standard_normal(samples.joints.shape)
    errors = [float(np.median(lack(arm, guess, samples.targets).max(axis=1)))]
    for steps in (1, 2, 5):
        joints, missed = refine(samples.targets, guess, guess, steps)
        assert within(arm, joints)
        assert np.array_equal(missed, misses(arm, joints, samples.targets))
        errors.append(float(np.median(lack(arm, joints, samples.targets).max(axis=1))))
    # Each step squares what is left, and the last ones stop where it is nothing.
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.1 * errors[1]
    assert errors[3] < 1e-6
    assert not missed.any()


@pytest.mark.parametrize(("steps", "tolerance"), [(1, 1e-7), (2, 1e-4)])
@pytest.mark.parametrize("robot", ARMS)
def test_compiled_steps_are_those_of_the_plain_solver(
    robot: str, steps: int, tolerance: float
) -> None:
    arm, samples = arm_named(robot), workspace_samples(robot, 200, 4)
    guess = samples.joints + 0.01 * np.random.default_rng(2).standard_normal(samples.joints.shape)
    for joint in arm.idle_joints:
        guess[:, joint] = arm.robot.home[joint]
    joints, missed = Refinement(arm)(samples.targets, guess, guess, steps)
    plain = newton(arm, samples.targets, guess, steps, arm.tool_chain)
    assert not missed.any()
    # Where its steps miss the target, the compiled solver starts again from the present joints; and
    # it omits steps once the error is below 1e-6.
    kept = ~misses(arm, plain, samples.targets)
    assert kept.mean() > 0.9
    assert np.abs(joints - plain)[kept].max() < tolerance


def test_poses_that_are_not_tool_down() -> None:
    arm, samples = arm_named("jaco"), workspace_samples("jaco", 100, 2)
    turned = samples.targets.copy()
    turned[:, 3:] += np.random.default_rng(1).uniform(-0.3, 0.3, (100, 3))
    exact = nearest(arm, turned, samples.joints, arm.tool_chain)
    good = exact.reachable
    assert good.sum() > 50
    joints, missed = Refinement(arm)(turned[good], exact.joints[good], exact.joints[good], 0)
    assert not missed.any()
    guess = exact.joints[good] + 0.05
    joints, _ = Refinement(arm)(turned[good], guess, guess, 4)
    assert np.percentile(lack(arm, joints, turned[good]), 95) < 1e-5


@pytest.mark.parametrize("robot", ARMS)
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0, 1, 2]))
def test_whatever_is_asked_and_guessed(robot: str, seed: int, steps: int) -> None:
    arm, generator = arm_named(robot), np.random.default_rng(seed)
    targets = np.concatenate(
        [generator.uniform(-2, 2, (20, 3)), generator.uniform(-1, 1, (20, arm.target_size - 3))], 1
    )  # most of it out of reach
    guess = generator.uniform(-9, 9, (20, arm.dof))
    guess[0], guess[1] = np.nan, np.inf
    present = np.clip(
        np.asarray(arm.robot.home) + generator.uniform(-0.5, 0.5, guess.shape),
        arm.joint_lower,
        arm.joint_upper,
    )
    joints, missed = Refinement(arm)(targets, guess, present, steps)
    assert np.isfinite(joints).all()
    assert within(arm, joints)
    assert np.array_equal(missed, misses(arm, joints, targets))


def test_the_present_branch_is_kept_and_left_where_need_be() -> None:
    arm, samples = arm_named("jaco"), workspace_samples("jaco", 100, 3)
    refine = Refinement(arm)
    # The other way round of the last joints: the wrist turned over.
    flipped = samples.joints + np.array([0, 0, 0, np.pi, 0, np.pi])
    flipped[:, 4] *= -1
    there = nearest(arm, samples.targets, flipped, arm.tool_chain)
    far = there.reachable & (np.abs(there.joints - samples.joints).max(axis=1) > 1)
    assert far.sum() > 20
    targets, now, other = samples.targets[far], samples.joints[far], there.joints[far]
    joints, missed = refine(targets, other, now + 0.05, 2)
    assert not missed.any()
    assert np.abs(joints - now).max() < 0.3, "it stays where it is, though the guess is exact"
    # From where no short way leads to the target, the guess does.
    away = now + np.array([2.0, 0, 0, 0, 0, 0])
    joints, missed = refine(targets, other, away, 2)
    assert not missed.any()
    assert lack(arm, joints, targets).max() < 1e-3


def test_shapes_that_do_not_belong_together() -> None:
    arm, samples = arm_named("mico"), workspace_samples("mico", 5, 1)
    refine, joints = Refinement(arm), samples.joints
    with pytest.raises(ValueError, match=r"guess of shape \(4, 4\): must have shape \(5, 4\)"):
        refine(samples.targets, joints[:4], joints, 2)
    with pytest.raises(ValueError, match=r"present of shape \(5, 3\): must have shape \(5, 4\)"):
        refine(samples.targets, joints, joints[:, :3], 2)
    with pytest.raises(ValueError, match=r"present of shape \(1, 4\): must have shape \(5, 4\)"):
        LearnedInverseKinematics("mico").solve(samples.targets, joints[:1])


def test_it_is_compiled_where_nothing_can_be_kept() -> None:
    # A read-only installation, and a user without a home: neither place takes the code.
    program = (
        "from numba.core import caching\n"
        "caching.CacheImpl._locator_classes = []\n"
        "from saver_envs.modelling.compiled import compiled\n"
        "print(compiled(lambda x: x + 1)(1))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120
    )
    assert ran.stdout.strip() == "2", ran.stderr


def test_endless_joints_and_idle_ones() -> None:
    arm = arm_named("mico")
    refine = Refinement(arm)
    home = np.asarray(arm.robot.home)[None]
    guess = home + np.array([[2 * np.pi + 0.1, 0.0, 0.0, 1.0]])
    raw = refine.settled(guess, home, still=False)
    assert raw[0, 3] == guess[0, 3]
    settled = refine.settled(guess, home, still=True)
    assert settled[0, 0] == pytest.approx(home[0, 0] + 0.1)
    assert settled[0, 3] == home[0, 3]
    assert guess[0, 3] != home[0, 3], "what was given is left as it was"


@pytest.mark.parametrize(("robot", "env_id"), [("mico", "MicoPush-v0"), ("jaco", "JacoPush-v0")])
def test_behind_the_seam_set_points_are_met(robot: str, env_id: str) -> None:
    episodes = make_episodes(env_id, 64)
    for index in range(64):
        episodes.set_generator(index, np.random.default_rng(index))
    episodes.reset()
    learned = LearnedInverseKinematics(robot)
    generator = np.random.default_rng(0)
    errors = []
    for _ in range(5):
        state = episodes.simulation.arm_state()
        target = episodes.moved_set_point(generator.uniform(-1, 1, episodes.set_point.shape))
        joints = learned(state, target).reshape(64, -1)
        assert (joints >= learned.arm.joint_lower).all()
        assert (joints <= learned.arm.joint_upper).all()
        position = learned.arm.tool_chain.position(joints)
        errors.append(np.linalg.norm(position - target.reshape(-1, 3), axis=1))
        episodes.step(generator.uniform(-1, 1, (64, episodes.action_size)))
    millimetres = np.concatenate(errors) * 1e3
    assert np.median(millimetres) < 2
    assert np.percentile(millimetres, 99) < 10


def test_behind_the_seam_what_is_out_of_reach_is_said() -> None:
    episodes = make_episodes("MicoPush-v0", 3)
    episodes.reset()
    learned = LearnedInverseKinematics("mico")
    target = episodes.moved_set_point(np.zeros(episodes.set_point.shape))
    target[1] = (1.5, 0.0, 0.3)
    joints = learned(episodes.simulation.arm_state(), target)
    assert np.isfinite(joints).all()
    assert learned.unreachable[:, 0].tolist() == [False, True, False]
