"""What the batched refinement stands on: the multilinear forward map, Newton steps, the search."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from saver_envs.modelling.arms import ARMS, arm_named
from saver_envs.modelling.joint_steps import newton_step, search
from saver_envs.modelling.kinematics import LearnedInverseKinematics
from saver_envs.modelling.multilinear import MultilinearTool
from saver_envs.modelling.solvers import error_at
from saver_envs.registration import make_episodes


def drawn(robot: str, n: int, seed: int = 0) -> np.ndarray:
    """Joints (dof, n) round the home posture."""
    arm = arm_named(robot)
    home = np.asarray(arm.robot.home)
    values = home + np.random.default_rng(seed).uniform(-0.5, 0.5, (n, arm.dof))
    return np.clip(values, arm.joint_lower, arm.joint_upper).T


@pytest.mark.parametrize("robot", ARMS)
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_the_multilinear_map_is_the_chains(robot: str, seed: int) -> None:
    arm = arm_named(robot)
    tool = MultilinearTool(arm.tool_chain, arm.target_size)
    joints = np.random.default_rng(seed).uniform(-6, 6, (arm.dof, 5))
    zero = np.zeros((5, arm.target_size))
    pose = tool.pose(tool.features(joints))
    assert np.abs(pose.T + error_at(joints.T, zero, arm.tool_chain)).max() < 5e-6


@pytest.mark.parametrize("robot", ARMS)
def test_its_derivative_is_the_jacobian(robot: str) -> None:
    arm = arm_named(robot)
    tool = MultilinearTool(arm.tool_chain, arm.target_size)
    joints = drawn(robot, 20)
    found = tool.jacobian(tool.features(joints))
    step = 1e-2
    for joint in range(arm.dof):
        change = np.zeros((arm.dof, 1))
        change[joint] = step
        ahead, behind = (tool.pose(tool.features(joints + s * change)) for s in (1, -1))
        slope = (ahead.astype(np.float64) - behind) / (2 * step)
        assert np.abs(found[:, joint] - slope).max() < 2e-4
    chain = arm.tool_chain
    linear = chain.jacobian(chain.frames(joints.T))[:, :3]
    assert np.abs(found[:3].transpose(2, 0, 1) - linear).max() < 5e-6


def test_a_tool_has_three_or_six_rows() -> None:
    with pytest.raises(ValueError, match="rows=4: must be 3 or 6"):
        MultilinearTool(arm_named("jaco").tool_chain, 4)


@pytest.mark.parametrize("n", [100, 200])  # few systems are solved in another way than many
@pytest.mark.parametrize(("rows", "dof"), [(3, 3), (6, 6), (3, 8), (6, 7)])
def test_newton_steps_remove_the_error(rows: int, dof: int, n: int) -> None:
    generator = np.random.default_rng(0)
    jacobian, error = generator.normal(size=(n, rows, dof)), generator.normal(size=(rows, n))
    step = newton_step(jacobian, error)
    wanted = (np.linalg.pinv(jacobian) @ error.T[..., None])[..., 0].T
    good = np.linalg.cond(jacobian) < 30
    assert good.sum() > 50
    assert np.abs(step - wanted)[:, good].max() < 1e-3


def test_elimination_needs_no_pivots_that_are_there_by_chance() -> None:
    # Ones off the diagonal: every leading block of the matrix itself is singular.
    jacobian = np.tile(np.fliplr(np.eye(6)), (200, 1, 1))  # as many as are eliminated
    error = np.tile(np.arange(6.0)[:, None], 200)
    assert np.allclose(newton_step(jacobian, error), error[::-1], atol=1e-4)


def test_a_singular_system_does_not_spoil_the_others() -> None:
    jacobian = np.stack([np.eye(6), np.zeros((6, 6)), 2 * np.eye(6)])
    step = newton_step(jacobian, np.ones((6, 3)))
    assert np.allclose(step[:, [0, 2]], [1.0, 0.5], atol=1e-4)


@pytest.mark.parametrize("robot", ARMS)
def test_a_search_reaches_targets_and_keeps_the_limits(robot: str) -> None:
    arm = arm_named(robot)
    tool = MultilinearTool(arm.tool_chain, arm.target_size)
    limits = arm.joint_lower[:, None], arm.joint_upper[:, None]
    wanted = tool.pose(tool.features(drawn(robot, 60))).astype(np.float64)
    enough = np.full((arm.target_size, 1), 1e-3)
    joints, error = search(tool, wanted, drawn(robot, 60, 1), limits, enough, 40)
    assert (joints >= limits[0]).all()
    assert (joints <= limits[1]).all()
    assert np.allclose(wanted - tool.pose(tool.features(joints)), error, atol=1e-6)
    assert (np.abs(error) < enough).all(axis=0).mean() > 0.9


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31))
def test_a_search_never_makes_it_worse(seed: int) -> None:
    arm = arm_named("mico")
    tool = MultilinearTool(arm.tool_chain, 3)
    wanted = np.random.default_rng(seed).uniform(-2, 2, (3, 20))  # most of it out of reach
    start = drawn("mico", 20, seed)
    before = np.square(wanted - tool.pose(tool.features(start))).sum(axis=0)
    limits = arm.joint_lower[:, None], arm.joint_upper[:, None]
    _, error = search(tool, wanted, start, limits, np.full((3, 1), 1e-3), 6)
    assert (np.square(error).sum(axis=0) <= before + 1e-9).all()


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
