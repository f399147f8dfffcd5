"""Actuators of a robot's joints: position servos, torque motors in their place, or none."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import Fingers, Robot, servo_of


def add_servo(
    spec: mujoco.MjSpec, joint: str, limit: float, stiffness: float, damping: float | None = None
) -> None:
    """Add a position servo to a joint.

    :param spec: of the robot; it gets another actuator.
    :param joint: a hinge, or a slide in metres and newtons.
    :param limit: greatest torque, N m.
    :param stiffness: N m/rad.
    :param damping: N m s/rad; where ``None``, critical for the joint's inertia at the zero posture.
    """
    servo = _add_actuator(spec, servo_of(joint), joint, limit)
    if damping is None:
        servo.set_to_position(kp=stiffness, dampratio=1.0)
    else:
        servo.set_to_position(kp=stiffness, kv=damping)


def add_arm_servos(spec: mujoco.MjSpec, robot: Robot, *gains: Sequence[float]) -> None:
    """Add a position servo to each joint of the arm.

    :param spec: of the robot.
    :param robot: gives the torque limits.
    :param gains: stiffness of every joint, and damping if it is not critical.
    """
    for joint, limit, *own in zip(robot.arm_joints, robot.joint_torque_limits, *gains, strict=True):
        add_servo(spec, joint, limit, *own)


def torque_driven(robot: Robot) -> mujoco.MjSpec:
    """Return a robot driven by torques: its links' inertia and nothing else.

    There are no servos, armature or gravity compensation; actuator i drives joint i of the arm
    within its torque limit; the fingers are locked.
    """
    spec = robot.build(Fingers.LOCKED)
    for servo in list(spec.actuators):
        spec.delete(servo)
    for body in spec.bodies:
        body.gravcomp = 0
    for name, limit in zip(robot.arm_joints, robot.joint_torque_limits, strict=True):
        joint = spec.joint(name)
        joint.armature, joint.actgravcomp = 0.0, 0
        _add_actuator(spec, f"motor_{name}", name, limit).set_to_motor()
    return spec


def _add_actuator(spec: mujoco.MjSpec, name: str, joint: str, limit: float) -> mujoco.MjsActuator:
    return spec.add_actuator(
        name=name,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        forcelimited=True,
        forcerange=(-limit, limit),
    )


def lock_joint(spec: mujoco.MjSpec, name: str, position: float) -> None:
    """Remove a joint and fix its body at the joint's position, rad or m."""
    joint = spec.joint(name)
    body, axis = joint.parent, np.asarray(joint.axis, dtype=float)
    axis = axis / np.linalg.norm(axis)
    if int(joint.type) == int(mujoco.mjtJoint.mjJNT_SLIDE):
        shift = np.zeros(3)
        mujoco.mju_rotVecQuat(shift, axis * position, np.asarray(body.quat, dtype=float))
        body.pos = np.asarray(body.pos) + shift
    else:
        turn = np.concatenate([[math.cos(position / 2)], math.sin(position / 2) * axis])
        body.quat = product(np.asarray(body.quat, dtype=float), turn)
    spec.delete(joint)


def product(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the product (4,) of two quaternions."""
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, first, second)
    return result
