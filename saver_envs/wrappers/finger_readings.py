"""Conversion of finger readings from one hand to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import Robot
from saver_envs.tasks.layout import Layout


def translated_fingers(
    observation: NDArray[np.floating], layout: Layout, source: Robot, target: Robot
) -> NDArray[np.float32]:
    """Convert finger readings to another hand's angles: open to open, closed to closed.

    A policy is trained with the angles of one hand. The MICO's fingers close at another angle than
    the Jaco's. In the push tasks, where the fingers are locked, three inputs always have that
    angle, which is 0.15 rad off the training data without conversion.

    :param observation: (n, observation size) of a robot ``source``; not modified.
    :param layout: of the observation.
    :param source: the robot of the readings.
    :param target: the robot whose readings they are converted to.
    :return: (n, observation size), with finger positions mapped linearly from the range between
        open and closed of the one to that of the other, and velocities by the same factor.
    """
    seen = np.array(observation, np.float64)
    factor = (target.finger_closed - target.finger_open) / (
        source.finger_closed - source.finger_open
    )
    position, velocity = (
        layout.get(seen, f"finger {what}") for what in ("positions", "velocities")
    )
    position[...] = target.finger_open + (position - source.finger_open) * factor
    velocity *= factor
    return seen.astype(np.float32)
