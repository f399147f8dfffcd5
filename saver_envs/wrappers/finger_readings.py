"""Finger angles of one hand as another hand would read them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import Robot
from saver_envs.tasks.layout import Layout


def translated_fingers(
    observation: NDArray[np.floating], layout: Layout, source: Robot, target: Robot
) -> NDArray[np.float32]:
    """Express finger readings in another hand's angles, so that open is open and closed is closed.

    A policy knows the angles of the hand that it was trained with. The MICO's fingers meet at
    another angle than the Jaco's, and in the push tasks, where the fingers are locked, that angle
    is all that three inputs ever read: untranslated they are 0.15 rad from anything in training.

    :param observation: (n, observation size) of a robot ``source``; not modified.
    :param layout: of the observation.
    :param source: whose readings they are.
    :param target: whose readings they shall look like.
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
