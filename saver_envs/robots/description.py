"""What a scene needs to know about a robot arm: its model, names, limits and postures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import mujoco

#: Geom group of the meshes and decorations, drawn and never collided with.
VISUAL_GROUP = 2
#: Geom group of the collision primitives, hidden in renderings.
COLLISION_GROUP = 3
#: Arguments of a geom that is drawn and never collided with.
DRAWN_ONLY = {"contype": 0, "conaffinity": 0, "group": VISUAL_GROUP}


class Fingers(Enum):
    """How the fingers of a hand are built into the model."""

    #: Hinge joints, driven together by one gripper command.
    ACTUATED = "actuated"
    #: No joints: the fingers are part of the hand, closed. Used by the push tasks.
    LOCKED = "locked"


@dataclass(frozen=True)
class Robot:
    """A robot arm as a model builder plus its constants; frames are those of the arm's base.

    :param name: lower-case name, also the first part of the environment ids.
    :param build: returns a fresh specification of the arm, its base body first, with actuators.
    :param base_body: name of the base body.
    :param tool_site: name of the site that set-points refer to, between the fingertips; its axes
        are parallel to the base's when the hand points down at the yaw that tasks hold.
    :param arm_joints: hinge joints from base to wrist; a slide counts in metres and newtons.
    :param finger_joints: hinge joints of the fingers when actuated.
    :param home: joint angles of a tool-down posture in the middle of the workspace, radians.
    :param joint_lower: lower joint limits, radians; minus infinity where continuous.
    :param joint_upper: upper joint limits, radians; infinity where continuous.
    :param joint_speed_limits: makers' joint speed limits, radians per second.
    :param joint_torque_limits: makers' joint torque limits, newton metres.
    :param finger_open: finger joint angle of an open hand, radians.
    :param finger_closed: finger joint angle of a closed hand, radians.
    :param holds_orientation: whether the arm can keep its hand pointing down at a fixed yaw.
    :param reach: greatest horizontal distance of objects and targets from the base, metres.
    :param off_table_geoms: collision geoms that stand on the table and never collide with it.
    :param hand_reach: greatest distance of set-points from the shoulder, metres, for an arm whose
        hand pitches as it reaches out; for others the box is enough.
    :param shoulder_height: height of the shoulder above the base, metres.
    :param upright_at: distance from the base up to which such a hand is upright, metres.
    :param wrist_lead: how much nearer to the base its wrist is than its tool, per metre beyond.
    :param grid_lower: lower corner of the box in which reachable hand positions are tabulated,
        metres; by default that of hand positions in SPEC, with room beyond its sides.
    :param grid_upper: upper corner of that box, metres.
    :param tool: what the hand is, for pages, where it is none of the maker's.
    """

    name: str
    build: Callable[[Fingers], mujoco.MjSpec]
    base_body: str
    tool_site: str
    arm_joints: tuple[str, ...]
    finger_joints: tuple[str, ...]
    home: tuple[float, ...]
    joint_lower: tuple[float, ...]
    joint_upper: tuple[float, ...]
    joint_speed_limits: tuple[float, ...]
    joint_torque_limits: tuple[float, ...]
    finger_open: float
    finger_closed: float
    holds_orientation: bool
    reach: float
    off_table_geoms: tuple[str, ...]
    hand_reach: float = math.inf
    shoulder_height: float = 0.0
    upright_at: float = math.inf
    wrist_lead: float = 0.0
    grid_lower: tuple[float, float, float] = (0.25, -0.50, 0.02)
    grid_upper: tuple[float, float, float] = (0.60, 0.50, 0.40)
    tool: str = ""

    @property
    def arm_actuators(self) -> tuple[str, ...]:
        """Position servos, in the order of ``arm_joints``."""
        return tuple(servo_of(joint) for joint in self.arm_joints)

    @property
    def finger_actuators(self) -> tuple[str, ...]:
        """Position servos, in the order of ``finger_joints``."""
        return tuple(servo_of(joint) for joint in self.finger_joints)


def servo_of(joint: str) -> str:
    """Return the name of a joint's position servo."""
    return f"servo_{joint}"
