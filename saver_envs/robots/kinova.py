"""What the models of Kinova's arms share: hinges, rings, collision capsules and servos."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco

from saver_envs.robots.description import COLLISION_GROUP, DRAWN_ONLY, Robot
from saver_envs.robots.drives import add_servo

Point = tuple[float, float, float]

DARK, LIGHT = (0.12, 0.12, 0.13, 1.0), (0.72, 0.72, 0.74, 1.0)
TOOL_SITE = "tool"

#: Sliding, torsional (m) and rolling (m) friction of the links and of the fingers' rubber pads.
LINK_FRICTION, FINGER_FRICTION = (0.8, 0.02, 0.001), (1.5, 0.05, 0.001)
#: Torque limit of a finger (N m, from dm-control's kinova package), and its reflected rotor
#: inertia (kg m^2), servo stiffness (N m/rad) and damping (N m s/rad), which are ours.
FINGER_TORQUE, FINGER_ARMATURE, FINGER_STIFFNESS, FINGER_DAMPING = 1.0, 0.01, 5.0, 0.3


def add_hinge(body: mujoco.MjsBody, robot: Robot, index: int, armature: float) -> None:
    """Add a hinge of the arm about the body's z axis, with gravity compensation.

    :param body: of the link.
    :param robot: gives name and limits; a continuous joint's are infinite.
    :param index: of the joint.
    :param armature: reflected rotor inertia, kg m^2.
    """
    lower, torque = robot.joint_lower[index], robot.joint_torque_limits[index]
    body.add_joint(
        name=robot.arm_joints[index],
        axis=(0, 0, 1),
        range=(lower, robot.joint_upper[index]) if math.isfinite(lower) else (0, 0),
        armature=armature,
        actgravcomp=1,
        actfrcrange=(-torque, torque),
    )


def add_finger_hinge(body: mujoco.MjsBody, name: str, lower: float, upper: float) -> None:
    """Add a hinge of a finger about the body's z axis, with limits in radians."""
    body.add_joint(
        name=name,
        axis=(0, 0, 1),
        range=(lower, upper),
        armature=FINGER_ARMATURE,
        damping=(0.05, 0, 0),
    )


def add_ring(body: mujoco.MjsBody, radius: float, half_height: float) -> None:
    """Draw the grey ring at a link's joint; lengths in metres."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(radius, half_height, 0),
        mass=0,
        rgba=LIGHT,
        **DRAWN_ONLY,
    )


def add_capsule(
    body: mujoco.MjsBody,
    name: str,
    start: Point,
    end: Point,
    radius: float,
    pad: bool = False,
    drawn: tuple[float, ...] | None = None,
) -> None:
    """Add a massless collision capsule.

    :param body: that it belongs to.
    :param name: of the geom.
    :param start: of its axis, metres.
    :param end: of its axis, metres.
    :param radius: metres.
    :param pad: whether it is a finger's rubber pad.
    :param drawn: colour of a second one that is drawn, for a link without a mesh.
    """
    shape: Any = {
        "type": mujoco.mjtGeom.mjGEOM_CAPSULE,
        "fromto": (*start, *end),
        "size": (radius, 0, 0),
    }
    if drawn is not None:
        body.add_geom(**shape, rgba=drawn, **DRAWN_ONLY)
    body.add_geom(
        **shape,
        name=name,
        mass=0,
        condim=4 if pad else 3,
        friction=FINGER_FRICTION if pad else LINK_FRICTION,
        group=COLLISION_GROUP,
        rgba=(0.9, 0.3, 0.2, 0.4),
    )


def add_finger_servos(spec: mujoco.MjSpec, joints: Sequence[str], shares: Sequence[float]) -> None:
    """Add position servos that share one gripper command.

    :param spec: of the robot.
    :param joints: of the fingers.
    :param shares: strength of each servo, relative to a whole finger's.
    """
    for joint, share in zip(joints, shares, strict=True):
        gains = (share * gain for gain in (FINGER_TORQUE, FINGER_STIFFNESS, FINGER_DAMPING))
        add_servo(spec, joint, *gains)
