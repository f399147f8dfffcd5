"""Splits observations into named parts, one row per arm, for all experts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saver_envs.control import length
from saver_envs.experts.geometry import FloatArray
from saver_envs.tasks.contract import Task


@dataclass(frozen=True)
class ArmView:
    """What the arms see, each in its own base frame; leading dimensions (n, arms).

    :param tool: (n, arms, 3), metres.
    :param fingers: (n, arms, 3), radians.
    :param finger_velocity: (n, arms, 3), radians per second.
    :param object: (n, arms, 3), metres.
    :param object_quaternion: (n, arms, 4), w first.
    :param object_velocity: (n, arms, 3), metres per second.
    :param target: (n, arms, 3), metres.
    :param object_size: (n, arms) edges of the objects, metres.
    :param begins: (n,) whether an episode begins with this observation.
    """

    tool: FloatArray
    fingers: FloatArray
    finger_velocity: FloatArray
    object: FloatArray
    object_quaternion: FloatArray
    object_velocity: FloatArray
    target: FloatArray
    object_size: FloatArray
    begins: NDArray[np.bool_]


class Viewer:
    """Reads observations, and remembers of each episode what its beginning shows.

    The resting height of an object at the beginning shows its size. A new target or a hand that
    jumped marks a new episode.

    :param task: says where the parts lie; each arm has an object with a position as its goal.
    """

    #: A hand that moved by more than this at once (m) belongs to a new episode.
    JUMP = 0.06
    #: Sizes that a resting object may have (m).
    SIZES = (0.03, 0.13)
    #: A size this near that of the task (m) is taken for it, since observations have errors.
    ALIKE = 0.004

    def __init__(self, task: Task) -> None:
        self.task = task
        self._last: ArmView | None = None

    def __call__(self, observation: dict[str, FloatArray]) -> ArmView:
        """Split a batched goal-conditioned observation.

        :param observation: arrays with a leading dimension n: ``observation`` and
            ``desired_goal``; the same episodes in the same order at every call.
        :return: the parts.
        """
        task, last = self.task, self._last
        layout, seen = task.observation_layout, observation["observation"]
        velocity = layout.part("object linear velocity")
        finger_velocity = layout.part("finger velocities")
        position = layout.get(seen, "object position")
        view = ArmView(
            tool=layout.get(seen, "gripper position"),
            fingers=layout.get(seen, "finger positions"),
            finger_velocity=layout.get(seen, finger_velocity.name) / finger_velocity.scale,
            object=position,
            object_quaternion=layout.get(seen, "object orientation, a quaternion with w >= 0"),
            object_velocity=layout.get(seen, velocity.name) / velocity.scale,
            target=task.goal_layout.get(observation["desired_goal"], "object position"),
            object_size=self._size(position[..., 2]),
            begins=np.ones(len(seen), dtype=bool),
        )
        if last is not None and last.target.shape == view.target.shape:
            begins = (last.target != view.target).any(axis=(1, 2))
            begins |= (length(view.tool - last.tool) > self.JUMP).any(axis=1)
            size = np.where(begins[:, None], view.object_size, last.object_size)
            view = replace(view, begins=begins, object_size=size)
        self._last = view
        return view

    def _size(self, height: FloatArray) -> FloatArray:
        """Edges of objects whose centres are at ``height`` above the table, metres."""
        usual = float(getattr(self.task, "object_size", 0.0))
        size = 2 * height
        resting = (size > self.SIZES[0]) & (size < self.SIZES[1])
        return np.where(resting & (np.abs(size - usual) > self.ALIKE), size, usual)
