"""A cube that a hand has closed on stays in it."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

from saver_envs.reachability import reachability_map
from saver_envs.robots import ROBOTS, Robot
from saver_envs.robots.description import Fingers
from saver_envs.scenes import Arms, compose, free_bodies
from saver_envs.tasks.cubes import CubeTask
from saver_envs.tasks.grasping import settled_grasp

HANDS = [robot for robot in ROBOTS.values() if robot.finger_joints]
LIFT = np.array([0.40, 0.0, 0.20])  # m, base frame, clear of the table
CLOSING_STEPS, HOLDING_STEPS = 300, 2000  # 0.6 s and 4 s


def offset_in_tool_frame(data: mujoco.MjData, site: int, object_qpos: np.ndarray) -> np.ndarray:
    rotation = data.site_xmat[site].reshape(3, 3)
    return rotation.T @ (data.qpos[object_qpos[:3]] - data.site_xpos[site])


@pytest.mark.parametrize("robot", HANDS, ids=lambda robot: robot.name)
def test_a_gripped_cube_is_held_for_four_seconds(robot: Robot) -> None:
    cubes = CubeTask(1)
    scene = compose(Arms(robot, 1, Fingers.ACTUATED), cubes)
    address = free_bodies(scene, cubes.resting).qpos[0]
    model = copy.copy(scene.model)
    data = mujoco.MjData(model)
    posture = reachability_map(robot).postures_at(LIFT[None])[0]
    data.qpos[scene.joint_qpos[0]] = data.ctrl[scene.arm_ctrl[0]] = posture
    data.qpos[scene.finger_qpos[0]] = robot.finger_open
    data.ctrl[scene.finger_ctrl[0]] = robot.finger_closed
    data.qpos[address] = (*LIFT, 1, 0, 0, 0)
    gravity = model.opt.gravity.copy()
    model.opt.gravity[:] = 0  # until the hand has closed
    mujoco.mj_step(model, data, CLOSING_STEPS)
    model.opt.gravity[:] = gravity
    mujoco.mj_forward(model, data)
    where = scene.tool_site[0], address
    before = offset_in_tool_frame(data, *where)
    mujoco.mj_step(model, data, HOLDING_STEPS)
    mujoco.mj_forward(model, data)
    after = offset_in_tool_frame(data, *where)
    assert np.linalg.norm(after - before) < 0.005
    assert data.qpos[address[2]] > 0.15  # it hangs in the air, not on the table


@pytest.mark.parametrize("robot", HANDS, ids=lambda robot: robot.name)
def test_the_settled_grasp_centres_the_cube_between_the_fingers(robot: Robot) -> None:
    grasp = settled_grasp(robot, CubeTask(1))
    assert np.linalg.norm(grasp.object_offset) < 0.01
    # The cube stops the fingers before they are closed.
    assert (grasp.finger_position < robot.finger_closed - 0.1).all()
    assert (grasp.finger_position > robot.finger_open + 0.1).all()
