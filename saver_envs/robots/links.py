"""What the models of our arms are made of: hinges, rings and collision capsules."""

from __future__ import annotations

import math
from typing import Any

import mujoco

from saver_envs.robots.description import COLLISION_GROUP, DRAWN_ONLY, Robot

Point = tuple[float, float, float]

DARK, LIGHT = (0.12, 0.12, 0.13, 1.0), (0.72, 0.72, 0.74, 1.0)
TOOL_SITE = "tool"

#: Sliding, torsional (m) and rolling (m) friction of the links and of rubber pads.
LINK_FRICTION, PAD_FRICTION = (0.8, 0.02, 0.001), (1.5, 0.05, 0.001)


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
    :param pad: whether it is a rubber pad.
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
        friction=PAD_FRICTION if pad else LINK_FRICTION,
        group=COLLISION_GROUP,
        rgba=(0.9, 0.3, 0.2, 0.4),
    )
