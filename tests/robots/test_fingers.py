"""Fingers with joints, and the same fingers shut for good."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from saver_envs.robots import ROBOTS, Robot
from saver_envs.robots.description import COLLISION_GROUP, Fingers

HANDS = [robot for robot in ROBOTS.values() if robot.finger_joints]
robots = pytest.mark.parametrize("robot", HANDS, ids=lambda robot: robot.name)


def posed(robot: Robot, fingers: Fingers, angle: float = 0.0) -> mujoco.MjData:
    model = robot.build(fingers).compile()
    data = mujoco.MjData(model)
    data.qpos[: len(robot.arm_joints)] = robot.home
    data.qpos[len(robot.arm_joints) :] = angle
    mujoco.mj_kinematics(model, data)
    return data


@robots
def test_locked_fingers_have_no_joints_and_no_servos(robot: Robot) -> None:
    locked = robot.build(Fingers.LOCKED).compile()
    moving = robot.build(Fingers.ACTUATED).compile()
    arm, fingers = len(robot.arm_joints), len(robot.finger_joints)
    assert (locked.nv, locked.nu) == (arm, arm)
    assert (moving.nv, moving.nu) == (arm + fingers, arm + fingers)
    assert [moving.joint(i).name for i in range(moving.njnt)] == [
        *robot.arm_joints,
        *robot.finger_joints,
    ]
    assert [moving.actuator(i).name for i in range(moving.nu)] == [
        *robot.arm_actuators,
        *robot.finger_actuators,
    ]
    assert locked.body_mass.sum() == pytest.approx(moving.body_mass.sum())


@robots
def test_locked_fingers_are_where_closed_ones_are(robot: Robot) -> None:
    locked = posed(robot, Fingers.LOCKED)
    closed = posed(robot, Fingers.ACTUATED, robot.finger_closed)
    np.testing.assert_allclose(locked.xpos, closed.xpos, atol=1e-6)
    np.testing.assert_allclose(locked.site_xpos, closed.site_xpos, atol=1e-9)


@robots
def test_closing_brings_the_fingertips_to_the_tool(robot: Robot) -> None:
    distances = []
    for angle in (robot.finger_open, robot.finger_closed):
        data = posed(robot, Fingers.ACTUATED, angle)
        tool = data.site(robot.tool_site).xpos
        tips = [
            np.linalg.norm(data.geom(f"distal_{index}").xpos - tool)
            for index in range(1, len(robot.finger_joints) + 1)
        ]
        distances.append(max(tips))
    assert distances[1] < 0.03 < distances[0]


@robots
def test_finger_pads_grip(robot: Robot) -> None:
    model = robot.build(Fingers.ACTUATED).compile()
    for index in range(1, len(robot.finger_joints) + 1):
        for part in ("proximal", "distal"):
            pad = model.geom(f"{part}_{index}")
            assert model.geom_condim[pad.id] == 4  # resists twisting
            assert model.geom_friction[pad.id, 0] >= 1.0


@robots
def test_only_the_collision_group_collides(robot: Robot) -> None:
    model = robot.build(Fingers.ACTUATED).compile()
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    np.testing.assert_array_equal(collides, model.geom_group == COLLISION_GROUP)


@robots
@pytest.mark.parametrize("fingers", list(Fingers))
def test_gravity_is_held_by_the_servos(robot: Robot, fingers: Fingers) -> None:
    data = posed(robot, fingers, robot.finger_open)
    arm = len(robot.arm_joints)
    data.ctrl[:] = data.qpos
    mujoco.mj_step(data.model, data, 500)
    np.testing.assert_allclose(data.qpos[:arm], robot.home, atol=1e-4)
