"""Splits observations into named parts, one row per arm, for all experts."""

from __future__ import annotations

from dataclasses import dataclass

from saver_envs.experts.geometry import FloatArray
from saver_envs.tasks.contract import Task


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


def view(observation: dict[str, FloatArray], task: Task) -> ArmView:
    """Split a batched goal-conditioned observation.

    :param observation: arrays with a leading dimension n: ``observation`` and ``desired_goal``.
    :param task: says where their parts lie; each arm has an object with a position as its goal.
    :return: the parts.
    """
    layout, seen = task.observation_layout, observation["observation"]
    velocity = layout.part("object linear velocity")
    return ArmView(
        tool=layout.get(seen, "gripper position"),
        fingers=layout.get(seen, "finger positions"),
        object=layout.get(seen, "object position"),
        object_quaternion=layout.get(seen, "object orientation, a quaternion with w >= 0"),
        object_velocity=layout.get(seen, velocity.name) / velocity.scale,
        target=task.goal_layout.get(observation["desired_goal"], "object position"),
    )
