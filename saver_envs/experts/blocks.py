"""Reads an observation into named parts, one row per arm; what every expert starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saver_envs.tasks.observation import LINEAR_VELOCITY_SCALE, PARTS, SIZE_PER_ARM

FloatArray = NDArray[np.floating]

_EDGES = np.cumsum([0, *(size for _, size, _ in PARTS)])
_SLICES = {
    name: slice(int(start), int(end))
    for (name, _, _), start, end in zip(PARTS, _EDGES[:-1], _EDGES[1:], strict=True)
}


@dataclass(frozen=True)
class ArmView:
    """What the arms see, each in its own base frame; leading dimensions (n, arms).

    :param tool: (n, arms, 3), metres.
    :param fingers: (n, arms, 3), radians.
    :param object: (n, arms, 3), metres.
    :param object_quaternion: (n, arms, 4), w first.
    :param object_velocity: (n, arms, 3), metres per second.
    :param target: (n, arms, 3), metres.
    """

    tool: FloatArray
    fingers: FloatArray
    object: FloatArray
    object_quaternion: FloatArray
    object_velocity: FloatArray
    target: FloatArray


def view(observation: dict[str, FloatArray], n_arms: int) -> ArmView:
    """Split a batched goal-conditioned observation.

    :param observation: arrays with a leading dimension n: ``observation`` (n, 28 * arms) and
        ``desired_goal`` (n, at least 3 * arms).
    :param n_arms: number of arms.
    :return: the parts.
    """
    blocks = observation["observation"].reshape(-1, n_arms, SIZE_PER_ARM)
    target = observation["desired_goal"][:, : 3 * n_arms].reshape(-1, n_arms, 3)
    return ArmView(
        tool=blocks[..., _SLICES["gripper position"]],
        fingers=blocks[..., _SLICES["finger positions"]],
        object=blocks[..., _SLICES["object position"]],
        object_quaternion=blocks[..., _SLICES["object orientation, a quaternion with w >= 0"]],
        object_velocity=blocks[..., _SLICES["object linear velocity"]] / LINEAR_VELOCITY_SCALE,
        target=target,
    )
