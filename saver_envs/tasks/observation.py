"""The observation: 28 numbers an arm, in its base frame, blocks in the order of the arms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saver_envs.simulation import ArmState, ObjectState

#: Velocities are multiplied by these (s), which brings them to the order of the positions: a hand
#: at its top speed of 0.5 m/s reads 0.1, a finger closing at 5 rad/s reads 0.2.
LINEAR_VELOCITY_SCALE = 0.2
ANGULAR_VELOCITY_SCALE = 0.04
FINGER_VELOCITY_SCALE = 0.04

#: Name, size and meaning of each part, from which the documentation's tables are made.
PARTS = (
    ("gripper position", 3, "m"),
    ("gripper linear velocity", 3, f"m/s x {LINEAR_VELOCITY_SCALE}"),
    ("finger positions", 3, "rad"),
    ("finger velocities", 3, f"rad/s x {FINGER_VELOCITY_SCALE}"),
    ("object position", 3, "m"),
    ("object position relative to the gripper", 3, "m"),
    ("object orientation, a quaternion with w >= 0", 4, "1"),
    ("object linear velocity", 3, f"m/s x {LINEAR_VELOCITY_SCALE}"),
    ("object angular velocity", 3, f"rad/s x {ANGULAR_VELOCITY_SCALE}"),
)
SIZE_PER_ARM = sum(size for _, size, _ in PARTS)


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


def observe(
    arms: ArmState,
    objects: ObjectState,
    finger_position: NDArray[np.float64],
    finger_velocity: NDArray[np.float64],
    locked_finger_position: float,
) -> NDArray[np.float64]:
    """Return observations (n, 28 * arms) in the order of :data:`PARTS`, arm after arm.

    :param arms: the arms' state.
    :param objects: the cubes' state.
    :param finger_position: (n, arms, fingers), radians.
    :param finger_velocity: (n, arms, fingers), radians per second.
    :param locked_finger_position: angle that locked fingers read, radians.
    """
    blocks = np.concatenate(
        [
            arms.tool_position,
            arms.tool_velocity * LINEAR_VELOCITY_SCALE,
            three_fingers(finger_position, locked_finger_position),
            three_fingers(finger_velocity, 0.0) * FINGER_VELOCITY_SCALE,
            objects.position,
            objects.position - arms.tool_position,
            objects.quaternion,
            objects.linear_velocity * LINEAR_VELOCITY_SCALE,
            objects.angular_velocity * ANGULAR_VELOCITY_SCALE,
        ],
        axis=-1,
    )
    return blocks.reshape(len(blocks), -1)
