"""The fingers of Kinova's arms: hinges and servos."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from saver_envs.robots.drives import add_servo

#: Torque limit of a finger (N m, from dm-control's kinova package), and its reflected rotor
#: inertia (kg m^2), servo stiffness (N m/rad) and damping (N m s/rad), which are ours.
FINGER_TORQUE, FINGER_ARMATURE, FINGER_STIFFNESS, FINGER_DAMPING = 1.0, 0.01, 5.0, 0.3


def add_finger_hinge(body: mujoco.MjsBody, name: str, lower: float, upper: float) -> None:
    """Add a hinge of a finger about the body's z axis, with limits in radians."""
    body.add_joint(
        name=name,
        axis=(0, 0, 1),
        range=(lower, upper),
        armature=FINGER_ARMATURE,
        damping=(0.05, 0, 0),
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
