"""Finger angles of one hand as another hand would read them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import Robot
from saver_envs.tasks.observation import SIZE_PER_ARM

_POSITION, _VELOCITY = slice(6, 9), slice(9, 12)


def translated_fingers(
    observation: NDArray[np.floating], source: Robot, target: Robot
) -> NDArray[np.float32]:
    """Express finger readings in another hand's angles, so that open is open and closed is closed.

    A policy knows the angles of the hand that it was trained with. The MICO's fingers meet at
    another angle than the Jaco's, and in the push tasks, where the fingers are locked, that angle
    is all that three inputs ever read: untranslated they are 0.15 rad from anything in training.

    :param observation: (n, 28 * arms) of a robot ``source``; not modified.
    :param source: whose readings they are.
    :param target: whose readings they shall look like.
    :return: (n, 28 * arms), with finger positions mapped linearly from the range between open and
        closed of the one to that of the other, and velocities by the same factor.
    """
    blocks = np.array(observation, np.float64).reshape(len(observation), -1, SIZE_PER_ARM)
    factor = (target.finger_closed - target.finger_open) / (
        source.finger_closed - source.finger_open
    )
    blocks[..., _POSITION] = (
        target.finger_open + (blocks[..., _POSITION] - source.finger_open) * factor
    )
    blocks[..., _VELOCITY] *= factor
    return blocks.reshape(len(observation), -1).astype(np.float32)
