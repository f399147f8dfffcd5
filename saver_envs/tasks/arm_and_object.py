"""The observation of an arm and its object: 28 numbers an arm, in its base frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saver_envs.simulation import ArmState, ObjectState, Simulation
from saver_envs.tasks.contract import Memory, Seen, Task
from saver_envs.tasks.layout import Part

#: Velocities are multiplied by these (s), which brings them to the order of the positions: a hand
#: at its top speed of 0.5 m/s reads 0.1, a finger closing at 5 rad/s reads 0.2.
LINEAR_VELOCITY_SCALE = 0.2
ANGULAR_VELOCITY_SCALE = 0.04
FINGER_VELOCITY_SCALE = 0.04

#: Name of the part that holds the object's quaternion.
ORIENTATION = "object orientation, a quaternion with w >= 0"

HAND_PARTS = (
    Part("gripper position", 3, "m"),
    Part("gripper linear velocity", 3, "m/s", LINEAR_VELOCITY_SCALE),
    Part("finger positions", 3, "rad"),
    Part("finger velocities", 3, "rad/s", FINGER_VELOCITY_SCALE),
)
"""Parts of the observation that describe a hand."""
OBJECT_PARTS = (
    Part("object position", 3, "m"),
    Part("object position relative to the gripper", 3, "m"),
    Part(ORIENTATION, 4, "1"),
    Part("object linear velocity", 3, "m/s", LINEAR_VELOCITY_SCALE),
    Part("object angular velocity", 3, "rad/s", ANGULAR_VELOCITY_SCALE),
)
ARM_AND_OBJECT = HAND_PARTS + OBJECT_PARTS


class ArmAndObjectTask(Task):
    """Base of tasks in which each arm brings an object to a target, which is its whole goal.

    Their starts have the targets (arms, 3) in each arm's base frame, metres.
    """

    @property
    def observation(self) -> tuple[Part, ...]:
        """The arm and its object."""
        return ARM_AND_OBJECT

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return each object's position in its arm's base frame, metres."""
        position = seen["object position"]
        return position.reshape(len(position), -1)

    def desired(self, starts: Sequence[Any]) -> NDArray[np.float64]:
        """Return each object's target in its arm's base frame, metres."""
        return np.stack([start.target.reshape(-1) for start in starts])


def hand_parts(simulation: Simulation, arms: ArmState) -> dict[str, NDArray[np.float64]]:
    """Return the values of :data:`HAND_PARTS`, (n, arms, size) each, unscaled."""
    position, velocity = simulation.finger_state()
    return {
        "gripper position": arms.tool_position,
        "gripper linear velocity": arms.tool_velocity,
        "finger positions": three_fingers(position, simulation.scene.robot.finger_closed),
        "finger velocities": three_fingers(velocity, 0.0),
    }


def object_parts(arms: ArmState, objects: ObjectState) -> dict[str, NDArray[np.float64]]:
    """Return the values of :data:`OBJECT_PARTS`, (n, arms, size) each, unscaled."""
    return {
        "object position": objects.position,
        "object position relative to the gripper": objects.position - arms.tool_position,
        ORIENTATION: objects.quaternion,
        "object linear velocity": objects.linear_velocity,
        "object angular velocity": objects.angular_velocity,
    }


def three_fingers(values: NDArray[np.float64], locked_value: float) -> NDArray[np.float64]:
    """Fill the three finger slots of an arm.

    A two-finger hand fills the first two and puts their mean into the third; locked fingers read
    a constant.

    :param values: (n, arms, fingers) with 0, 2 or 3 fingers.
    :param locked_value: what a finger without a joint reads.
    :return: (n, arms, 3).
    """
    fingers = values.shape[-1]
    if fingers == 3:
        return values
    if fingers == 2:
        return np.concatenate([values, values.mean(axis=-1, keepdims=True)], axis=-1)
    return np.full((*values.shape[:-1], 3), locked_value)
